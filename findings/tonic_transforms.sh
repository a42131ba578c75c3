#!/usr/bin/env bash
# A second of an event camera, 100,000 events all over 346 x 260 pixels, is augmented for training with the transforms of tonic, as arrays of its own type
# (`tonic.io.events_struct`). Guess: what their help says: a fifth of the time dropped, a box of a tenth to three tenths, noise without a drift, OFF as -1.
# Seen with tonic 1.7.0 on 2026-11-30, without a word:
# - `ToVoxelGrid`: a recording of OFF events alone is the same grid as one of ON events: +1 each, since OFF is set to -1 in an array of bool. As int8: -1
# - `DropEventByTime(0.2)`: the second cut out of a recording at 10 s loses nothing nine times in ten, and up to all else: the window is drawn from 0 on, not
#   from the first event. With times since 1970, nothing ever. `EventDrop` takes it, too
# - `DropEventByArea(area_ratio=(0.1, 0.3))` draws from 0.3 to 1. The ratio is of width and of height, so a box of 0.2 is 4 % of the area
# - `SpatialJitter` moves all by half a pixel up and left on average, since pixels are cut to whole ones, not rounded: even with hardly any noise
# - `EventDownsampling` to a quarter of the pixels, of a recording of ON events, by its "integrator": 44 times as many events, half of them OFF, with the
#   threshold of 0 that its help calls the default. By its "differentiator", all are OFF. With 1, ON alone. Times begin at 0 in each
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check tonic==1.7.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
import tonic.io
import tonic.transforms as transforms

SENSOR, COUNT, AT_US = (346, 260, 2), 100_000, 10_000_000
rng = np.random.default_rng(0)
np.random.seed(0)


def second(begin_us, polarity, dtype=tonic.io.events_struct):
    """Return the events of a second, in order of time, all over the sensor."""
    events = np.zeros(COUNT, dtype)
    events["x"], events["y"] = rng.integers(0, SENSOR[0], COUNT), rng.integers(0, SENSOR[1], COUNT)
    events["t"], events["p"] = begin_us + np.sort(rng.integers(0, 1_000_000, COUNT)), polarity
    return events


def dropped(transform, begin_us):
    """Return the shares of the events that are dropped, of 200 tries."""
    return np.array([1 - len(transform(second(begin_us, 1))) / COUNT for _ in range(200)])


int8 = np.dtype([("x", "i2"), ("y", "i2"), ("t", "i8"), ("p", "i1")])
off, on, off_int8 = (transforms.ToVoxelGrid(SENSOR, 5)(second(0, polarity, dtype)).sum() for polarity, dtype in ((0, tonic.io.events_struct), (1, int8), (0, int8)))
print(f"voxels: OFF {off:.0f}, ON {on:.0f}, OFF as int8 {off_int8:.0f}")
assert off > 80_000 and on > 80_000 and off_int8 < -80_000

for begin_us in (0, AT_US, 1_700_000_000_000_000):
    shares = dropped(transforms.DropEventByTime(0.2), begin_us)
    print(f"drop by time, from {begin_us / 1e6:.0f} s: nothing in {np.mean(shares == 0):.0%} of tries, up to {shares.max():.0%}")
    if begin_us == 0:
        assert np.allclose(shares, 0.2, atol=0.01)
    else:
        assert np.mean(shares == 0) > 0.8 and (shares.max() > 0.5) == (begin_us == AT_US)

box, between = dropped(transforms.DropEventByArea(SENSOR, 0.2), 0), dropped(transforms.DropEventByArea(SENSOR, (0.1, 0.3)), 0)
print(f"drop by area: 0.2 drops {box.mean():.1%}; (0.1, 0.3) drops {between.min():.0%} to {between.max():.0%}")
assert np.allclose(box, 0.04, atol=0.005)
assert between.min() > 0.08 and between.max() > 0.7

middle = second(0, 1)
middle["x"], middle["y"] = 100, 100
for variance in (0.05, 1):
    moved = transforms.SpatialJitter(SENSOR, variance, variance)(middle)
    print(f"jitter of variance {variance}: from 100 to {moved['x'].mean():.2f}, {moved['y'].mean():.2f} on average")
    assert np.allclose((moved["x"].mean(), moved["y"].mean()), 99.5, atol=0.02)

for method, threshold in (("integrator", 0), ("integrator", 1), ("differentiator", 0), ("differentiator", 1)):
    fewer = transforms.EventDownsampling(SENSOR, (173, 130), dt=10.0, downsampling_method=method, noise_threshold=threshold, differentiator_time_bins=2)
    events = fewer(second(AT_US, 1))
    print(f"{method}, threshold {threshold}: {len(events)} events from {events['t'].min()} us on, {events['p'].mean():.0%} ON")
    assert events["t"].min() < 100_000
    assert (events["p"].mean() == 1) == (threshold == 1)
    if threshold == 0:
        assert len(events) > 5 * COUNT if method == "integrator" else not events["p"].any()
PYTHON
