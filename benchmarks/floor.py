"""The floor of a cold build: what its stages take for one recording, each by itself.

Each is done on all of the recording, on one thread, and its processor time taken: reading, hashing, Bayer
conversion, undistortion (as it is done, and by OpenCV), JPEG, packets to points, writing; and the import of Dagster, without
which nothing is recorded. What a plain conversion takes beyond their sum, but for hashing and Dagster, which it does
without, is what it costs to put them together.
"""

import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from bagassets.assets.lidar_file import lidar_bytes
from bagassets.decode.image import decode_image
from bagassets.decode.packets import Packets, packets_in
from bagassets.decode.velodyne import RevolutionDecoder
from bagassets.engine.process import keep_freed_memory
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.kernels.returns import PACKET
from bagassets.geometry.undistortion import Undistortion
from bagassets.recipe import load_recipe
from bagassets.recordings.discover import discover
from bagassets.recordings.model import RecordingFiles
from bagassets.recordings.open import open_recording
from bagassets.recordings.recording import Recording
from bagassets.store.canonical import digest_bytes, digest_file
from benchmarks.common import ROOT, Options, Project, markdown, plain_command, project, save
from benchmarks.drives import LIDAR_TOPIC
from benchmarks.resources import run_watched

__all__ = ["floor", "floor_table", "stages_of"]

_BAG_GB = 1.9
# Stages that begin with these are no part of a plain conversion.
_HASH, _IMPORT = "hash", "import"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 90]


class _Stages:
    """Processor seconds by stage, and of other ways to do the same."""

    def __init__(self) -> None:
        self.cpu_s: dict[str, float] = {}
        self.others_cpu_s: dict[str, float] = {}

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Add the processor time of a block to a stage."""
        return _added(self.cpu_s, name)

    def beside(self, name: str) -> AbstractContextManager[None]:
        """Add the processor time of a block that is no part of the floor."""
        return _added(self.others_cpu_s, name)


@contextmanager
def _added(seconds: dict[str, float], name: str) -> Iterator[None]:
    began = time.process_time()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.process_time() - began


def floor(options: Options) -> None:
    """Measure, and write `floor.json` and `floor.md`."""
    made = project(options.folder / "cold-one", [_BAG_GB * options.size_gb * 1e9], options.trials)
    cpu_s, others_cpu_s = stages_of(made, options.folder / "floor")
    target = made.recipe.parent / "out"
    target.mkdir(exist_ok=True)
    plain = run_watched(plain_command(made.bags, target), cwd=ROOT, env={"BENCH_RECIPE": str(made.recipe)})
    figures = {
        "size_gb": made.size_gb,
        "cpu_s": cpu_s,
        "others_cpu_s": others_cpu_s,
        "plain_cpu_s": plain.cpu_s,
    }
    save(options, "floor", figures, floor_table(figures))


def stages_of(made: Project, out: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Return the processor seconds of each stage for all recordings of a project, and of other ways to do the same.

    Args:
        made: the project.
        out: a folder that files are written to, and that is removed.
    """
    cv2.setNumThreads(1)
    keep_freed_memory()
    made.settle()
    stages = _Stages()
    out.mkdir(exist_ok=True)
    for files in discover(load_recipe(made.recipe).bags).recordings.values():
        _recording(files, stages, out)
    started = run_watched([sys.executable, "-c", "import dagster"], cwd=ROOT)
    if started.code:
        sys.exit("Dagster cannot be imported")
    stages.cpu_s[f"{_IMPORT} Dagster"] = started.cpu_s
    shutil.rmtree(out)
    return stages.cpu_s, stages.others_cpu_s


def _recording(files: RecordingFiles, stages: _Stages, out: Path) -> None:
    with stages.stage(f"{_HASH} the file"):
        for file in files.files:
            digest_file(file)
    with open_recording(files) as recording:
        for name in ("read (inventory)", "read (frames and sweeps)"):
            with stages.stage(name):
                for _ in recording.messages(list(recording.topics)):
                    pass
        with stages.stage(f"{_HASH} the topics"):
            for file in files.files:
                digest_file(file)
        for topic, found in recording.topics.items():
            if topic.endswith("/image_raw"):
                _images(recording, topic, stages, out)
            elif found.msgtype == _COMPRESSED:
                for number, raw in enumerate(recording.messages([topic])):
                    _write(out / f"{number % 8}.jpg", memoryview(recording.decode(raw).data), stages)
        if LIDAR_TOPIC in recording.topics:
            _packets(recording, stages, out)


