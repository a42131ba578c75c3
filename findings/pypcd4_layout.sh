#!/usr/bin/env bash
# Which layouts of sensor_msgs/PointCloud2 does pypcd4 read?
# Guess: all that the message can describe. Seen with pypcd4 1.5.1 on 2026-11-28:
#   row_step is not looked at: where rows are padded by the size of a point, the padding becomes points (8 instead of 6)
#   is_bigendian is not looked at: numbers of a big-endian cloud are garbled, without a word
#   fields listed in another order than their offsets are an error about the size of the buffer
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pypcd4==1.5.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
from types import SimpleNamespace

import numpy as np
from pypcd4 import PointCloud

HEIGHT, WIDTH = 2, 3
POINTS = np.arange(HEIGHT * WIDTH * 3, dtype=np.float32).reshape(HEIGHT, WIDTH, 3)


def cloud(padding=0, big=False, names="xyz"):
    rows = POINTS.astype(">f4" if big else "<f4").reshape(HEIGHT, -1).view(np.uint8)
    data = np.pad(rows, ((0, 0), (0, padding)), constant_values=255).reshape(-1)
    fields = [SimpleNamespace(name=n, offset=4 * "xyz".index(n), datatype=7, count=1) for n in names]
    return SimpleNamespace(
        height=HEIGHT, width=WIDTH, fields=fields, is_bigendian=big, point_step=12, row_step=12 * WIDTH + padding,
        data=data, is_dense=True, header=None,
    )


def read(message):
    try:
        return PointCloud.from_msg(message).numpy()
    except ValueError as error:
        return str(error)


plain, padded, big, unordered = read(cloud()), read(cloud(padding=12)), read(cloud(big=True)), read(cloud(names="zyx"))
print(f"plain: {plain.shape}; rows padded: {padded.shape}; big endian: {big[0].tolist()}; unordered: {unordered}")
assert np.array_equal(plain, POINTS.reshape(-1, 3))
assert padded.shape == (8, 3) and np.isnan(padded[3]).all()
assert big.shape == (6, 3) and not np.array_equal(big, plain)
assert unordered == "buffer size must be a multiple of element size"
PYTHON
