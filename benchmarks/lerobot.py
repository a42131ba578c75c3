"""LeRobot datasets beside lerobot's own loop, on the same images: `make bench-lerobot`.

    python -m benchmarks.lerobot [--seconds 10] [--recordings 2] [--episodes 1000] [--trials 3] [--json FILE]

Ours reads and decodes the images from the store, encodes, computes statistics and joins; the library's `add_frame` and
`save_episode` are given the decoded images in memory. Both encode with the same codec, quality, preset and key frames.
Then our encoder beside a bare loop of PyAV, how long a frame at random takes to read, how many episodes could have packets of a
camera copied, and one more recording in a dataset of many. lerobot is that of `make test-lerobot`, or of the environment that BAGASSETS_LEROBOT_PYTHON names.
"""

import argparse
import io
import json
import os
import subprocess
import tempfile
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.lerobot import video
from bagassets.formats.lerobot.format import LEROBOT
from bagassets.formats.lerobot.grid import grid_ns, pick
from bagassets.formats.lerobot.settings import Encoding
from bagassets.recipe.model_splits import Splits
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from benchmarks.common import ROOT, machine, markdown, median

__all__ = ["lerobot_table"]

# Those of the tests, whose functions have no types.
_arm: Any = import_module("bagassets_tests.arm_recordings")
_recording_build: Any = import_module("bagassets_tests.recording_build")
SIZE = (480, 640)
CAMERA = "observation.images.wrist"
# Exactly 30, that of NTSC, and of two public recordings of cameras of 30 Hz: the shutter of a PR2 (jsk_demos), and H.264 in
# messages (915 in 29.92 s, CabrilloRoboticsClub/cabrillo_rov_2023).
RATES_HZ = (30.0, 29.97, 29.41, 30.55)
SETTINGS = {"av1": ("libsvtav1", 30, "12"), "h264": ("h264", 30, "medium")}
_THEIRS = """
import json, sys, time, warnings
import torch
operators = torch.library.Library("torchvision", "DEF")
if not hasattr(torch.ops.torchvision, "nms"):
    operators.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
warnings.filterwarnings("ignore")
import numpy as np
from PIL import Image
import lerobot
from lerobot.datasets.lerobot_dataset import LeRobotDataset
files, root, codec = json.loads(open(sys.argv[1]).read()), sys.argv[2], sys.argv[3]
images = [[np.array(Image.open(path).convert("RGB")) for path in some] for some in files]
joints = {"dtype": "float32", "shape": (2,), "names": ["elbow", "wrist"]}
camera = {"dtype": "video", "shape": images[0][0].shape, "names": ["height", "width", "channels"]}
features = {"observation.state": joints, "action": joints, "observation.images.wrist": camera}
started = time.perf_counter()
made = LeRobotDataset.create("me/x", 30, features, root=root, vcodec=codec, image_writer_threads=4)
for episode in images:
    for image in episode:
        value = np.zeros(2, np.float32)
        made.add_frame({"observation.state": value, "action": value, "observation.images.wrist": image, "task": "Lift."})
    made.save_episode()
made.finalize()
print(json.dumps({"seconds": time.perf_counter() - started, "lerobot": lerobot.__version__}))
"""