def floor_table(found: dict[str, Any]) -> str:
    """Return the table of `floor.json`."""
    ours = sum(seconds for name, seconds in found["cpu_s"].items() if name.startswith((_HASH, _IMPORT)))
    total, plain_cpu_s = sum(found["cpu_s"].values()), found["plain_cpu_s"]
    rows: list[list[object]] = [[name, seconds] for name, seconds in found["cpu_s"].items()]
    rows += [["floor of a cold build, all of these", total]]
    rows += [["… in seconds, if two processors are never idle", total / 2]]
    rows += [["floor of a plain conversion, without hashing and Dagster", total - ours]]
    rows += [["plain conversion", plain_cpu_s]]
    rows += [["left of it: Python, calibration, deskewing, tables, imports", plain_cpu_s - (total - ours)]]
    rows += [[f"({name})", seconds] for name, seconds in found["others_cpu_s"].items()]
    return f"One recording of {found['size_gb']:.2f} GB.\n\n" + markdown(["stage", "CPU-s"], rows)


def _images(recording: Recording, topic: str, stages: _Stages, out: Path) -> None:
    """Convert, undistort, encode and write the images of a camera, as many as there are."""
    straight = None
    for number, raw in enumerate(recording.messages([topic])):
        reading = decode_image(recording.decode(raw))
        pixels = np.asarray(reading.pixels)
        if straight is None:
            height, width = pixels.shape
            lens = (-0.16, 0.03, 0.0008, -0.0006, 0.0)
            focal = 0.62 * width
            camera = CameraModel("plumb_bob", width, height, focal, focal, width / 2, height / 2, lens)
            straight, maps = (
                Undistortion(camera, camera.undistorted()),
                camera.undistortion_maps(camera.undistorted()),
            )
            straight(np.zeros((height, width, 4), np.uint8))  # compiles
        with stages.stage("Bayer to colour"):
            image = cv2.cvtColor(pixels, cv2.COLOR_BayerBG2BGRA)
        with stages.beside("undistort, by OpenCV"):
            cv2.remap(image, *maps, cv2.INTER_LINEAR)
        with stages.stage("undistort"):
            image = straight(image)
        with stages.stage("JPEG"):
            encoded = cv2.imencode(".jpg", image, _QUALITY)[1]
        _write(out / f"{number % 8}.jpg", encoded.data, stages)


def _packets(recording: Recording, stages: _Stages, out: Path) -> None:
    """Decode and write the packets of the lidar, a tenth of a second at a time."""
    decoder = RevolutionDecoder(None)
    stamps_ns: list[int] = []
    payloads: list[bytes] = []
    written = 0
    for raw in recording.messages([LIDAR_TOPIC]):
        message = recording.decode(raw)
        stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        payloads += [data for _, data in packets_in(message)]
        stamps_ns += [stamp_ns] * (len(payloads) - len(stamps_ns))
        if stamps_ns[-1] - stamps_ns[0] < 100_000_000:
            continue
        with stages.stage("packets to points"):
            times_ns = np.array(stamps_ns, np.int64)
            packets = Packets(times_ns, np.frombuffer(b"".join(payloads), dtype=PACKET))
            points = decoder.decode(packets, times_ns).points
        _write(out / f"{written % 8}.bin", lidar_bytes(points), stages)
        stamps_ns, payloads, written = [], [], written + 1
    if not written:
        sys.exit(f"{LIDAR_TOPIC} holds no revolution")


def _write(path: Path, data: memoryview, stages: _Stages) -> None:
    with stages.stage(f"{_HASH} what is written"):
        digest_bytes(data)
    with stages.stage("write"):
        path.write_bytes(data)
