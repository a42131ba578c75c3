#!/usr/bin/env bash
# Episodes of an arm are MCAP files of FlatBuffers, by mcap-data-loader, which reads them for training: the position of a joint 100 times a second, 2.0 rad
# throughout, and the gripper's opening ten times. Its mean and standard deviation, by which a policy's inputs are normalised, come from `statistics()`; its
# samples, one for each time that all topics have been seen, from `iter_message_samples`. Guess: 2.0 and 0 rad; a hundred samples. Seen with mcap-data-loader
# 0.3.5 on 2026-11-30, without a word:
# - mean 0.2, standard deviation 0.6, of n = 1000: the SUM is of the samples, of which there are as many as messages of the slowest topic, and is divided by
#   the messages of each topic. Minimum and maximum are of the samples alone, too: a peak of 3.0 between two of them is not there
# - `list(iter_message_samples(...))` is a hundred times the LAST sample: each is the same dictionary, emptied for the next
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mcap-data-loader==0.3.5 mcap==1.6.0 flatbuffers==25.12.19 foxglove-schemas-flatbuffer==0.4.0 numpy==2.4.6
cat > episode.py <<'PYTHON'
import numpy as np
from mcap_data_loader.datasets.mcap_dataset import McapFlatBuffersSampleDataset, McapFlatBuffersSampleDatasetConfig
from mcap_data_loader.serialization.flb import FlatBuffersSchemas, McapFlatBuffersReader, McapFlatBuffersWriter

BEGIN_NS, PEAK = 1_700_000_000_000_000_000, 505
writer = McapFlatBuffersWriter()
writer.create_writer("episode.mcap")
for topic in ("/arm", "/gripper"):
    writer.register_channel(topic, FlatBuffersSchemas.FLOAT_ARRAY)
for tick in range(1000):
    at_ns = BEGIN_NS + tick * 10_000_000
    writer.add_float_array("/arm", [3.0 if tick == PEAK else 2.0], at_ns, at_ns)
    if tick % 10 == 0:
        writer.add_float_array("/gripper", [tick * 1e-4], at_ns, at_ns)
writer.unset_writer(finish=True)

dataset = McapFlatBuffersSampleDataset(McapFlatBuffersSampleDatasetConfig(data_root="episode.mcap", topics={"/arm", "/gripper"}))
arm = dataset.statistics()["/arm"]
print({name: np.ravel(value).round(3).tolist() for name, value in arm.items()})
assert np.allclose([arm["mean"], arm["std"]], [[0.2], [0.6]], atol=1e-3)
assert (arm["n"], arm["max"].item()) == (1000, 2.0)
with open("episode.mcap", "rb") as file:
    reader = McapFlatBuffersReader(file)
    topics = ["/arm", "/gripper"]
    one_by_one = [sample["/gripper"]["t"] - BEGIN_NS for sample in reader.iter_message_samples(topics)]
    listed = [sample.get("/gripper", {}).get("t", BEGIN_NS) - BEGIN_NS for sample in list(reader.iter_message_samples(topics))]
print(f"{len(one_by_one)} samples, from {one_by_one[0] / 1e9} to {one_by_one[-1] / 1e9} s; as a list {len(listed)}, at {set(listed)}")
assert len(set(one_by_one)) == len(listed) == 100
assert len(set(listed)) == 1
PYTHON
venv/bin/python episode.py > episode.txt 2> said.txt
cat episode.txt
if grep -iE 'warn|rate|count' said.txt; then exit 1; fi
