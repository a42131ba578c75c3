"""Samples per second of `bagassets.open_dataset` and, by turns, of the nuscenes-devkit on the same dataset.

Each reads all images, the lidar points and the boxes of every sample, in a new process, as a training does in its first
epoch; the files are in the page cache::

    python -m benchmarks.reader [--seconds 20] [--trials 3] [--folder FOLDER] [--json FILE]

The devkit is that of `make test`, or of the environment whose interpreter BAGASSETS_DEVKIT_PYTHON names.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.common import ROOT, machine, markdown, median

__all__ = ["reader_table"]

_VERSION = "v1.0-demo"
_OURS = """
import json, sys, time
started = time.perf_counter()
import bagassets
dataset = bagassets.open_dataset(sys.argv[1])
cameras = [name for name in dataset.channels if name.startswith("CAM")]
length = len(dataset)
opened = time.perf_counter()
images = points = boxes = total = 0
for sample in dataset:
    for camera in cameras:
        image = sample.image(camera)
        images += 1
        total += int(image[::50, ::50].sum())
    points += len(sample.points("LIDAR_TOP"))
    boxes += len([box.center_m for box in sample.boxes])
ended = time.perf_counter()
"""
_DEVKIT = """
import json, sys, time
started = time.perf_counter()
import numpy as np
from PIL import Image
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud
nusc = NuScenes(sys.argv[2], sys.argv[1], verbose=False)
cameras = [row["channel"] for row in nusc.sensor if row["modality"] == "camera"]
length = len(nusc.sample)
opened = time.perf_counter()
images = points = boxes = total = 0
for sample in nusc.sample:
    for camera in cameras:
        image = np.array(Image.open(nusc.get_sample_data_path(sample["data"][camera])))
        images += 1
        total += int(image[::50, ::50].sum())
    lidar = sample["data"]["LIDAR_TOP"]
    points += LidarPointCloud.from_file(nusc.get_sample_data_path(lidar)).nbr_points()
    boxes += len([box.center for box in nusc.get_boxes(lidar)])
ended = time.perf_counter()
"""
_TELL = """
print(json.dumps({
    "open_s": opened - started, "samples_per_s": length / (ended - opened),
    "read": {"samples": length, "images": images, "points": points, "boxes": boxes, "total": total},
}))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each of the six drives of the demo")
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    devkit = os.environ.get("BAGASSETS_DEVKIT_PYTHON", str(ROOT / ".devkit-venv" / "bin" / "python"))
    if not Path(devkit).is_file():
        parser.error(f"{devkit} does not exist; `make test` makes the environment of the devkit")
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        made = ["-m", "bagassets", "demo", str(Path(name) / "demo"), "--seconds", str(options.seconds)]
        subprocess.run([sys.executable, *made], check=True, stdout=subprocess.DEVNULL)
        dataset = Path(name) / "demo" / "nuscenes"
        for path in (dataset / "samples").rglob("*.*"):
            path.read_bytes()
        found: dict[str, Any] = {"bagassets": [], "devkit": []}
        for _ in range(options.trials):
            found["bagassets"].append(_read(sys.executable, _OURS, dataset))
            found["devkit"].append(_read(devkit, _DEVKIT, dataset))
            rates = ", ".join(f"{name} {found[name][-1]['samples_per_s']:.1f}" for name in found)
            print(f"samples per second: {rates}", flush=True)
    read = [trial.pop("read") for trials in found.values() for trial in trials]
    if any(one != read[0] for one in read):
        sys.exit(f"they do not read the same: {read}")
    found["read"] = read[0]
    print(reader_table(found))
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": machine(), **found}, indent=1) + "\n", "utf-8")


def reader_table(found: dict[str, Any]) -> str:
    """Return the table of `reader.json`: medians."""
    names = {"bagassets": "`bagassets.open_dataset`", "devkit": "nuscenes-devkit"}
    rows = [
        [
            title,
            median([trial["open_s"] for trial in found[name]]),
            median([trial["samples_per_s"] for trial in found[name]]),
        ]
        for name, title in names.items()
    ]
    read = found["read"]
    contents = (
        f"{read['samples']} samples, {read['images']} images, {read['points']} points, {read['boxes']} boxes"
    )
    table = markdown(["", "import and open, s", "samples per second"], rows)
    return f"{table}\nMedians of {len(found['bagassets'])}; {contents}.\n"


def _read(python: str, code: str, dataset: Path) -> dict[str, Any]:
    """Read a dataset in a new process and return what it prints."""
    command = [python, "-c", code + _TELL, str(dataset), _VERSION]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


if __name__ == "__main__":
    main()
