#!/usr/bin/env bash
# Robot episodes are kept in HDF5, depth in metres with the scale-offset filter of the library (`scaleoffset=3`: three decimals), encoder ticks with it as integers. A pixel
# without a return is NaN, or infinite. What is read? Guess: NaN and infinite come back, or an error; integers come back, or an error.
# Seen with h5py 3.16.0 and numpy 2.4.6 on 2026-11-30, without a word:
# - NaN is the SMALLEST value of its chunk: the pixel without a return is as near as the nearest obstacle
# - if it is the FIRST value of its chunk, the chunk is written without a word, and cannot be read: the upper left pixel without a return costs the image
# - one infinite value makes its whole chunk lossless, and more than twice as large: all comes back
# - integers with a number of bits (`scaleoffset=12`), as packed sensors have, keep the lowest 12 above the chunk's smallest: 4096 more than that is that. As few ticks a chunk fit,
#   a test with short episodes is well. `scaleoffset=True` counts the bits itself, and gives back what was written
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check h5py==3.16.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import h5py
import numpy as np


def back(values, **filters):
    """Return what is read of values that were written with these filters, and the bytes that they take."""
    with h5py.File("episode.h5", "w") as file:
        file.create_dataset("values", data=values, chunks=values.shape, **filters)
    with h5py.File("episode.h5") as file:
        kept = file["values"]
        return kept[:], kept.id.get_storage_size()


depth_m = np.linspace(0.5, 8.0, 1000, dtype=np.float32)
_, plain_size = back(depth_m, scaleoffset=3)
for pixel in (0, 10, 999):
    for missing in (np.nan, np.inf):
        written = depth_m.copy()
        written[pixel] = missing
        try:
            read, size = back(written, scaleoffset=3)
        except OSError as error:
            print(f"{missing} at {pixel}: {error}")
            assert (pixel, str(missing)) == (0, "nan")
            continue
        assert (pixel, str(missing)) != (0, "nan")
        others = np.arange(1000) != pixel
        error_m = np.abs(read[others] - written[others]).max()
        print(f"{missing} at {pixel} is {read[pixel]:.3f}; the others are {error_m:.4f} m off at most; {size} bytes, {plain_size} without")
        if np.isnan(missing):
            assert read[pixel] == written[others].min()
            assert 0.0004 < error_m < 0.00051
        else:
            assert np.array_equal(read, written)
            assert size > 2 * plain_size

ticks = np.arange(0, 6000, 6)
for filters in ({"scaleoffset": 12}, {"scaleoffset": True}):
    read, _ = back(ticks, **filters)
    wrong = read != ticks
    print(filters, "-", wrong.sum(), "of 1000 ticks differ:", ticks[wrong][:3], "are", read[wrong][:3])
    assert wrong.any() == (filters["scaleoffset"] is not True)
PYTHON
