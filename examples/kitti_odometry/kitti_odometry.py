"""Datasets in the layout of the KITTI odometry benchmark, for code that reads it with pykitti.

Layout, below the dataset's output::

    dataset/sequences/00/image_2/000000.png …   what the camera saw
    dataset/sequences/00/velodyne/000000.bin …  x, y, z in metres, intensity as recorded: float32
    dataset/sequences/00/calib.txt              P0 … P3: projection of the image; Tr: camera <- lidar
    dataset/sequences/00/times.txt              seconds since the first image
    dataset/poses/00.txt                        first camera <- camera, 3 x 4, a line for each image
    dataset/sequences.json                      number of a sequence -> recording, split, frames

A recording is a sequence; sequences are numbered in the order of the recordings' keys. A frame is an image that has a
sweep near it in time, and an ego pose. The rig has one colour camera here, so that P0 to P3 are all its own.
"""

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from bagassets.assets.asset import Asset, Facts, Inputs, Summary, Use
from bagassets.assets.calibration import CALIBRATION
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.frames import FRAMES
from bagassets.assets.lidar_file import read_lidar_file
from bagassets.assets.quality.finding import Finding
from bagassets.assets.sweeps import SWEEPS
from bagassets.base.errors import DatasetError
from bagassets.engine.splits import SplitShare
from bagassets.formats.format import FACTS, DatasetCheck, Entry, Format, Joined, Link, Member, Samples
from bagassets.formats.json_files import json_bytes, write_hashed
from bagassets.geometry.se3 import SE3, Floats
from bagassets.recipe.model import CameraChannel, LidarChannel, Recipe, Rig
from bagassets.recipe.model_base import ChannelName, DatasetSettings
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json

FOLDER = "dataset"
FILES, POSES, INDEX = "files.json", "poses.txt", "sequences.json"


class Kitti(DatasetSettings):
    """The section `formats.kitti` of a recipe."""

    camera: ChannelName | None = Field(
        None, description="Camera of the images; default: the first of the rig. KITTI has PNG: `output: png`."
    )
    lidar: ChannelName | None = Field(
        None, description="Lidar of the clouds; default: LIDAR_TOP, else the first."
    )
    tolerance_s: float = Field(
        0.05, gt=0, description="An image without a sweep within this time is left out."
    )


# --- the part of a recording -------------------------------------------------------------


@dataclass(frozen=True)
class SequenceParams:
    """The recipe's parameters for a sequence."""

    camera: str
    lidar: str
    tolerance_s: float

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "SequenceParams":
        """Return the parameters for a rig; a sensor that it lacks is ""."""
        settings = recipe.settings(Kitti)
        if settings is None:
            raise DatasetError("the recipe has no section `formats.kitti`; add one.")
        cameras = [name for name, one in rig.channels.items() if isinstance(one, CameraChannel)]
        lidars = sorted(
            (name for name, one in rig.channels.items() if isinstance(one, LidarChannel)),
            key=lambda name: name != "LIDAR_TOP",
        )
        return cls(
            settings.camera or next(iter(cameras), ""),
            settings.lidar or next(iter(lidars), ""),
            settings.tolerance_s,
        )


@dataclass(frozen=True)
class SequenceUse:
    """All that determines the sequence of one recording besides its inputs."""

    key: str
    camera: str
    lidar: str
    tolerance_s: float
    ego_SE3_camera: SE3
    ego_SE3_lidar: SE3


def use(params: SequenceParams, facts: Facts) -> dict[str, Use[SequenceUse] | Exception]:
    """Return the inputs of a recording's sequence."""
    channels = {**facts.channels("frames"), **facts.channels("sweeps")}
    missing = [name or "no such sensor" for name in (params.camera, params.lidar) if name not in channels]
    if missing:
        return {
            "": DatasetError(
                f"{facts.key}: a KITTI sequence needs a camera and a lidar, but of {', '.join(missing)} there is nothing; "
                "set formats.kitti.camera and .lidar."
            )
        }
    poses = {name: facts.calibration.channels[name].ego_SE3_sensor for name in (params.camera, params.lidar)}
    return {
        "": Use(
            SequenceUse(
                facts.key,
                params.camera,
                params.lidar,
                params.tolerance_s,
                poses[params.camera],
                poses[params.lidar],
            ),
            inputs={
                "camera": channels[params.camera].digest,
                "lidar": channels[params.lidar].digest,
                "ego_poses": facts.artifact("ego_poses").digest,
            },
        )
    }


