"""The asset `vision_sequences`: one recording's part of the vision dataset.

Files: `metadata.json`, `transforms.json`, `trajectories/SENSOR-REFERENCE.csv` and `.parquet`,
`CHANNEL/0000.json` for each sequence; `sequences.json` with the rows of all sequences, for the merged files;
`files.json`, which maps the dataset's files to images in artifacts; `facts.json`. Images are not copied: the dataset links
them from the artifacts of `frames`.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bagassets.assets.asset import Asset, Facts, Inputs, Summary, Use, as_json, inlined
from bagassets.assets.calibration import CALIBRATION
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.face import Face
from bagassets.assets.frames import FRAMES
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.quality.check import RecordingCheck
from bagassets.assets.quality.evidence import Evidence
from bagassets.assets.quality.finding import Finding
from bagassets.assets.transform_logs import read_transforms
from bagassets.base.columns import numbers
from bagassets.base.errors import CalibrationError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.formats.format import FACTS
from bagassets.formats.json_files import rows_bytes
from bagassets.formats.vision.sequences import cut_sequences
from bagassets.formats.vision.settings import Vision
from bagassets.formats.vision.trajectories import (
    Bodies,
    csv_bytes,
    relative_poses,
    tf_poses,
    trajectory_table,
)
from bagassets.geometry.calibration import Mounts
from bagassets.geometry.sun import sun_elevation_deg
from bagassets.geometry.tf_tree import TfTree
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import CameraChannel, Recipe, Rig
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_poses import FixedPose, TfSource
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json

FILES = "files.json"
# Has the rows of all sequences.
SEQUENCES = "sequences.json"
_LEAST_DIGITS = 4
# What becomes of images that are in no sequence -> how to say it, with the number.
_BUT = {
    "breaks": "breaks between them (vision.max_gap_s, or no ego pose)",
    "strided": "skipped by vision.stride",
    "without_pose": "without an ego pose",
}


@dataclass(frozen=True)
class Cuts:
    """How the images of a camera are cut into sequences; see `vision` in the recipe."""

    frames: int
    stride: int
    max_gap_s: float


@dataclass(frozen=True)
class VisionParams:
    """The recipe's parameters for a recording's part of the vision dataset.

    Attributes:
        rig: name of the rig.
        cameras: cameras of the rig with sequences, sorted.
        cuts: how they are cut.
        trajectories: pairs `sensor:reference`, sorted.
        tf: topics of transforms; empty unless a trajectory has a frame other than `ego` and `global`, which are always
            known.
        tf_static: topics of static transforms; empty likewise.
        tf_clock: clock of the transforms; None if they are not needed.
        tf_max_gap_s: longest gap between transforms to interpolate over; 0 for a rig that stands still.
    """

    rig: str
    cameras: tuple[str, ...]
    cuts: Cuts
    trajectories: tuple[str, ...]
    tf: tuple[str, ...]
    tf_static: tuple[str, ...]
    tf_clock: Clock | None
    tf_max_gap_s: float

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "VisionParams":
        """Return the parameters for a rig."""
        vision = recipe.settings(Vision) or Vision()
        cameras = [name for name, channel in rig.channels.items() if isinstance(channel, CameraChannel)]
        frames = {frame for pair in vision.trajectories for frame in pair.split(":")}
        through_tf = not frames <= {"ego", "global"}
        return cls(
            rig=rig.name,
            cameras=tuple(
                sorted(name for name in cameras if vision.cameras is None or name in vision.cameras)
            ),
            cuts=Cuts(vision.frames, vision.stride, vision.max_gap_s),
            trajectories=tuple(sorted(set(vision.trajectories))),
            tf=rig.tf if through_tf else (),
            tf_static=rig.tf_static if through_tf else (),
            tf_clock=recipe.clock_of(rig) if through_tf else None,
            tf_max_gap_s=0.0
            if isinstance(rig.ego_pose, FixedPose)
            else (rig.ego_pose or TfSource()).max_gap_s,
        )


@dataclass(frozen=True, kw_only=True)
class VisionUse(VisionParams):
    """All that determines a recording's part besides its images and poses.

    Of cameras and topics those that the recording has and that are read, and no clock if no transforms are.

    Attributes:
        key: partition key.
        calibration: extrinsics of the sensors.
        metadata: content of `metadata.json`.
    """

    cuts: Cuts = inlined()
    key: str
    calibration: Mounts
    metadata: JsonMapping


def use(params: VisionParams, facts: Facts) -> dict[str, Use[VisionUse]]:
    """Return the inputs of a recording's part: images, poses, extrinsics, metadata, and transforms if needed."""
    mounts, images = facts.calibration.mounts, facts.channels(FRAMES.name)
    cameras = {name: images[name] for name in params.cameras if name in images}
    poses = facts.artifact(EGO_POSES.name)
    bodies = Bodies.of(mounts, poses.read_json("ego_poses.json")["global_frame"])
    through_tf = not all(bodies.has(*pair.split(":")) for pair in params.trajectories)
    tf, tf_static = (
        tuple(topic for topic in topics if through_tf and facts.inventory.has(topic))
        for topics in (params.tf, params.tf_static)
    )
    clock = params.tf_clock if tf else None
    read = VisionUse(
        **vars(replace(params, cameras=tuple(cameras), tf=tf, tf_static=tf_static, tf_clock=clock)),
        key=facts.key,
        calibration=mounts,
        metadata=recording_metadata(facts.key, params.rig, facts.inventory),
    )
    inputs = {f"channel:{name}": artifact.digest for name, artifact in cameras.items()}
    topics = tuple(sorted({*tf, *tf_static}))
    return {"": Use(read, topics, {**inputs, EGO_POSES.name: poses.digest})}


