#!/usr/bin/env bash
# Two stations of a terrestrial scanner in a file (E57): four points each, with intensities of 0, 100, 200 and 1000, and colours where it had light to take pictures. It is read with e57 of PyPI (in Rust)
# and with pye57 (libE57). Guess: points, intensities and colours in both; what a station does not have is missing or NaN.
# Seen with e57 0.2.3 and pye57 0.4.19 on 2026-11-30, without a word, of e57:
# - a station without colours has its intensities as colours, whose others are from 0 to 1: red, green and blue of 200 each
# - one point of a station that is marked as invalid (a beam without a return): the file has no colours and no intensities, of no station
# - the first station has none, the second has: there are none at all. Points are right each time
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check e57==0.2.3 pye57==0.4.19 numpy==2.4.6 2>/dev/null
cat > columns.py <<'PYTHON'
import e57
import numpy as np
import pye57

RED = np.array([255, 0, 10, 0], np.uint8)


def read(name, coloured, intense=(True, True), invalid=False):
    """Write two stations of four points; return what e57 reads, after a look at what pye57 does."""
    with_others = pye57.E57(f"{name}.e57", mode="w")
    for station in range(2):
        columns = {"cartesianX": np.arange(1.0, 5) + 10 * station, "cartesianY": np.zeros(4), "cartesianZ": np.zeros(4)}
        if intense[station]:
            columns["intensity"] = np.array([0, 100, 200, 1000.0])
        if coloured[station]:
            columns |= {"colorRed": RED, "colorGreen": RED[::-1].copy(), "colorBlue": np.zeros(4, np.uint8)}
        if invalid:
            columns["cartesianInvalidState"] = np.array([0, 0, 2, 0], np.uint8)
        with_others.write_scan_raw(columns, name=str(station))
    with_others.close()
    by_libe57 = pye57.E57(f"{name}.e57")
    for station in range(2):
        columns = by_libe57.read_scan_raw(station)
        assert not coloured[station] or columns["colorRed"].tolist() == RED.tolist()
        assert not intense[station] or columns["intensity"].tolist() == [0, 100, 200, 1000]
    cloud = e57.read_points(f"{name}.e57")
    print(f"{name}: {len(cloud.points)} points, {len(cloud.intensity)} intensities, {len(cloud.color)} colours", np.round(cloud.color[-4:], 2).tolist())
    return cloud


both = read("colours", (True, True))
assert len(both.color) == len(both.intensity) == 8 and np.allclose(both.color[4:, 0], RED / 255)

dark = read("second without", (True, False))
assert len(dark.color) == 8 and np.array_equal(dark.color[4:], np.repeat([[0], [100], [200], [1000]], 3, axis=1)) and np.allclose(dark.color[:4, 0], RED / 255)

invalid = read("invalid point", (True, True), invalid=True)
assert len(invalid.points) == 6 and len(invalid.color) == len(invalid.intensity) == 0

late = read("first without", (False, True), intense=(False, True))
assert len(late.points) == 8 and len(late.color) == len(late.intensity) == 0
PYTHON
venv/bin/python columns.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
