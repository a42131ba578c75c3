#!/usr/bin/env bash
# Which GPS week and time of week does pyubx2 give for a time in UTC?
# Guess: the week turns when GPS time does, 18 s before midnight of Sunday in UTC, and leap seconds are those of the date.
# Seen with pyubx2 1.4.0 on 2026-11-28: the week turns at midnight in UTC, so for the 18 s before it the time of week is
# 604,800 s or more, which no receiver sends (and the week is the old one); and today's 18 s hold for any date: 3 s off in 2010.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyubx2==1.4.0
"$folder/venv/bin/python" - <<'PYTHON'
from datetime import datetime, timedelta

from pyubx2 import utc2itow


def expected(utc, leap_s):
    """Return GPS week and milliseconds of it."""
    weeks, rest = divmod(utc - datetime(1980, 1, 6) + timedelta(seconds=leap_s), timedelta(weeks=1))
    return weeks, rest // timedelta(milliseconds=1)


for utc, leap_s, seen in (
    (datetime(2026, 11, 28, 12), 18, (2446, 561618000)),
    (datetime(2026, 11, 28, 23, 59, 41), 18, (2446, 604799000)),
    (datetime(2026, 11, 28, 23, 59, 50), 18, (2446, 604808000)),
    (datetime(2010, 6, 1, 12), 15, (1586, 216018000)),
):
    got = tuple(utc2itow(utc))
    print(utc, "pyubx2", got, "by definition", expected(utc, leap_s))
    assert got == seen, got
assert expected(datetime(2026, 11, 28, 23, 59, 41), 18) == (2446, 604799000)
assert expected(datetime(2026, 11, 28, 23, 59, 50), 18) == (2447, 8000)
PYTHON
