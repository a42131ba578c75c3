#!/usr/bin/env bash
# Points of a lidar are kept in a table of a data lake (Delta Lake, Iceberg): the time of each in nanoseconds, three within a microsecond, their ring as uint8, and
# a counter as uint32. Guess: types stay, or the writer refuses those that the format has not.
# Seen on 2026-11-29:
# - deltalake 1.6.6: times are cut to microseconds without a word, with a time zone or without: three points have one time, and a join with another table of nanoseconds finds
#   none of them. A ring is an int8, a counter an int32: of a lidar of 128 beams all fits, and the first point of ring 128 is an error, in the middle of a fleet
# - pyiceberg 0.12.0 refuses nanoseconds; a ring is an int32, and fits
# - pylance 14.0.2 (Lance) keeps all of it, but `time >= timestamp '… .123456200'` in a filter is cut to microseconds, and finds the point at .123456100 as well
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check deltalake==1.6.6 pylance==14.0.2 "pyiceberg[sql-sqlite]==0.12.0" pyarrow==26.0.1 numpy==2.4.6
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import deltalake
import lance
import pyarrow as pa
from pyiceberg.catalog.sql import SqlCatalog
from pyiceberg.io.pyarrow import UnsupportedPyArrowTypeException

TIMES_NS = [1_700_000_000_123_456_000 + ns for ns in (100, 200, 300)]


def points(ring):
    return pa.table(
        {
            "time": pa.array(TIMES_NS, pa.timestamp("ns")),
            "utc": pa.array(TIMES_NS, pa.timestamp("ns", "UTC")),
            "ring": pa.array([0, 1, ring], pa.uint8()),
            "counter": pa.array([0, 1, 2], pa.uint32()),
        }
    )


table = points(127)
deltalake.write_deltalake("delta", table)
delta = pa.table(deltalake.DeltaTable("delta").to_pyarrow_table())
print(f"deltalake: {[str(field.type) for field in delta.schema]}")
for name in ("time", "utc"):
    assert delta[name].cast(pa.int64()).to_pylist() == [TIMES_NS[0] // 1000] * 3
assert delta.schema.field("ring").type == pa.int8() and delta.schema.field("counter").type == pa.int32()
try:
    deltalake.write_deltalake("delta", points(128), mode="append")
    raise SystemExit("ring 128 fits")
except Exception as exc:
    print(f"ring 128: {str(exc)[:150]}")
    assert "128" in str(exc)

lance.write_dataset(table, "table.lance")
dataset = lance.dataset("table.lance")
assert dataset.to_table().equals(table)
late = dataset.to_table(filter="time >= timestamp '2023-11-14 22:13:20.123456200'")
print(f"Lance: {late.num_rows} of 3 points from 200 ns on")
assert late.num_rows == 3

catalog = SqlCatalog("local", uri="sqlite:///catalog.db", warehouse="iceberg")
catalog.create_namespace("drive")
try:
    catalog.create_table("drive.times", schema=table.select(["time"]).schema)
    raise SystemExit("Iceberg takes nanoseconds")
except UnsupportedPyArrowTypeException as exc:
    print(f"pyiceberg: {exc}")
rings = points(250).select(["ring"])
catalog.create_table("drive.rings", schema=rings.schema).append(rings)
found = catalog.load_table("drive.rings").scan().to_arrow()
assert found["ring"].to_pylist() == [0, 1, 250] and found.schema.field("ring").type == pa.int32()
PYTHON
