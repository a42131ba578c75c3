#!/usr/bin/env bash
# What do the info files of mmdetection3d (tools/create_data.py nuscenes) hold for a dataset with splits of its own in splits.json,
# which nuscenes-devkit 1.2 reads? Guess: they follow it, or refuse. Seen with mmdet3d 1.4.0 on 2026-11-28: neither. A scene whose
# name is not in nuScenes' own list of training scenes goes to validation: for names of one's own the training file is empty, the
# validation file has everything, those meant for training included, and the exit status is 0. Its evaluation then asks
# for nuScenes' own `val`, too. Further silent changes: a category outside of ten keeps its long name, which no model knows; the
# velocity of a box without neighbours is NaN. Six cameras are expected by name, else it is a KeyError.
# The converter is the file in the wheel, and the devkit the real one; torch and what else mmdet3d imports is 2 GB that this path
# does not use, so four helpers of mmengine are stood in for.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check nuscenes-devkit==1.2.0
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps mmdet3d==1.4.0
cd "$folder"
venv/bin/python - <<'PYTHON'
import ast
import importlib.util
import json
import pickle
import sys
import types
from pathlib import Path

import numpy as np
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.splits import get_scenes_of_split

VERSION, ROOT = "v1.0-trainval", Path("data")
CAMERAS = [f"CAM_{name}" for name in ("FRONT", "FRONT_RIGHT", "FRONT_LEFT", "BACK", "BACK_LEFT", "BACK_RIGHT")]
SPLITS = {"yard_train": ["drive-a", "drive-b"], "yard_val": ["drive-c"]}  # `train` would mean nuScenes' own


def dataset():
    """Write a dataset of three scenes with a keyframe and a police car each, and splits of its own."""
    names = [name for scenes in SPLITS.values() for name in scenes]
    pose = {"translation": [0.0, 0.0, 0.0], "rotation": [1.0, 0.0, 0.0, 0.0]}
    channels = ["LIDAR_TOP", *CAMERAS]
    tables = {name: [] for name in ("attribute", "visibility")}
    tables["category"] = [{"token": "police", "name": "vehicle.emergency.police", "description": ""}]
    tables["sensor"] = [
        {"token": c, "channel": c, "modality": "camera" if c in CAMERAS else "lidar"} for c in channels
    ]
    intrinsic = [[100.0, 0.0, 50.0], [0.0, 100.0, 50.0], [0.0, 0.0, 1.0]]
    tables["calibrated_sensor"] = [
        {"token": c, "sensor_token": c, "camera_intrinsic": intrinsic if c in CAMERAS else [], **pose} for c in channels
    ]
    tables["log"] = [{"token": "log", "logfile": "", "vehicle": "", "date_captured": "", "location": "yard"}]
    tables["map"] = [{"token": "map", "log_tokens": ["log"], "category": "semantic_prior", "filename": "map.png"}]
    tables["scene"] = [
        {"token": n, "name": n, "log_token": "log", "nbr_samples": 1, "first_sample_token": n, "last_sample_token": n,
         "description": ""}
        for n in names
    ]  # fmt: skip
    tables["sample"] = [
        {"token": n, "scene_token": n, "timestamp": 10**15 + i, "prev": "", "next": ""} for i, n in enumerate(names)
    ]
    tables["ego_pose"] = [{"token": n, "timestamp": 10**15, **pose} for n in names]
    tables["sample_data"] = [
        {"token": n + c, "sample_token": n, "ego_pose_token": n, "calibrated_sensor_token": c, "timestamp": 10**15,
         "fileformat": "", "is_key_frame": True, "height": 100, "width": 100, "filename": f"{n}.bin", "prev": "", "next": ""}
        for n in names for c in channels
    ]  # fmt: skip
    tables["instance"] = [
        {"token": n, "category_token": "police", "nbr_annotations": 1, "first_annotation_token": n,
         "last_annotation_token": n}
        for n in names
    ]  # fmt: skip
    tables["sample_annotation"] = [
        {"token": n, "sample_token": n, "instance_token": n, "visibility_token": "", "attribute_tokens": [],
         "translation": [10.0, 0.0, 0.0], "size": [2.0, 4.0, 1.5], "rotation": [1.0, 0.0, 0.0, 0.0], "prev": "",
         "next": "", "num_lidar_pts": 5, "num_radar_pts": 0}
        for n in names
    ]  # fmt: skip
    (ROOT / VERSION).mkdir(parents=True)
    for name, rows in {**tables, "splits": SPLITS}.items():
        (ROOT / VERSION / f"{name}.json").write_text(json.dumps(rows))
    for name in ["map.png", *(f"{n}.bin" for n in names)]:
        (ROOT / name).touch()


def converter():
    """Return the module of the wheel, with stand-ins for what it imports from mmengine, mmcv and mmdet3d."""
    package = Path(importlib.util.find_spec("mmdet3d").submodule_search_locations[0])
    utilities = ast.parse((package / "datasets/convert_utils.py").read_text())
    (mapping,) = (
        ast.literal_eval(node.value)
        for node in utilities.body
        if isinstance(node, ast.Assign) and node.targets[0].id == "NuScenesNameMapping"
    )
    contents = {
        "mmcv": {},
        "mmengine": {
            "is_filepath": lambda path: isinstance(path, str | Path),
            "check_file_exist": lambda path: Path(path).stat(),
            "track_iter_progress": iter,
            "dump": lambda data, path: Path(path).write_bytes(pickle.dumps(data)),
        },
        "mmdet3d": {},
        "mmdet3d.datasets": {},
        "mmdet3d.datasets.convert_utils": {"NuScenesNameMapping": mapping},
        "mmdet3d.structures": {"points_cam2img": None},
    }
    for name, content in contents.items():
        sys.modules[name] = types.ModuleType(name)
        vars(sys.modules[name]).update(content)
    path = package / ".mim/tools/dataset_converters/nuscenes_converter.py"
    spec = importlib.util.spec_from_file_location("nuscenes_converter", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


dataset()
by_devkit = get_scenes_of_split("yard_train", NuScenes(VERSION, str(ROOT), verbose=False))
converter().create_nuscenes_infos(str(ROOT), "own", VERSION)
written = {
    split: pickle.loads((ROOT / f"own_infos_{split}.pkl").read_bytes())["infos"] for split in ("train", "val")
}
print("devkit: training scenes", by_devkit)
print("mmdet3d:", {split: [info["token"] for info in infos] for split, infos in written.items()})
print("names", written["val"][0]["gt_names"], "velocity", written["val"][0]["gt_velocity"])
assert by_devkit == SPLITS["yard_train"]
assert written["train"] == []
assert [info["token"] for info in written["val"]] == ["drive-a", "drive-b", "drive-c"]
assert written["val"][0]["gt_names"].tolist() == ["vehicle.emergency.police"]
assert np.isnan(written["val"][0]["gt_velocity"]).all()
PYTHON
