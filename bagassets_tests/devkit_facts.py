"""Do what docs/devkit.md is about with the real nuscenes-devkit; runs in the devkit's own environment.

Usage: python devkit_facts.py DATAROOT VERSION FOLDER

It knows nothing of bagassets. FOLDER is for copies of the tables, changed so that something is wrong with them.
"""

import contextlib
import importlib
import io
import json
import re
import shutil
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
from nuscenes.can_bus.can_bus_api import NuScenesCanBus
from nuscenes.eval.common.config import config_factory
from nuscenes.eval.common.loaders import (
    add_center_dist,
    filter_eval_boxes,
    get_samples_of_custom_split,
    load_gt,
    load_gt_of_sample_tokens,
)
from nuscenes.eval.detection.data_classes import DetectionBox
from nuscenes.eval.prediction.splits import get_prediction_challenge_split
from nuscenes.map_expansion.map_api import NuScenesMap
from nuscenes.nuscenes import NuScenes
from nuscenes.prediction import PredictHelper
from nuscenes.scripts import export_kitti, export_poses
from nuscenes.scripts.export_pointclouds_as_obj import export_scene_pointcloud
from nuscenes.utils.data_classes import RadarPointCloud
from nuscenes.utils.splits import get_scenes_of_split

SPLIT = "custom_val"


def said(call, *arguments, **options):
    """What a call that fails raises: its type and first line; "" if it does not fail."""
    try:
        call(*arguments, **options)
    except Exception as error:  # noqa: BLE001  (whatever it is, it is what is looked for)
        return f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0]}"
    return ""


def splits(nusc):
    ours = {scene["name"] for scene in nusc.scene}
    tokens = get_samples_of_custom_split(SPLIT, nusc)
    return {
        "load_gt": said(load_gt, nusc, SPLIT, DetectionBox),
        "by_tokens": len(load_gt_of_sample_tokens(nusc, tokens, DetectionBox).sample_tokens),
        "samples": len(tokens),
        "val": [len(get_scenes_of_split("val", nusc)), len(ours & set(get_scenes_of_split("val", nusc)))],
        "val_refused": said(load_gt, nusc, "val", DetectionBox),
    }


def listed(nusc):
    """Boxes of each scene: listed, all, in the last keyframe; and what is said of scenes that begin together."""
    firsts = [nusc.get("sample", scene["first_sample_token"]) for scene in nusc.scene]
    for number, first in enumerate(firsts):
        first["timestamp"] += number  # µs: apart, as those of this dataset may not be
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        nusc.list_scenes()
    counted = [int(number) for number in re.findall(r"#anns:(\d+)", out.getvalue())]
    in_order = sorted(
        zip([first["timestamp"] for first in firsts], nusc.scene, strict=True), key=lambda one: one[0]
    )
    found = []
    for (_, scene), number in zip(in_order, counted, strict=True):
        boxes = [len(row["anns"]) for row in nusc.sample if row["scene_token"] == scene["token"]]
        found.append([number, sum(boxes), len(nusc.get("sample", scene["last_sample_token"])["anns"])])
    apart, firsts[1]["timestamp"] = firsts[1]["timestamp"], firsts[0]["timestamp"]
    together = said(nusc.list_scenes)
    firsts[1]["timestamp"] = apart
    return found, together


def exported(nusc, folder):
    """What scripts that come with the devkit make of a dataset of one's own, or say."""
    export_kitti.NuScenes = lambda **_: nusc  # it would look in /data/sets/nuscenes
    scene, agents = nusc.scene[0], PredictHelper(nusc)
    first = nusc.get("sample", scene["first_sample_token"])["data"]["LIDAR_TOP"]
    lidar = [row for row in nusc.sample_data if row["channel"] == "LIDAR_TOP"]
    return {
        "kitti": [
            said(export_kitti.KittiConverter(str(folder), split=split).nuscenes_gt_to_kitti)
            for split in (SPLIT, "train")
        ],
        "poses": len(export_poses.get_poses(nusc, scene["token"])),
        "readings": sum(
            nusc.get("sample", row["sample_token"])["scene_token"] == scene["token"] for row in lidar
        ),
        "begins": nusc.get("sample_data", first)["prev"],
        "coordinates": said(export_poses.derive_latlon, nusc.log[0]["location"], []),
        "points": said(export_scene_pointcloud, nusc, f"{folder}/scene.obj", scene["token"], verbose=False),
        "futures": sum(
            len(
                agents.get_future_for_agent(
                    row["instance_token"], row["sample_token"], 1.0, in_agent_frame=True
                )
            )
            for row in nusc.sample_annotation
        ),
        "prediction": said(get_prediction_challenge_split, SPLIT, nusc.dataroot),
    }