def make(use: Use[SequenceUse], inputs: Inputs, out: ArtifactWriter) -> Summary:
    """Write a sequence except its images, which are linked from the artifacts of `frames`."""
    params = use.params
    images = inputs.channels("frames")[params.camera]
    clouds = inputs.channels("sweeps")[params.lidar]
    matrix = images.read_json("channel.json")["camera_intrinsic"]
    if not matrix:
        raise DatasetError(f"{params.key}: {params.camera} has no intrinsics, which a KITTI sequence needs.")
    ego_SE3_camera, ego_SE3_lidar = params.ego_SE3_camera.normalised(), params.ego_SE3_lidar.normalised()
    shots, sweeps = images.read_table("index.parquet"), clouds.read_table("index.parquet")
    stamps_ns = shots.column("stamp_ns").to_numpy()
    nearest, gap_ns = _nearest(stamps_ns, sweeps.column("stamp_ns").to_numpy())
    positions, rotations, has_pose = inputs.trajectory.at(stamps_ns)
    is_near = gap_ns <= round(params.tolerance_s * 1e9)
    chosen = np.flatnonzero(is_near & has_pose).tolist()
    files, lines, times = [], [], []
    first: SE3 | None = None
    for number, image in enumerate(chosen):
        global_SE3_camera = SE3.create(rotations[image], positions[image]) @ ego_SE3_camera
        first = first or global_SE3_camera
        lines.append(_line((first.inverse() @ global_SE3_camera).matrix[:3]))
        times.append(_number((int(stamps_ns[image]) - int(stamps_ns[chosen[0]])) / 1e9))
        name = shots.column("file")[image].as_py()
        suffix = name.rpartition(".")[2]
        files.append({"name": f"{number:06d}.{suffix}", "artifact": images.digest, "file": name})
        sweep = sweeps.column("file")[int(nearest[image])].as_py()
        points = np.ascontiguousarray(read_lidar_file(clouds.path(sweep))[:, :4], dtype="<f4")
        out.write(f"velodyne/{number:06d}.bin", points.tobytes())
    projection = _line(np.hstack([np.array(matrix, dtype=np.float64), np.zeros((3, 1))]))
    camera_SE3_lidar = ego_SE3_camera.inverse() @ ego_SE3_lidar
    calibration = [f"P{number}: {projection}" for number in range(4)]
    calibration.append(f"Tr: {_line(camera_SE3_lidar.matrix[:3])}")
    for name, rows in (("calib.txt", calibration), ("times.txt", times), (POSES, lines)):
        out.write(name, "".join(f"{row}\n" for row in rows).encode())
    out.write_json(FILES, files, indent=None)
    facts = {
        "frames": len(chosen),
        "without_sweep": int(np.count_nonzero(~is_near)),
        "without_pose": int(np.count_nonzero(is_near & ~has_pose)),
        "duration_s": round(float(times[-1]), 3) if times else 0.0,
    }
    out.write_json(FACTS, facts)
    return facts


def _nearest(stamps_ns: Any, others_ns: Any) -> tuple[Any, Any]:
    """Return the index of the nearest other stamp for each stamp, and the time to it; without others, none is near."""
    if not len(others_ns):
        return np.zeros(len(stamps_ns), np.int64), np.full(len(stamps_ns), np.iinfo(np.int64).max)
    after = np.clip(np.searchsorted(others_ns, stamps_ns), 1, max(1, len(others_ns) - 1))
    before = after - 1
    after = np.minimum(after, len(others_ns) - 1)
    is_after = np.abs(others_ns[after] - stamps_ns) < np.abs(others_ns[before] - stamps_ns)
    nearest = np.where(is_after, after, before)
    return nearest, np.abs(others_ns[nearest] - stamps_ns)


