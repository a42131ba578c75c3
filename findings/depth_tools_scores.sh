#!/usr/bin/env bash
# A network's depth of a floor, 1 to 4 m away, is aligned by scale and shift and scored with depth-tools: d1, the share of pixels within a factor of 1.25 (and d2, d3). A quarter of the pixels is aligned to below
# zero, as happens near the camera. And a mask of weights (floats) is clipped to what the sensor sees, `DepthClip((0.5, 10)).on_mask`. Guess: negative depths are wrong, d1 is 0.75; the weights stay.
# Seen with depth-tools 0.8.0 on 2026-11-30, without a word:
# - d1, d2 and d3 are 1.0: of a negative depth both ratios are negative, so less than 1.25. If all is negative, that is a perfect score, too; `mse` tells
# - all weights become 0, as a depth would have to be above the maximum AND below the minimum to be kept; with a boolean mask all is right. A weighted loss is then 0 or NaN
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check depth-tools==0.8.0 numpy==2.4.6 matplotlib==3.11.2 pillow==13.0.0 scipy==1.17.1 h5py==3.16.0 pandas==2.3.3 typing_extensions==4.16.0 2>/dev/null
cat > scores.py <<'PYTHON'
import depth_tools
import numpy as np

truth = np.linspace(1, 4, 400, dtype=np.float32).reshape(1, 20, 20)
mask = np.ones_like(truth, dtype=bool)
for share in (0.25, 1.0):
    guess = truth.copy()
    guess.ravel()[: round(400 * share)] = -0.3
    scores = {f"d{x}": float(depth_tools.dx_loss(pred=guess, gt=truth, mask=mask, x=x, verify_args=True)) for x in (1, 2, 3)}
    print(f"{share:.0%} of the depths are -0.3 m: {scores}, mse {depth_tools.mse_loss(pred=guess, gt=truth, mask=mask):.2f}")
    assert set(scores.values()) == {1.0}
far = truth * 2
print("and twice as far: d1", depth_tools.dx_loss(pred=far, gt=truth, mask=mask, x=1))
assert depth_tools.dx_loss(pred=far, gt=truth, mask=mask, x=1) == 0

clip = depth_tools.DepthClip((0.5, 10.0))
kept = {kind.__name__: float(clip.on_mask(gt_depth=truth, mask=mask.astype(kind), verify_args=True).mean()) for kind in (np.bool_, np.float32)}
print("mean of the mask, clipped:", kept)
assert kept == {"bool": 1.0, "float32": 0.0}
PYTHON
venv/bin/python -W error scores.py