def main() -> None:
    """Measure, print the table, and keep the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="length of a recording")
    parser.add_argument("--recordings", type=int, default=2)
    parser.add_argument(
        "--episodes", type=int, default=1000, help="in the dataset that one recording is added to"
    )
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        found = measure(Path(folder), options)
    print(lerobot_table(found))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


def measure(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Return all figures."""
    found: dict[str, Any] = {
        "machine": machine(),
        "seconds": options.seconds,
        "recordings": options.recordings,
    }
    for number in range(options.recordings):
        _arm.write_arm(
            folder, f"r{number}", seconds=options.seconds, first=1000 * number, size=SIZE, draw=_scene
        )
    for codec, (theirs, crf, preset) in SETTINGS.items():
        recipe = _arm.make_project(
            folder,
            _arm.RECIPE + f"  video: {{codec: {codec}, crf: {crf}, preset: '{preset}', keyframes: 2}}\n",
        )
        builds = [_build(recipe, one) for one in discover(recipe.bags).recordings.values()]
        parts: list[Part] = []
        files: list[list[str]] = []
        for build in builds:  # all but the episodes: what both begin with
            made = {one.asset: one for one in build.build()}
            channels = made["frames"].artifact.read_json("channels.json")
            artifact = build.facts[0].artifact(channels["CAM_WRIST"]["artifact"])
            names = artifact.read_table("index.parquet").column("file").to_pylist()
            files.append([str(artifact.path(name)) for name in names])
        (folder / "files.json").write_text(json.dumps(files))
        ours, other = [], []
        for trial in range(options.trials):
            store = Store(recipe.store_path)
            for path in store.root.glob("actions/*/*.json"):
                if '"lerobot_episodes"' in path.read_text():
                    path.unlink()
            started = time.perf_counter()
            parts = []
            for build in builds:
                made = {one.asset: one for one in _build(recipe, build.facts[1]).build()}
                key = build.facts[1].key
                parts.append(Part(key, key, made["lerobot_episodes"].artifact.digest))
            _assemble(recipe, parts, folder / f"ours_{codec}_{trial}")
            ours.append(time.perf_counter() - started)
            told = _theirs(folder / "files.json", folder / f"theirs_{codec}_{trial}", theirs)
            other.append(told["seconds"])
            found["lerobot"] = told["lerobot"]
        found[codec] = {
            "ours_s": ours,
            "theirs_s": other,
            "ours_bytes": _bytes(folder / f"ours_{codec}_0"),
            "theirs_bytes": _bytes(folder / f"theirs_{codec}_0"),
            "ours_off_ms": _most_off_ms(folder / f"ours_{codec}_0" / "v3.0"),
            "theirs_off_ms": _most_off_ms(folder / f"theirs_{codec}_0"),
            **_encoders(files[0], codec, crf, preset, options.trials),
        }
    found["random_frame_ms"] = _random_frames(folder / "seek.mp4", files[0])
    found["copyable"] = copyable()
    found["one_more"] = _one_more(recipe, parts, folder / "many", options.episodes)
    return found


def _scene(number: int, size: tuple[int, int]) -> Any:
    """Return an image of a textured table that moves a little, with noise as cameras have it."""
    height, width = size
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    shift = 2.0 * number
    wave = 60 * np.sin((columns + shift) / 17) * np.cos((rows - shift / 2) / 23) + 40 * np.sin(
        rows * columns / 9000
    )
    noise = np.random.default_rng(number).normal(0, 2, (height, width, 3))
    image = 120 + np.stack([wave, np.roll(wave, 40, 0), -wave], axis=2) + noise
    return image.clip(0, 255).astype(np.uint8)


def _build(recipe: Any, recording: Any) -> Any:
    digest = recording_digest(recording).digest
    return _recording_build.RecordingBuild(
        recipe, Store(recipe.store_path), recording, digest, recording_stat(recording)
    )


def _assemble(recipe: Any, parts: list[Part], output: Path, **options: Any) -> None:
    splits = Splits(shares={"train": 1.0})
    assemble(LEROBOT, parts, recipe.lerobot, Store(recipe.store_path), output, splits=splits, **options)


def _theirs(files: Path, root: Path, codec: str) -> dict[str, Any]:
    python = os.environ.get("BAGASSETS_LEROBOT_PYTHON", str(ROOT / ".lerobot-venv/bin/python"))
    done = subprocess.run(
        [python, "-c", _THEIRS, files, root, codec],
        capture_output=True, text=True, check=True, env={**os.environ, "HF_HUB_OFFLINE": "1"},
    )  # fmt: skip
    told: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return told


def _bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*.mp4"))


def _times_s(path: Path) -> Any:
    """Return when the frames of a video are shown, sorted, exactly."""
    import av

    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        pts = sorted(packet.pts for packet in container.demux(stream) if packet.pts is not None)
        return np.array([float(one * (stream.time_base or 0)) for one in pts])


