"""Samples per second of `bagassets.open_dataset`, of the nuscenes-devkit and of a bare loop, by turns on one dataset.

Each reads all images, the lidar points and the boxes of every sample, three epochs long, in one process and with two
workers; the files are in the page cache. The bare loop has a list of the files, `cv2.imdecode` and `np.fromfile`, and no
boxes. Workers are those of a `torch.utils.data.DataLoader` if PyTorch is there, else of a `multiprocessing.Pool`, forked,
and give back counts only, as handing over images costs everyone the same::

    python -m benchmarks.reader [--seconds 20] [--trials 3] [--torch FOLDER] [--folder FOLDER] [--json FILE]

The devkit is that of `make test`, or of the environment whose interpreter BAGASSETS_DEVKIT_PYTHON names. `--torch` names
the site-packages of an environment of the same Python that has PyTorch, such as that of `make test-lerobot`.
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
_EPOCHS = 3
_READERS = {
    "bare": """
import cv2, json
tables = {name: json.load(open(f"{folder}/{version}/{name}.json")) for name in ("sample", "sample_data")}
files = {row["token"]: [[], None] for row in tables["sample"]}
for row in tables["sample_data"]:
    if row["is_key_frame"] and "/CAM" in row["filename"]:
        files[row["sample_token"]][0].append(f"{folder}/{row['filename']}")
    elif row["is_key_frame"] and "/LIDAR_TOP/" in row["filename"]:
        files[row["sample_token"]][1] = f"{folder}/{row['filename']}"
items = list(files.values())

def read(item):
    images, lidar = item
    total = 0
    for file in images:
        image = cv2.imdecode(np.fromfile(file, np.uint8), cv2.IMREAD_COLOR)
        total += int(image[::50, ::50].sum())
    return len(images), len(np.fromfile(lidar, np.float32).reshape(-1, 5)), 0, total
""",
    "bagassets": """
import bagassets
items = bagassets.open_dataset(folder)
cameras = [name for name in items.channels if name.startswith("CAM")]

def read(sample):
    total = 0
    for camera in cameras:
        image = sample.image(camera)
        total += int(image[::50, ::50].sum())
    return len(cameras), len(sample.points("LIDAR_TOP")), len([box.center_m for box in sample.boxes]), total
""",
    "devkit": """
from PIL import Image
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud
nusc = NuScenes(version, folder, verbose=False)
cameras = [row["channel"] for row in nusc.sensor if row["modality"] == "camera"]
items = nusc.sample

def read(sample):
    total = 0
    for camera in cameras:
        image = np.array(Image.open(nusc.get_sample_data_path(sample["data"][camera])))
        total += int(image[::50, ::50].sum())
    lidar = sample["data"]["LIDAR_TOP"]
    points = LidarPointCloud.from_file(nusc.get_sample_data_path(lidar)).nbr_points()
    return len(cameras), points, len([box.center for box in nusc.get_boxes(lidar)]), total
""",
}
_START = """
import multiprocessing, resource, sys, time
started = time.perf_counter()
import numpy as np
folder, version, workers, epochs = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
sys.path += sys.argv[5:]
"""
_RUN = """
def cpu_s():
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)

length = len(items)
opened, before_s = time.perf_counter(), cpu_s()
if workers and "bagassets" in sys.modules:
    read(items[0])  # so that workers share the tables, as the documentation advises
    opened = time.perf_counter()
if not workers:
    means, close, read_all = "", None, lambda: [read(item) for item in items]
else:
    class Counts:
        def __len__(self):
            return length
        def __getitem__(self, number):
            return read(items[number])
    try:
        import torch
        from torch.utils.data import DataLoader
        means = f"DataLoader of PyTorch {torch.__version__}"
        opened, before_s = time.perf_counter(), cpu_s()
        loader = DataLoader(
            Counts(), batch_size=8, num_workers=workers, collate_fn=list, persistent_workers=True
        )
        close, read_all = lambda: None, lambda: [one for batch in loader for one in batch]
    except ImportError:
        means, counts = "multiprocessing.Pool", Counts()
        pool = multiprocessing.get_context("fork").Pool(workers)
        close, read_all = pool.close, lambda: list(pool.imap(counts.__getitem__, range(length), 8))
