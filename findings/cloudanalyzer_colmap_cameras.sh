#!/usr/bin/env bash
# A camera that COLMAP has posed (cameras.txt, images.txt) is brought into CloudAnalyzer, which renders splats as it sees them (`load_cameras`, `c2w_to_viewmat`, by which
# `ca rendered-evaluate` renders). A point is 10 m ahead of it, 1 m to the right. The camera is calibrated with one of four of COLMAP's models that are supported.
# Guess: the point is 10 m ahead, and its pixel is COLMAP's, or off by what the lens distorts, which splats do not have.
# Seen with cloudanalyzer 0.6.0 and pycolmap 4.2.1 on 2026-11-30, without a word: it is 10 m BEHIND: poses of COLMAP (z ahead) are taken for those of NeRFs (z behind), which
# the same camera has right as a transforms.json. And RADIAL, whose parameters are f, cx, cy, k1, k2, has fx = f, fy = cx, cx = cy and cy = k1: 500, 320, 240, -0.1
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check cloudanalyzer==0.6.0 open3d==0.19.0 pycolmap==4.2.1 numpy==2.4.6
venv/bin/python - <<'PYTHON'
import json
from pathlib import Path

import numpy as np
import pycolmap
from ca.core.cameras import c2w_to_viewmat, load_cameras

POINT_M = np.array([1.0, 0.0, 10.0])  # in the camera's frame, which is the world's: x right, y down, z ahead
MODELS = {
    "SIMPLE_PINHOLE": ([500, 320, 240], (500, 500, 320, 240)),
    "PINHOLE": ([500, 510, 320, 240], (500, 510, 320, 240)),
    "SIMPLE_RADIAL": ([500, 320, 240, -0.1], (500, 500, 320, 240)),
    "RADIAL": ([500, 320, 240, -0.1, 0.01], (500, 320, 240, -0.1)),
}
for model, (params, seen) in MODELS.items():
    Path("cameras.txt").write_text(f"1 {model} 640 480 {' '.join(map(str, params))}\n")
    Path("images.txt").write_text("1 1 0 0 0 0 0 0 1 front.png\n\n")
    reconstruction = pycolmap.Camera(model=model, width=640, height=480, params=params)
    pixel = reconstruction.img_from_cam(POINT_M[None])[0]
    (camera,) = load_cameras(".").frames
    found = (camera.fx, camera.fy, camera.cx, camera.cy)
    place_m = (c2w_to_viewmat(camera.c2w) @ [*POINT_M, 1])[:3]
    print(f"{model}: the point at {place_m.tolist()}, fx, fy, cx, cy {found}; COLMAP's focal lengths {reconstruction.focal_length_x:g}, pixel {pixel.round(1).tolist()}")
    assert place_m.tolist() == [1, 0, -10] and found == seen
    assert reconstruction.params_info.startswith("f, cx, cy") == (model != "PINHOLE")

nerf_pose = np.diag([1.0, -1.0, -1.0, 1.0]).tolist()  # the same camera: y up, z behind
Path("transforms.json").write_text(json.dumps({"w": 640, "h": 480, "fl_x": 500, "cx": 320, "cy": 240, "frames": [{"file_path": "front.png", "transform_matrix": nerf_pose}]}))
(camera,) = load_cameras("transforms.json").frames
place_m = (c2w_to_viewmat(camera.c2w) @ [*POINT_M, 1])[:3]
print(f"transforms.json: the point at {place_m.tolist()}")
assert place_m.tolist() == POINT_M.tolist()
PYTHON
