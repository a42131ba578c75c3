#!/usr/bin/env bash
# An episode has raw depth rows (uint16), one value of bytes for each step, as RLDS keeps what is no JPEG or PNG; and three more records follow.
# They are written and read with tfrecord, which needs no TensorFlow, by two workers (`shard`). What comes back?
# Guess: the bytes that were written; and half of the records for each worker.
# Seen with tfrecord 1.14.6 on 2026-11-29, without a word:
# - zeros at the end of a value are gone, where a feature has more than one value: rows of 8 bytes that end with pixels without a return (0)
#   have 4, 8 and 0 bytes. They become a NumPy array of type `S`, which has no zeros at its end. One value alone is left whole, so an episode
#   of one step is right
# - without an index file (`index_path=None`, as its examples have it) `shard` is not looked at: each worker yields every record
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check tfrecord==1.14.6 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from tfrecord.reader import tfrecord_loader
from tfrecord.tools.tfrecord2idx import create_index
from tfrecord.writer import TFRecordWriter

ROWS = [np.array(row, np.uint16).tobytes() for row in ([900, 910, 0, 0], [900, 910, 920, 930], [0, 0, 0, 0])]
writer = TFRecordWriter("episodes.tfrecord")
for rows in (ROWS, ROWS[:1], ROWS, ROWS):
    writer.write({"depth": (rows, "byte")})
writer.close()
create_index("episodes.tfrecord", "episodes.index")

whole, single, *_ = tfrecord_loader("episodes.tfrecord", None)
lengths = [len(row) for row in whole["depth"].tolist()]
print("written:", [len(row) for row in ROWS], "bytes; read:", lengths, "and of one step", len(single["depth"]))
assert lengths == [4, 8, 0] and single["depth"] == ROWS[0]
counts = {
    index: [sum(1 for _ in tfrecord_loader("episodes.tfrecord", index, shard=(worker, 2))) for worker in (0, 1)]
    for index in (None, "episodes.index")
}
print("records of each of two workers, without an index file and with it:", list(counts.values()))
assert counts == {None: [4, 4], "episodes.index": [2, 2]}
PYTHON