def make(use: Use[VisionUse], inputs: Inputs, out: ArtifactWriter) -> Summary:
    """Write the recording's part of the dataset; return the summary."""
    params, trajectory, images = use.params, inputs.trajectory, inputs.channels(FRAMES.name)
    poses_json = inputs.artifact(EGO_POSES.name).read_json("ego_poses.json")
    cameras = {name: images[name].read_json("channel.json") for name in params.cameras}
    written = [
        out.write_json("metadata.json", params.metadata),
        out.write_json("transforms.json", transforms_json(params.calibration, cameras)),
    ]
    with inputs.messages(use.topics) as recording:
        missing = _write_trajectories(params, recording, out, trajectory, poses_json)
    rows: list[JsonObject] = []
    files: list[dict[str, str]] = []
    counts: dict[str, dict[str, int]] = {}
    for name in params.cameras:
        counts[name] = _cut_camera(name, images[name], cameras[name], params, trajectory, rows, files)
    for row in rows:
        out.write_json(f"{row['channel']}/{row['sequence']}.json", row)
    # The folder's name depends on its content, so that readers never see it change.
    content = [[entry.digest for entry in written], rows, files, as_json(params), poses_json]
    folder = f"{params.key}-{digest_json(content)[:12]}"
    placed = [{**row, "folder": f"recordings/{folder}/{row['folder']}"} for row in rows]
    lines = [json.dumps(row, sort_keys=True, ensure_ascii=False).encode() for row in placed]
    out.write(SEQUENCES, rows_bytes(lines))
    out.write_json(FILES, files, indent=None)
    facts = {
        "key": params.key,
        "rig": params.rig,
        "folder": folder,
        "duration_s": params.metadata["duration_s"],
        "daylight": params.metadata["daylight"],
        "start": _start(params.metadata, poses_json),
        "sequences": len(rows),
        "images": len(files),
        "channels": counts,
        "missing_trajectories": missing,
    }
    out.write_json(FACTS, facts)
    return facts


