#!/usr/bin/env bash
# Readings have times in UTC to the nanosecond, three within a microsecond, in a pandas table (`datetime64[ns, UTC]`). DuckDB reads the table
# where it lies in memory, and the Parquet file that pandas wrote of it. Are the times the same?
# Guess: yes; DuckDB has a type for nanoseconds. Seen with DuckDB 2.0.1 and pandas 3.1.1 on 2026-11-29:
# - the Parquet file has all of them; of the table in memory they are cut to microseconds, without a word: three readings at two times, and
#   a join on the time with the same rows in the file finds none. Without a time zone the table keeps its nanoseconds, too
# - a result of the file goes back to pandas (`.df()`) without its time zone, still in UTC
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pandas==3.1.1 duckdb==2.0.1 pyarrow==26.0.1
cd "$folder"
venv/bin/python - <<'PYTHON'
import duckdb
import pandas as pd

START_NS = 1_700_000_000_123_456_789
times_ns = [START_NS, START_NS + 300, START_NS + 700]
utc = pd.DataFrame({"t": pd.to_datetime(times_ns, utc=True).as_unit("ns")})
naive = pd.DataFrame({"t": pd.to_datetime(times_ns).as_unit("ns")})
utc.to_parquet("utc.parquet")


def nanoseconds(source):
    return [row[0] for row in duckdb.sql(f"SELECT epoch_ns(t) FROM {source} ORDER BY 1").fetchall()]


seen = {source: nanoseconds(source) for source in ("'utc.parquet'", "utc", "naive")}
matches = duckdb.sql("SELECT count(*) FROM utc JOIN 'utc.parquet' AS file ON utc.t = file.t").fetchall()[0][0]
back = duckdb.sql("SELECT t FROM 'utc.parquet'").df()["t"]
print(*(f"{source}: {found}" for source, found in seen.items()), sep="\n")
print(f"{matches} of 3 rows match, and the type that comes back is {back.dtype}")
assert str(utc["t"].dtype) == "datetime64[ns, UTC]"
assert seen["'utc.parquet'"] == seen["naive"] == times_ns
assert seen["utc"] == [time_ns // 1000 * 1000 for time_ns in times_ns]
assert len(set(seen["utc"])) == 2 and matches == 0
assert str(back.dtype) == "datetime64[ns]"
PYTHON
