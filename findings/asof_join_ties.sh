#!/usr/bin/env bash
# Images at 10, 20 and 30 ms are joined with the readings of a faster sensor at 5, 15, 15 and 25 ms (two were stamped alike), as-of: with the
# nearest reading, and with the latest one before. Do tables of pandas, polars and DuckDB agree?
# Guess: yes, as it is one kind of join; where two readings are equally near, the earlier one; of two at one time, the last.
# Seen with pandas 3.1.1, polars 2.1.0 and DuckDB 2.0.1 on 2026-11-29: no, and each answers without a word
# - nearest: pandas takes the earlier of two that are equally near, polars the later. Where one clock has twice the rate of the other, so
#   that ties are the rule, their tables differ in every row: by a whole period of the sensor
# - of two readings at one time, pandas and polars take the last in the table, DuckDB's ASOF JOIN the first
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pandas==3.1.1 polars==2.1.0 duckdb==2.0.1 pyarrow==26.0.1
cd "$folder"
venv/bin/python - <<'PYTHON'
import duckdb
import pandas as pd
import polars as pl

images = pd.DataFrame({"t_ms": [10, 20, 30]})
readings = pd.DataFrame({"t_ms": [5, 15, 15, 25], "reading": ["at 5", "first at 15", "second at 15", "at 25"]})

seen = {
    "pandas, nearest": pd.merge_asof(images, readings, on="t_ms", direction="nearest")["reading"].tolist(),
    "polars, nearest": pl.from_pandas(images).join_asof(pl.from_pandas(readings), on="t_ms", strategy="nearest")["reading"].to_list(),
    "pandas, before": pd.merge_asof(images, readings, on="t_ms")["reading"].tolist(),
    "polars, before": pl.from_pandas(images).join_asof(pl.from_pandas(readings), on="t_ms")["reading"].to_list(),
}
query = "SELECT reading FROM images ASOF LEFT JOIN readings ON images.t_ms >= readings.t_ms ORDER BY images.t_ms"
seen["DuckDB, before"] = [row[0] for row in duckdb.sql(query).fetchall()]
for name, found in seen.items():
    print(f"{name}: {found}")
assert seen["pandas, nearest"] == ["at 5", "second at 15", "at 25"]
assert seen["polars, nearest"] == ["second at 15", "at 25", "at 25"]
assert seen["pandas, before"] == seen["polars, before"] == ["at 5", "second at 15", "at 25"]
assert seen["DuckDB, before"] == ["at 5", "first at 15", "at 25"]
PYTHON