def _cut_camera(
    name: str,
    artifact: Artifact,
    camera: JsonMapping,
    params: VisionUse,
    trajectory: Trajectory,
    rows: list[JsonObject],
    files: list[dict[str, str]],
) -> dict[str, int]:
    """Add the sequences of one camera and their files; return the counts of its images.

    Where the rig has no poses at all, neither have its images.
    """
    index = artifact.read_table("index.parquet")
    stamps_ns = numbers(index.column("stamp_ns"))
    names = index.column("file").to_pylist()
    widths, heights = index.column("width").to_pylist(), index.column("height").to_pylist()
    positions, rotations, has_pose = trajectory.at(stamps_ns)
    has_poses = bool(len(trajectory.stamps_ns))
    cuts = cut_sequences(
        stamps_ns,
        has_pose if has_poses else np.ones(len(stamps_ns), dtype=np.bool_),
        length=params.cuts.frames,
        stride=params.cuts.stride,
        max_gap_ns=round(params.cuts.max_gap_s * 1e9),
    )
    digits = max(_LEAST_DIGITS, len(str(len(cuts.sequences))))
    for number, images in enumerate(cuts.sequences):
        sequence = f"{number:0{digits}d}"
        folder = f"{name}/{sequence}"
        poses: Sequence[Sequence[float] | None] = [None] * len(images)
        if has_poses:
            poses = relative_poses(positions[images], rotations[images])
        shown = []
        for place, (image, pose) in enumerate(zip(images.tolist(), poses, strict=True)):
            suffix = names[image].rpartition(".")[2]
            file = f"{place:06d}.{suffix}"
            shown.append({"file": file, "stamp_ns": int(stamps_ns[image]), "pose": pose})
            files.append({"filename": f"{folder}/{file}", "artifact": artifact.digest, "file": names[image]})
        first = int(images[0])
        rows.append(
            {
                "recording": params.key,
                "channel": name,
                "sequence": sequence,
                "folder": folder,
                "start_ns": int(stamps_ns[first]),
                "duration_s": round(float(stamps_ns[images[-1]] - stamps_ns[first]) / 1e9, 6),
                "width": widths[first],
                "height": heights[first],
                "intrinsics": camera["camera_intrinsic"],
                "ego_SE3_sensor": as_json(params.calibration.channels[name].ego_SE3_sensor),
                "frames": shown,
            }
        )
    return {
        "images": len(stamps_ns),
        "sequences": len(cuts.sequences),
        "in_sequences": cuts.sequences.size,
        "strided": cuts.strided,
        "without_pose": cuts.without_pose,
        "remainder": cuts.remainder,
        "breaks": cuts.breaks,
    }


def _write_trajectories(
    params: VisionUse,
    recording: Recording,
    out: ArtifactWriter,
    trajectory: Trajectory,
    poses_json: JsonMapping,
) -> dict[str, str]:
    """Write the configured trajectories; return pair -> reason for those that could not be made."""
    bodies = Bodies.of(params.calibration, poses_json["global_frame"])
    tree = TfTree(
        read_transforms(recording, params.tf_static, "tf_static"),
        read_transforms(recording, params.tf, "tf", clock=params.tf_clock or "header"),
    )
    missing = {}
    for pair in params.trajectories:
        sensor, _, reference = pair.partition(":")
        try:
            poses = (
                bodies.poses(sensor, reference, trajectory)
                if bodies.has(sensor, reference)
                else tf_poses(sensor, reference, bodies, tree, round(params.tf_max_gap_s * 1e9))
            )
        except CalibrationError as err:
            missing[pair] = str(err)
            continue
        table = trajectory_table(poses, poses_json["origin"])
        name = f"{sensor}-{reference}".replace("/", "_")
        out.write(f"trajectories/{name}.csv", csv_bytes(table))
        out.write_table(f"trajectories/{name}.parquet", table)
    return missing


