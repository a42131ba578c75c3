#!/usr/bin/env bash
# Episodes of a robot become an RLDS dataset, as those of Open X-Embodiment are: TensorFlow Datasets with a feature `steps`. Each step has its time in
# seconds since 1970, `np.float64`, 33 ms apart, and a northing in metres. What is read? Guess: float64, as the feature says.
# Seen with tensorflow-datasets 4.9.10 on 2026-11-29, without TensorFlow, written as array_record and read by `as_data_source`:
# - float64 comes out, and each number has been a float32 on the way, without a word: all five steps have one time, 1,700,000,000 (steps
#   of it are 128 s), and a northing of 5,330,004.65 m is 5,330,004.5. The file has a float list, the only kind that a TFRecord example has
# - as int64 nanoseconds, times are whole; as `Tensor(…, encoding="zlib")` or "bytes", float64 is kept to the bit
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check tensorflow-datasets==4.9.10 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
import tensorflow_datasets as tfds

START_S, STEP_S = 1_700_000_000.0, 0.033
TIMES = [START_S + number * STEP_S for number in range(5)]
NORTHING_M = 5_330_004.654321
FEATURES = {
    "time_s": np.float64,
    "northing_m": np.float64,
    "time_ns": np.int64,
    "zlib_s": tfds.features.Tensor(shape=(1,), dtype=np.float64, encoding="zlib"),
    "bytes_s": tfds.features.Tensor(shape=(1,), dtype=np.float64, encoding="bytes"),
}


class Arm(tfds.core.GeneratorBasedBuilder):
    """One episode of five steps."""

    VERSION = tfds.core.Version("1.0.0")

    def _info(self):
        features = tfds.features.FeaturesDict({"steps": tfds.features.Dataset(FEATURES)})
        return tfds.core.DatasetInfo(builder=self, features=features)

    def _split_generators(self, _):
        return {"train": self._generate_examples()}

    def _generate_examples(self):
        yield "episode", {
            "steps": [
                {"time_s": time, "northing_m": NORTHING_M, "time_ns": int(time * 1e9), "zlib_s": [time], "bytes_s": [time]}
                for time in TIMES
            ]
        }


builder = Arm(data_dir="data", file_format="array_record")
builder.download_and_prepare()
(episode,) = builder.as_data_source("train")
steps = list(episode["steps"])
for name in FEATURES:
    print(name, steps[0][name].dtype, [np.ravel(step[name])[0].item() for step in steps])
assert all(step["time_s"] == START_S and step["northing_m"] == 5_330_004.5 and step["time_s"].dtype == np.float64 for step in steps)
assert [step["zlib_s"][0] for step in steps] == [step["bytes_s"][0] for step in steps] == TIMES
assert [int(step["time_ns"]) for step in steps] == [int(time * 1e9) for time in TIMES]
PYTHON