for _ in range(epochs):
    found = read_all()
ended = time.perf_counter()
if workers:  # only of those that have ended is it known what they used
    read_all = loader = close()
    while multiprocessing.active_children():
        time.sleep(0.01)
import json
images, points, boxes, total = map(sum, zip(*found))
print(json.dumps({
    "open_s": opened - started, "samples_per_s": epochs * length / (ended - opened), "workers": means,
    "cpu_ms": 1000 * (cpu_s() - before_s) / (epochs * length),
    "read": {"samples": length, "images": images, "points": points, "boxes": boxes, "total": total},
}))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each of the six drives of the demo")
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument(
        "--torch", type=Path, help="site-packages with PyTorch, for workers of its DataLoader"
    )
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    devkit = os.environ.get("BAGASSETS_DEVKIT_PYTHON", str(ROOT / ".devkit-venv" / "bin" / "python"))
    if not Path(devkit).is_file():
        parser.error(f"{devkit} does not exist; `make test` makes the environment of the devkit")
    with tempfile.TemporaryDirectory(dir=options.folder, ignore_cleanup_errors=True) as name:
        made = ["-m", "bagassets", "demo", str(Path(name) / "demo"), "--seconds", str(options.seconds)]
        subprocess.run([sys.executable, *made], check=True, stdout=subprocess.DEVNULL)
        dataset = Path(name) / "demo" / "nuscenes"
        for path in (dataset / "samples").rglob("*.*"):
            path.read_bytes()
        found: dict[str, Any] = {name: {"1": [], "2": []} for name in _READERS}
        for _ in range(options.trials):
            for workers in ("1", "2"):
                for reader, trials in found.items():
                    python = devkit if reader == "devkit" else sys.executable
                    trials[workers].append(_read(python, reader, dataset, workers, options.torch))
                last = {reader: trials[workers][-1] for reader, trials in found.items()}
                rates = [
                    f"{reader} {one['samples_per_s']:.1f} ({one['cpu_ms']:.2f})"
                    for reader, one in last.items()
                ]
                print(f"samples per second (CPU ms a sample), {workers}: {', '.join(rates)}", flush=True)
    every = [trial for trials in found.values() for few in trials.values() for trial in few]
    means = {trial.pop("workers") for trial in every} - {""}
    read = [trial.pop("read") for trial in every]
    boxes = max(one["boxes"] for one in read)
    if any(
        one | {"boxes": boxes} != read[0] | {"boxes": boxes} or one["boxes"] not in {0, boxes} for one in read
    ):
        sys.exit(f"they do not read the same: {read}")
    found |= {"read": read[0] | {"boxes": boxes}, "workers": ", ".join(sorted(means))}
    print(reader_table(found))
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": machine(), **found}, indent=1) + "\n", "utf-8")


def reader_table(found: dict[str, Any]) -> str:
    """Return the table of `reader.json`: medians."""
    names = {
        "bagassets": "`bagassets.open_dataset`",
        "devkit": "nuscenes-devkit",
        "bare": "bare loop over the files, without boxes",
    }
    rows = [
        [
            title,
            median([trial["open_s"] for trial in found[name]["1"]]),
            *(
                median([trial[figure] for trial in found[name][workers]])
                for workers in ("1", "2")
                for figure in ("samples_per_s", "cpu_ms")
            ),
        ]
        for name, title in names.items()
    ]
    read = found["read"]
    contents = (
        f"{read['samples']} samples, {read['images']} images, {read['points']} points, {read['boxes']} boxes"
    )
    columns = ["import and open, s", "1 process, samples per second", "CPU ms", "2 workers", "CPU ms"]
    table = markdown(["", *columns], rows)
    return f"{table}\nMedians of {len(found['bare']['1'])}; {contents}; workers: {found['workers']}.\n"


def _read(python: str, name: str, dataset: Path, workers: str, torch: Path | None) -> dict[str, Any]:
    """Read a dataset in a new process and return what it prints."""
    code = _START + _READERS[name] + _RUN
    several = workers if workers != "1" else "0"
    command = [
        python,
        "-c",
        code,
        str(dataset),
        _VERSION,
        several,
        str(_EPOCHS),
        *([str(torch)] if torch else []),
    ]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


if __name__ == "__main__":
    main()