def _most_off_ms(root: Path) -> float:
    """Return how far the time at which a reader looks for a frame is from that of the frame, at most."""
    info = json.loads((root / "meta" / "info.json").read_text())
    (table,) = map(pq.read_table, (root / "meta" / "episodes").rglob("*.parquet"))
    own, most, frames = f"videos/{CAMERA}", 0.0, {}
    for row in table.to_pylist():
        place = row[f"{own}/chunk_index"], row[f"{own}/file_index"]
        name = info["video_path"].format(video_key=CAMERA, chunk_index=place[0], file_index=place[1])
        if place not in frames:
            frames[place] = _times_s(root / name)
        first = round(row[f"{own}/from_timestamp"] * info["fps"])
        asked = row[f"{own}/from_timestamp"] + np.arange(row["length"]) / info["fps"]
        most = max(most, float(np.abs(asked - frames[place][first : first + row["length"]]).max()))
    return 1000 * most


def _random_frames(path: Path, files: list[str], number: int = 60) -> dict[str, float]:
    """Return key frames every so many frames -> milliseconds for a frame at random, as readers of datasets take them."""
    import av
    import cv2

    images: list[Any] = [cv2.imread(name) for name in files]
    found = {}
    for distance in (2, 30, 120):
        path.write_bytes(video.encode(images, 30, video.with_defaults(Encoding(keyframes=distance))))
        wanted = np.random.default_rng(0).integers(0, len(images), number).tolist()
        started = time.perf_counter()
        for frame in wanted:
            with av.open(str(path)) as container:
                stream = container.streams.video[0]
                pts = round(frame / 30 / (stream.time_base or 1))
                container.seek(pts, stream=stream)
                next(one for one in container.decode(stream) if one.pts == pts).to_ndarray(format="rgb24")
        found[str(distance)] = (time.perf_counter() - started) * 1000 / number
    return found


def _encoders(files: list[str], codec: str, crf: int, preset: str, trials: int) -> dict[str, list[float]]:
    """Return the seconds of our encoder and of a bare loop, by turns, on decoded images."""
    import av
    import cv2

    images: list[Any] = [cv2.imread(path) for path in files]
    encoder = {"av1": "libsvtav1", "h264": "libx264"}[codec]
    settings = video.with_defaults(Encoding(codec=codec, crf=crf, preset=preset))
    ours, bare = [], []
    for _ in range(trials):
        started = time.perf_counter()
        video.encode(images, 30, settings)
        ours.append(time.perf_counter() - started)
        started = time.perf_counter()
        options = {"crf": str(crf), "preset": preset, "g": "2", "threads": "1"}
        options |= {"svtav1-params": "lp=1:pred-struct=1"} if codec == "av1" else {"bf": "0"}
        with av.open(io.BytesIO(), "w", format="mp4") as container:
            stream: Any = container.add_stream(encoder, 30, options=options)
            stream.height, stream.width, stream.pix_fmt = *SIZE, "yuv420p"
            for image in images:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
            container.mux(stream.encode())
        bare.append(time.perf_counter() - started)
    return {"encoder_s": ours, "bare_s": bare}


def copyable() -> dict[str, dict[str, float]]:
    """Return rate of a camera in Hz -> packets from key frame to key frame -> share of episodes that could have its packets as they are.

    Of 1,000 episodes of 10 s at 30 fps that begin at any time in 10 minutes of it, those whose frames show consecutive pictures
    from a key frame on. Stamps jitter by 0.5 ms.
    """
    found: dict[str, dict[str, float]] = {}
    random = np.random.default_rng(0)
    for rate_hz in RATES_HZ:
        number = int(600 * rate_hz)
        stamps_ns = ((np.arange(number) / rate_hz + random.normal(0, 0.0005, number)) * 1e9).astype(np.int64)
        firsts = []
        for start_ns in random.integers(0, 590 * 10**9, 1000).tolist():
            times_ns = grid_ns(start_ns, start_ns + 10 * 10**9, 30)
            shown = pick(stamps_ns, times_ns, "nearest", 50_000_000).before
            firsts.append(int(shown[0]) if (np.diff(shown) == 1).all() else -1)
        shares = {str(gop): sum(one >= 0 and one % gop == 0 for one in firsts) / 1000 for gop in (1, 30)}
        found[f"{rate_hz:g}"] = shares
    return found