def _start(metadata: JsonMapping, poses_json: JsonMapping) -> dict[str, float] | None:
    """Return where on Earth the recording begins, if known."""
    if metadata["gnss"] is not None:
        first = metadata["gnss"]["first"]
        return {"lat": first["lat"], "lon": first["lon"]}
    origin = poses_json["origin"]
    if origin is not None and origin.get("kind") == "wgs84":
        return {"lat": origin["lat"], "lon": origin["lon"]}
    return None


def why_no_sequence(cameras: Iterable[tuple[str, Mapping[str, int]]], frames: int) -> str:
    """Return why no camera, each with the counts of its images in `facts.json`, has a sequence, as a clause."""
    name, most = max(cameras, key=lambda one: one[1]["remainder"], default=("any", {"remainder": 0}))
    but = "".join(f", {most[what]} {text}" for what, text in _BUT.items() if most.get(what))
    return f"no camera has {frames} images (vision.frames) in a row; the most are {most['remainder']} of {name}{but}"


def _sequences_made(evidence: Evidence) -> Finding:
    facts = evidence.artifact("vision_sequences").read_json(FACTS)
    frames = (evidence.recipe.settings(Vision) or Vision()).frames
    why = why_no_sequence(facts["channels"].items(), frames)
    return Finding([] if facts["sequences"] else [f"it has no sequence: {why}"])


VISION_SEQUENCES = Asset(
    name="vision_sequences",
    version=2,
    libraries=("pyarrow",),
    title="This recording's part of the vision dataset: image sequences with relative trajectories.",
    kinds=frozenset({"image", "json"}),
    face=Face(counts={"sequences": lambda summary: summary.get("sequences")}),
    reads=(INVENTORY, CALIBRATION, EGO_POSES, FRAMES),
    enabled=lambda recipe: recipe.settings(Vision) is not None,
    optional=True,
    params=VisionParams.of,
    use=use,
    make=make,
    checks=(
        RecordingCheck(
            "sequences_made",
            "scenes_made",
            "The recording has at least one sequence for the vision dataset.",
            "the recording has no sequence; the sentence says why (section `scenes_made`)",
            _sequences_made,
            quick=True,
        ),
    ),
)


def recording_metadata(key: str, rig: str, inventory: Inventory) -> JsonObject:
    """Return the content of `metadata.json`, the facts about a recording as a whole.

    It does not change when the recording is re-indexed, re-compressed or converted, so it lacks file size and format.

    Args:
        key: partition key.
        rig: name of the rig.
        inventory: inventory of the recording.
    """
    first, last = inventory.gnss or (None, None)
    # Without daylight the clock of the fix cannot be trusted, and so neither can the sun.
    elevation = None
    if first is not None and inventory.daylight is not None:
        elevation = round(sun_elevation_deg(first.lat, first.lon, first.stamp_ns), 1)
    return {
        "name": key,
        "rig": rig,
        "start_ns": inventory.start_ns,
        "end_ns": inventory.end_ns,
        "duration_s": round(inventory.duration_s, 6),
        "messages": sum(topic.count for topic in inventory.topics.values()),
        "topics": {
            name: {"type": topic.msgtype, "messages": topic.count} for name, topic in inventory.topics.items()
        },
        "gnss": None if first is None or last is None else {"first": as_json(first), "last": as_json(last)},
        "daylight": inventory.daylight,
        "sun_elevation_deg": elevation,
    }


def transforms_json(mounts: Mounts, cameras: Mapping[str, JsonMapping]) -> JsonObject:
    """Return the content of `transforms.json`: extrinsics of all sensors, and intrinsics of the images as written.

    Args:
        mounts: extrinsics of the sensors.
        cameras: channel -> content of `channel.json` of its images.
    """
    return {
        "ego_frame": mounts.ego_frame,
        "sensors": {
            name: {
                **as_json(mount),
                **({"intrinsics": cameras[name]["camera_intrinsic"]} if name in cameras else {}),
            }
            for name, mount in sorted(mounts.channels.items())
        },
    }
