"""Score results that were made elsewhere with the real DetectionEval.

Usage: python devkit_eval.py DATAROOT VERSION SPLIT FOLDER RESULTS

RESULTS is a JSON file, sample token -> detections.
"""

import json
import sys
from pathlib import Path

from nuscenes.eval.common.config import config_factory
from nuscenes.eval.common.loaders import get_samples_of_custom_split
from nuscenes.eval.detection.evaluate import DetectionEval
from nuscenes.nuscenes import NuScenes


def main(dataroot, version, split, folder, given):
    nusc = NuScenes(version, dataroot, verbose=False)
    velocities = {row["token"]: nusc.box_velocity(row["token"]).tolist() for row in nusc.sample_annotation}
    theirs = json.loads(Path(given).read_text())
    results = {token: theirs[token] for token in get_samples_of_custom_split(split, nusc)}
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
