"""Score boxes with the real DetectionEval: those of the dataset itself, or results made elsewhere.

Usage: python devkit_eval.py DATAROOT VERSION SPLIT FOLDER [RESULTS]

RESULTS is a JSON file, sample token -> detections.
"""

import json
import sys
from pathlib import Path

from nuscenes.eval.common.config import config_factory
from nuscenes.eval.common.loaders import get_samples_of_custom_split
from nuscenes.eval.detection.evaluate import DetectionEval
from nuscenes.eval.detection.utils import category_to_detection_name
from nuscenes.nuscenes import NuScenes


def result(nusc, annotation):
    attributes = [nusc.get("attribute", token)["name"] for token in annotation["attribute_tokens"]]
    velocity = nusc.box_velocity(annotation["token"])[:2].tolist()
    return {
        "sample_token": annotation["sample_token"],
        "translation": annotation["translation"],
        "size": annotation["size"],
        "rotation": annotation["rotation"],
        "velocity": velocity,
        "detection_name": category_to_detection_name(annotation["category_name"]),
        "detection_score": 1.0,
        "attribute_name": attributes[0] if attributes else "",
    }


def main(dataroot, version, split, folder, given=None):
    nusc = NuScenes(version, dataroot, verbose=False)
    results = {}
    velocities = {row["token"]: nusc.box_velocity(row["token"]).tolist() for row in nusc.sample_annotation}
    for token in get_samples_of_custom_split(split, nusc):
        annotations = [nusc.get("sample_annotation", ann) for ann in nusc.get("sample", token)["anns"]]
        results[token] = [
            result(nusc, annotation)
            for annotation in annotations
            if category_to_detection_name(annotation["category_name"]) is not None
        ]
    if given is not None:
        theirs = json.loads(Path(given).read_text())
        results = {token: theirs[token] for token in results}
    path = Path(folder) / "results.json"
    path.write_text(json.dumps({"meta": {"use_lidar": True}, "results": results}))
    evaluation = DetectionEval(
        nusc, config_factory("detection_cvpr_2019"), str(path), split, folder, verbose=False
    )
    metrics, _ = evaluation.evaluate()
    summary = metrics.serialize()
    scores = {
        "samples": len(results),
        "aps": summary["mean_dist_aps"],
        "errors": summary["label_tp_errors"],
        "velocities": velocities,
    }
    sys.stdout.write(json.dumps(scores) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
