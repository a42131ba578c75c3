#!/usr/bin/env bash
# Six points of a lidar are written with lazpy in point format 6, that of LAS 1.4, by the fields that its documentation uses, with classes 2, 5, 5, 6, 2 and 9, return numbers and scan angles;
# and a file's points are all made class 5 and written, as in its README (`point.classification`, `write`, or `arrays()`, `write_arrays`). Guess: what was given, in .las and .laz.
# Seen with lazpy 0.9.2 on 2026-11-30 (read with laspy 2.7.0, and with lazpy itself), without a word, with formats 6 and 7; format 1 is right:
# - .laz: all six points are of class 2, that of the first; of a file with classes 2, 6, 2, 9, 6 the first becomes 5, the others stay 6, 2, 9, 6
# - .las: classes are right; so a test with .las does not show it
# - both: return numbers, numbers of returns and scan angles are 0. A class above 31 is read as 0 (bathymetry, 40), return 8 of 15 as 6 of 7. The `extended_…` fields beside them hold
#   what counts; those who set the others are told nothing
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check lazpy==0.9.2 laspy==2.7.0 lazrs==0.8.2 numpy==2.4.6 2>/dev/null
cat > classes.py <<'PYTHON'
import laspy
import lazpy
import numpy as np

CLASSES, RETURNS, OF_RETURNS = [2, 5, 5, 6, 2, 9], [1, 2, 1, 1, 2, 3], [1, 2, 2, 1, 3, 3]
SCALES, OFFSETS = (0.001, 0.001, 0.001), (0.0, 0.0, 0.0)


def numbers(values):
    return np.asarray(values).tolist()


for ending in ("las", "laz"):
    for form in (1, 6, 7):
        axis = np.arange(6, dtype=np.int32)
        fields = {"classification": CLASSES, "return_number": RETURNS, "number_of_returns": OF_RETURNS}
        with lazpy.Writer(f"new.{ending}", form, scales=SCALES, offsets=OFFSETS) as writer:
            angles = np.full(6, -20, np.int8)
            writer.write_arrays({"X": axis, "Y": axis, "Z": axis, "scan_angle_rank": angles} | {name: np.array(values, np.uint8) for name, values in fields.items()})
        read = laspy.read(f"new.{ending}")
        angles = numbers(read.scan_angle_rank if form == 1 else read.scan_angle)
        print(f"{ending}, format {form}: classes", numbers(read.classification), "returns", numbers(read.return_number), "angle", angles[0])
        assert numbers(read.classification) == ([2] * 6 if ending == "laz" and form > 1 else CLASSES)
        assert (numbers(read.return_number), numbers(read.number_of_returns), angles) == ((RETURNS, OF_RETURNS, [-20] * 6) if form == 1 else ([0] * 6,) * 3)
        with lazpy.Reader(f"new.{ending}") as reader:
            assert numbers(reader.arrays()["classification"]) == numbers(read.classification)

        header = laspy.LasHeader(point_format=form, version="1.4")
        header.scales = SCALES
        labelled = laspy.LasData(header)
        labelled.x = labelled.y = labelled.z = np.arange(5)
        labelled.classification = np.array([2, 6, 2, 9, 6])
        labelled.write(f"labelled.{ending}")
        for way in ("points", "arrays"):
            with lazpy.Reader(f"labelled.{ending}") as reader, lazpy.Writer(f"again.{ending}", reader.point_format, scales=reader.scales, offsets=reader.offsets) as writer:
                if way == "points":
                    for point in reader:
                        point.classification = 5
                        writer.write(point)
                else:
                    arrays = reader.arrays()
                    arrays["classification"][:] = 5
                    writer.write_arrays(arrays)
            again = numbers(laspy.read(f"again.{ending}").classification)
            print(f"{ending}, format {form}, all made class 5 as {way}:", again)
            assert again == ([5, 6, 2, 9, 6] if ending == "laz" and form > 1 else [5] * 5)

header = laspy.LasHeader(point_format=6, version="1.4")
header.scales = SCALES
deep = laspy.LasData(header)
deep.x = deep.y = deep.z = np.arange(2)
deep.classification, deep.return_number, deep.number_of_returns = np.array([9, 40]), np.array([1, 8]), np.array([2, 15])
deep.write("deep.laz")
with lazpy.Reader("deep.laz") as reader:
    fields = reader.arrays()
found = {name: numbers(fields[name]) for name in ("classification", "return_number", "number_of_returns", "extended_classification")}
print(found)
assert list(found.values()) == [[9, 0], [1, 6], [2, 7], [9, 40]]
PYTHON
venv/bin/python classes.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
