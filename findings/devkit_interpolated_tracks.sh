#!/usr/bin/env bash
# Where does nuscenes-devkit put a box of a track in the keyframes that the track misses, as evaluation of tracking does for ground
# truth without lidar points and for results? Guess: on the way between its neighbours, by time. Seen with nuscenes-devkit 1.2.0 on
# 2026-11-28: mirrored. `interpolate_tracks` gives the share of the left neighbour to the right one. With one keyframe missing in
# the middle nobody notices; with three, a car that drives from 0 to 40 m at constant speed is at 0, 30, 20, 10, 40 m.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check nuscenes-devkit==1.2.0
"$folder/venv/bin/python" - <<'PYTHON'
from collections import defaultdict

from nuscenes.eval.common.config import config_factory
from nuscenes.eval.tracking.data_classes import TrackingBox
from nuscenes.eval.tracking.loaders import interpolate_tracks

config_factory("tracking_nips_2019")  # TrackingBox asks it for the names of classes


def car(x):
    return TrackingBox(
        translation=(x, 0, 0), size=(2, 4, 1.5), rotation=(1, 0, 0, 0), velocity=(20, 0), tracking_id="car", tracking_name="car"
    )


def positions(known, keyframes):
    """Return x of the car at keyframes 0.5 s apart, of which it is known in some."""
    tracks = defaultdict(list, {n * 500_000: [car(known[n])] if n in known else [] for n in range(keyframes)})
    return [boxes[0].translation[0] for _, boxes in sorted(interpolate_tracks(tracks).items())]


one, three = positions({0: 0.0, 2: 20.0}, 3), positions({0: 0.0, 4: 40.0}, 5)
print("one missing:  ", one)
print("three missing:", three)
assert one == [0, 10, 20]
assert three == [0, 30, 20, 10, 40]
PYTHON