def _files(folder: Path) -> set[tuple[int, int]]:
    """Return what tells the videos in a folder apart from others, even if an inode is used again."""
    return {(one.st_ino, one.st_mtime_ns) for one in (path.stat() for path in folder.rglob("*.mp4"))}


def _one_more(recipe: Any, made: list[Part], output: Path, episodes: int) -> dict[str, Any]:
    """Return the seconds of joining a dataset of many episodes, and of one more at the end and in the middle."""
    parts = [
        Part(f"r{number:05d}", f"r{number:05d}", made[0].artifact) for number in range(0, 2 * episodes, 2)
    ]
    found: dict[str, Any] = {"episodes": episodes}
    started = time.perf_counter()
    _assemble(recipe, parts, output)
    found["first_s"] = time.perf_counter() - started
    more = {"end": "r99999", "middle": f"r{episodes + 1:05d}"}
    for where, key in more.items():
        before = _files(output)
        parts = [*parts, Part(key, key, made[1].artifact)]
        started = time.perf_counter()
        _assemble(recipe, parts, output, suspects=frozenset())
        found[f"{where}_s"] = time.perf_counter() - started
        found[f"{where}_files"] = len(_files(output) - before)
    found["files"] = len(list(output.rglob("*.mp4")))
    return found


def lerobot_table(found: dict[str, Any]) -> str:
    """Return the figures as Markdown."""
    rows = []
    for codec in SETTINGS:
        one = found[codec]
        ours, theirs = median(one["ours_s"]), median(one["theirs_s"])
        encoder, bare = median(one["encoder_s"]), median(one["bare_s"])
        rows.append(
            [codec, f"{ours:.1f} s", f"{theirs:.1f} s", f"{theirs / ours:.1f}", f"{one['ours_bytes'] / 1e6:.1f} MB",
             f"{one['theirs_bytes'] / 1e6:.1f} MB", f"{one['ours_off_ms']:.3f} ms", f"{one['theirs_off_ms']:.3f} ms",
             f"{encoder / bare:.2f}"]
        )  # fmt: skip
    header = [
        "codec",
        "ours",
        f"lerobot {found['lerobot']}",
        "ratio",
        "our videos",
        "its videos",
        "our times off",
        "its times off",
        "encoder / bare PyAV",
    ]
    more, seeks = found["one_more"], found["random_frame_ms"]
    return (
        markdown(header, rows)
        + (
            f"\nJoining {more['episodes']:,} episodes of {found['seconds']:g} s takes {more['first_s']:.1f} s. One recording more costs, beyond its "
            f"own encoding, {more['end_s']:.1f} s at the end and {more['middle_s']:.1f} s in the middle, and writes {more['end_files']} and "
            f"{more['middle_files']} of {more['files']} videos.\n\n"
            f"A frame at random is read in {seeks['2']:.1f} ms where every second frame is a key frame, in {seeks['30']:.1f} ms where one is a "
            f"second apart, and in {seeks['120']:.1f} ms where four seconds are between them.\n\n"
            "Of episodes of 10 s at 30 frames a second, so many show consecutive packets of a camera from a key frame on. The last two "
            "rates are those of cameras of nominally 30 Hz in public recordings.\n\n"
        )
        + markdown(
            ["a camera of", "if all are key frames", "if one a second is"],
            [
                [f"{rate} Hz", *(f"{share:.0%}" for share in one.values())]
                for rate, one in found["copyable"].items()
            ],
        )
    )


if __name__ == "__main__":
    main()