def _line(rows: Floats) -> str:
    return " ".join(_number(value) for value in rows.reshape(-1).tolist())


def _number(value: float) -> str:
    return f"{round(value, 9) + 0.0:.9e}"


SEQUENCE = Asset(
    name="kitti_sequence",
    version=1,
    title="This recording's sequence of the KITTI dataset: clouds, poses, times, calibration.",
    kinds=frozenset({"pointcloud", "text"}),
    reads=(CALIBRATION, EGO_POSES, FRAMES, SWEEPS),
    params=SequenceParams.of,
    use=use,
    make=make,
    enabled=lambda recipe: recipe.settings(Kitti) is not None,
    optional=True,
)


# --- the dataset -------------------------------------------------------------------------


def links(entry: Entry) -> Iterator[Link]:
    """Yield the files of a sequence."""
    number = f"{entry.number:02d}"
    for file in entry.artifact.entries():
        if file.path == POSES:
            yield Link(f"poses/{number}.txt", entry.artifact.digest, file.path)
        elif file.path not in {FACTS, FILES}:
            yield Link(f"sequences/{number}/{file.path}", entry.artifact.digest, file.path)
    for image in entry.artifact.read_json(FILES):
        yield Link(f"sequences/{number}/image_2/{image['name']}", image["artifact"], image["file"])


def join(members: Sequence[Member], settings: Kitti, shares: Sequence[SplitShare], out: Path) -> Joined:
    """Write the recording of each sequence."""
    del settings, shares
    index = {
        f"{member.number:02d}": {
            "recording": member.part.key,
            "split": member.split,
            "frames": member.facts["frames"],
        }
        for member in members
    }
    facts = {"sequences": len(members), "frames": sum(member.facts["frames"] for member in members)}
    return Joined({INDEX: write_hashed(out / INDEX, json_bytes(index))}, facts)


def samples(part: Artifact) -> Samples:
    """Return the frames of a recording, for `dataset diff`."""
    images = part.read_json(FILES)
    clouds = {file.path: file.digest for file in part.entries()}
    poses = part.path(POSES).read_text("ascii").splitlines()
    return {
        "sequence": {
            f"{number:06d}": {
                "image": digest_json([image["artifact"], image["file"]]),
                "cloud": clouds[f"velodyne/{number:06d}.bin"],
                "pose": digest_json(poses[number]),
            }
            for number, image in enumerate(images)
        }
    }


def check(settings: Kitti, names: AbstractSet[str]) -> dict[str, Finding]:
    """Count files and rows on disk: each frame has an image, a cloud, a time and a pose."""
    root, problems, frames = settings.output / FOLDER, [], 0
    for folder in sorted((root / "sequences").glob("*")):
        counts = {name: len(list((folder / name).glob("*"))) for name in ("image_2", "velodyne")}
        for path in (folder / "times.txt", root / "poses" / f"{folder.name}.txt"):
            counts[path.name] = len(path.read_text("ascii").splitlines()) if path.is_file() else 0
        frames += counts["image_2"]
        if len(set(counts.values())) > 1:
            counts = ", ".join(f"{name} {number}" for name, number in counts.items())
            problems.append(f"sequence {folder.name} has not one of each for every frame: {counts}.")
    return {name: Finding(problems, {"frames": frames}) for name in names}


KITTI = Format(
    name="kitti",
    version=1,
    description="All recordings in the layout of the KITTI odometry benchmark, which pykitti loads.",
    kinds=frozenset({"kitti", "dataset"}),
    settings=Kitti,
    part=SEQUENCE.name,
    assets=(SEQUENCE,),
    join=join,
    links=links,
    counts=lambda facts: {"frames": facts["frames"]},
    duration_s=lambda facts: float(facts["duration_s"]),
    folder=lambda _: FOLDER,
    fills_split=lambda facts: bool(facts["frames"]),
    samples=samples,
    checks=(
        DatasetCheck(
            "kitti_frames_whole", "files_match", "Every frame has an image, a cloud, a time and a pose."
        ),
    ),
    check=check,
)
