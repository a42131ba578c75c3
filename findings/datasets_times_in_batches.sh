#!/usr/bin/env bash
# A table of frames has the time of each as float64 seconds since 1970, 33 ms apart, and is read with Hugging Face `datasets` in the format
# that training takes. Guess: the column says float64 in `features`, so float64 comes out.
# Seen with datasets 4.8.5 on 2026-11-28: `with_format("numpy")` gives float32, whose steps are 128 s there: all frames of two minutes have
# one time, 1,700,000,000, without a word, while `features` goes on saying float64 (a list of features of a frame likewise). Without a format,
# and as int64 nanoseconds, times are whole; so they are with `with_format("numpy", dtype=...)`, which then holds for integers as well:
# as float64, nanoseconds are rounded to 256.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check datasets==4.8.5 numpy==2.2.6
cd "$folder"
HF_HUB_OFFLINE=1 HF_HOME="$folder/home" venv/bin/python - <<'PYTHON'
import numpy as np
from datasets import Dataset

TIMES_NS = 1_700_000_000_000_000_000 + 33_333_333 * np.arange(4)
frames = Dataset.from_dict({"time_s": TIMES_NS / 1e9, "time_ns": TIMES_NS, "state": [[1e9 + 0.25, 0.1]] * 4})
print(frames.features)
assert {str(frames.features[name].dtype) for name in ("time_s", "time_ns")} == {"float64", "int64"}
assert frames["time_s"][:] == (TIMES_NS / 1e9).tolist()

batch = frames.with_format("numpy")[:]
wide = frames.with_format("numpy", dtype=np.float64)[:]
print("numpy:", {name: (str(values.dtype), values.tolist()) for name, values in batch.items()})
print("numpy, float64:", wide["time_ns"].astype(np.int64) - TIMES_NS, "ns off")
assert batch["time_s"].dtype == np.float32
assert set(batch["time_s"].tolist()) == {1_700_000_000.0}
assert batch["state"].dtype == np.float32
assert batch["time_ns"].tolist() == TIMES_NS.tolist()
assert wide["time_s"].tolist() == (TIMES_NS / 1e9).tolist()
assert wide["time_ns"].dtype == np.float64
assert (wide["time_ns"].astype(np.int64) != TIMES_NS).any()
PYTHON
