#!/usr/bin/env bash
# Depth in metres and the torque of a joint are kept in Zarr as float32, small, by filters that its documentation offers: depth as millimetres in 16
# bits (FixedScaleOffset), torque as differences from one value to the next (Delta). What is read where a pixel is farther than 65.535 m, a little
# below zero, or without a return (NaN, infinite), and where one torque is NaN? Guess: an error or the nearest value; and one NaN.
# Seen with zarr 3.1.6 and numcodecs 0.16.6 on 2026-11-29:
# - 70 m are 4.464 m and -0.1 m are 65.436 m, without a word, as integers start anew; NaN and infinite are 0, with a RuntimeWarning of NumPy
# - of 1000 torques all 900 from the NaN on are NaN, without a word, to the end of the chunk
# - without any NaN most torques come back changed, by some 1e-6 Nm, as sums of differences are rounded each time; all behind a single spike of
#   1e6 Nm by up to 0.01 Nm. Delta of integers gives back what was written.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check zarr==3.1.6 numcodecs==0.16.6 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import warnings

import numpy as np
import zarr
from zarr.codecs.numcodecs import Delta, FixedScaleOffset

warnings.filterwarnings("ignore", message="Numcodecs codecs are not in the Zarr version 3 specification")
group = zarr.open_group("robot.zarr", mode="w")


def stored(name, values, codec):
    """Return what is read of values that were written through a filter, and what was said meanwhile."""
    array = group.create_array(name, shape=values.shape, dtype=values.dtype, chunks=values.shape, filters=[codec])
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        array[:] = values
        return array[:], [str(each.message) for each in said]


millimetres = FixedScaleOffset(offset=0, scale=1000, dtype="<f4", astype="<u2")
expected = {1.5: (1.5, 0), 70.0: (4.464, 0), -0.1: (65.436, 0), np.nan: (0, 1), np.inf: (0, 1)}
for number, (depth_m, (read_m, warned)) in enumerate(expected.items()):
    depth, said = stored(f"depth{number}", np.array([depth_m, 1.0], np.float32), millimetres)
    print(f"{depth_m} m is {depth[0]:.3f} m; said: {said}")
    assert np.allclose(depth, [read_m, 1.0], atol=1e-3) and len(said) == warned

torque = np.random.default_rng(0).normal(size=1000).astype(np.float32)
changed = {}
for name, value in {"plain": torque[100], "spike": 1e6, "nan": np.nan}.items():
    torque[100] = value
    read, said = stored(f"torque_{name}", torque, Delta(dtype="<f4"))
    changed[name] = np.delete(np.abs(read - torque), 100)
    print(f"{name}: {np.isnan(read).sum()} of {len(read)} are NaN, {(changed[name] != 0).mean():.0%} of the others changed, "
          f"by up to {np.nanmax(changed[name]):.1e} Nm; said: {said}")
    assert not said and np.isnan(read).sum() == (900 if name == "nan" else 0)
assert (changed["plain"] != 0).mean() > 0.5 and changed["plain"].max() < 1e-5
assert 0.003 < changed["spike"].max() < 0.05
counts = (torque[:100] * 1000).astype(np.int32)
assert np.array_equal(stored("counts", counts, Delta(dtype="<i4"))[0], counts)
PYTHON
