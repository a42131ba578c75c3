#!/usr/bin/env bash
# A lidar on a car, 1.723 m above a flat road with nothing on it, sees that road from half a metre to 120 m away. What is not ground, by Patchwork++, which
# splits a cloud into ground and "nonground", of which obstacles are made? Guess: nothing, or what is too far away is in neither.
# Seen with pypatchworkpp 1.4.1 on 2026-11-29, as it is set up, without a word:
# - ALL of the road that is nearer than 2.7 m (`min_range`) or farther than 80 m (`max_range`): 35 % of these points are "nonground", a ring of road about the car
# - points at (0, 0, 0), as drivers send lost returns, and NaN: "nonground" as well
# - indices of both are in the order of its zones, not in that of the cloud
# Between the two all is ground, also at other heights than `sensor_height` says (0.3 m).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pypatchworkpp==1.4.1 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
import pypatchworkpp

rng = np.random.default_rng(0)
range_m, azimuth_rad = rng.uniform(0.5, 120, 40_000), rng.uniform(-np.pi, np.pi, 40_000)


def ground(cloud):
    """Return which points are ground, the order of their indices, and how many are in either."""
    splitter = pypatchworkpp.patchworkpp(pypatchworkpp.Parameters())
    splitter.estimateGround(cloud)
    indices = splitter.getGroundIndices()
    return np.isin(np.arange(len(cloud)), indices), indices, len(indices) + len(splitter.getNongroundIndices())


def road(height_m):
    return np.c_[range_m * np.cos(azimuth_rad), range_m * np.sin(azimuth_rad), rng.normal(-height_m, 0.02, len(range_m)), rng.uniform(0.3, 1, len(range_m))]


cloud = road(1.723)
is_ground, indices, both = ground(cloud)
for low_m, high_m, share in ((0.5, 2.7, 0.0), (2.71, 79.9, 1.0), (80.1, 120, 0.0)):
    within = (range_m >= low_m) & (range_m <= high_m)
    print(f"{low_m} to {high_m} m: {is_ground[within].mean():.3f} ground")
    assert abs(is_ground[within].mean() - share) < 0.005
print(f"{1 - is_ground.mean():.2f} of all is nonground")
assert both == len(cloud) and 0.34 < 1 - is_ground.mean() < 0.37
assert (np.diff(indices) < 0).any()
for lost in (0.0, np.nan):
    cloud[::4, :3] = lost
    is_ground, _, both = ground(cloud)
    assert both == len(cloud) and not is_ground[::4].any()
is_ground, *_ = ground(road(0.3))
assert is_ground[(range_m > 2.71) & (range_m < 79.9)].mean() > 0.995
PYTHON