def maps(dataroot, name, folder):
    """What is said of a log that is in no map, and of a map without its picture."""
    said_of = {}
    for kind, change in (
        ("log_in_no_map", {"log_tokens": []}),
        ("no_picture", {"filename": "maps/gone.png"}),
    ):
        copy = Path(folder) / kind
        shutil.copytree(Path(dataroot) / name, copy / name)
        (copy / "maps").symlink_to(Path(dataroot) / "maps")
        rows = json.loads((copy / name / "map.json").read_text())
        (copy / name / "map.json").write_text(json.dumps([{**row, **change} for row in rows]))
        said_of[kind] = said(NuScenes, name, str(copy), verbose=False)
    return said_of


FIELDS = "x y z dyn_prop id rcs vx vy vx_comp vy_comp is_quality_valid ambig_state x_rms y_rms invalid_state pdh0 vx_rms vy_rms"
KINDS = ["<f4"] * 3 + ["<i1", "<i2"] + ["<f4"] * 5 + ["<i1"] * 8


def radar(folder):
    """How many of two targets the reader returns, or what it says."""
    valid = np.zeros(2, list(zip(FIELDS.split(), KINDS, strict=True)))
    valid["x"], valid["ambig_state"] = [10.0, 20.0], 3
    first_invalid, no_place = valid.copy(), valid.copy()
    first_invalid["invalid_state"][0] = 4  # "valid cluster with low RCS", by the reader's own docstring
    no_place["rcs"][0] = np.nan

    def read(targets, end=b"\n"):
        sizes = " ".join(str(np.dtype(kind).itemsize) for kind in KINDS)
        types = " ".join("F" if kind == "<f4" else "I" for kind in KINDS)
        text = (
            f"# .PCD v0.7\nVERSION 0.7\nFIELDS {FIELDS}\nSIZE {sizes}\nTYPE {types}\nCOUNT {'1 ' * 17}1\n"
            f"WIDTH {len(targets)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(targets)}\nDATA binary\n"
        )
        path = Path(folder) / "radar.pcd"
        path.write_bytes(text.encode() + targets.tobytes() + end)
        try:
            return RadarPointCloud.from_file(str(path)).nbr_points()
        except AssertionError:
            return "AssertionError"

    return {
        "valid": read(valid), "without_a_byte_more": read(valid, b""), "no_target": read(valid[:0]),
        "valid_by_its_docstring": read(first_invalid), "nan_in_the_first": read(no_place),
    }  # fmt: skip


def evaluated(nusc):
    """How many boxes are left by the evaluation's filter, of all; and where one has no point."""
    tokens = [row["token"] for row in nusc.sample]
    ranges = config_factory("detection_cvpr_2019").class_range

    def left():
        boxes = add_center_dist(nusc, load_gt_of_sample_tokens(nusc, tokens, DetectionBox))
        return len(filter_eval_boxes(nusc, boxes, ranges).all)

    before = left()
    row = nusc.sample_annotation[0]
    row["num_lidar_pts"] = row["num_radar_pts"] = 0
    lacking = nusc.sample[0]["data"].pop("LIDAR_TOP")
    without_lidar = said(left)
    nusc.sample[0]["data"]["LIDAR_TOP"] = lacking
    return {"before": before, "one_without_points": left(), "without_lidar": without_lidar}


def velocities(nusc, factor):
    """How many boxes have no velocity if keyframes were so many times farther apart."""
    first = nusc.sample[0]["timestamp"]
    for row in nusc.sample:
        row["timestamp"] = first + (row["timestamp"] - first) * factor
    return sum(bool(np.isnan(nusc.box_velocity(row["token"])).any()) for row in nusc.sample_annotation)


def main(dataroot, name, folder):
    nusc = NuScenes(name, dataroot, verbose=False)
    facts = {
        "version": version("nuscenes-devkit"),
        "splits": splits(nusc),
        "listed": listed(nusc),
        "tracking": said(importlib.import_module, "nuscenes.eval.tracking.evaluate"),
        "map_expansion": said(NuScenesMap, dataroot, nusc.log[0]["location"]),
        "can_bus": said(NuScenesCanBus, dataroot),
        "video": said(nusc.render_scene_channel, nusc.scene[0]["token"], "CAM_FRONT"),
        "maps": maps(dataroot, name, folder),
        "radar": radar(folder),
        "exported": exported(nusc, folder),
        "evaluated": evaluated(nusc),
        "without_velocity": [velocities(nusc, 1), velocities(nusc, 4), len(nusc.sample_annotation)],
    }
    sys.stdout.write(json.dumps(facts) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
