"""The step `vision_sequences`: one recording's part of the vision dataset.

Files: `metadata.json`, `transforms.json`, `trajectories/SENSOR-REFERENCE.csv` and `.parquet`,
`CHANNEL/0000.json` for each sequence; `sequences.json` with the rows of all sequences for the merged
files; `files.json`, which image of which artifact becomes which file; `facts.json`. Images are not
copied: the dataset links them from the artifacts of `frames`.
"""

import json
from collections.abc import Mapping
from typing import Any

from bagassets.bags.inventory import Inventory
from bagassets.bags.model import Recording
from bagassets.errors import CalibrationError
from bagassets.geometry.tf_tree import TfTree
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import CameraChannel, Rig
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_vision import Vision
from bagassets.steps.channel import Request
from bagassets.steps.transform_logs import read_transforms
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json
from bagassets.vision.dataset import FACTS, FILES, SEQUENCES
from bagassets.vision.metadata import recording_metadata, transforms_json
from bagassets.vision.relative import relative_poses
from bagassets.vision.sequences import cut_sequences
from bagassets.vision.trajectories import Bodies, csv_bytes, tf_poses, trajectory_table

__all__ = ["STEP", "make", "request"]

STEP = Step("vision_sequences", 2, ("pyarrow",))

_LEAST_DIGITS = 4


def request(
    rig: Rig,
    vision: Vision,
    key: str,
    inventory: Inventory,
    *,
    clock: Clock,
    calibration: Mapping[str, Any],
    ego_poses: Artifact,
    frames: Mapping[str, Artifact],
) -> Request:
    """Return what the step reads of this recording.

    Args:
        rig: the rig that made the recording.
        vision: the recipe's `vision`.
        key: partition key.
        inventory: what is in the recording.
        clock: which time of a message counts.
        calibration: content of `calibration.json`.
        ego_poses: the artifact of poses.
        frames: channel -> artifact of its images.
    """
    cameras = _cameras(rig, vision, frames)
    global_frame = ego_poses.read_json("ego_poses.json")["global_frame"]
    bodies = Bodies.of(calibration, global_frame)
    pairs = [pair.split(":") for pair in vision.trajectories]
    through_tf = not all(bodies.know(*pair) for pair in pairs)
    tf = [topic for topic in rig.tf if through_tf and inventory.has(topic)]
    tf_static = [topic for topic in rig.tf_static if through_tf and inventory.has(topic)]
    params = {
        "key": key,
        "rig": rig.name,
        "cameras": sorted(cameras),
        "frames": vision.frames,
        "stride": vision.stride,
        "max_gap_s": vision.max_gap_s,
        "trajectories": sorted(set(vision.trajectories)),
        "tf": tf,
        "tf_static": tf_static,
        "tf_clock": clock if tf else None,
        "tf_max_gap_s": getattr(rig.ego_pose, "max_gap_s", 0.0),
        "calibration": {
            "ego_frame": calibration["ego_frame"],
            "channels": {
                name: {"frame": channel["frame"], "ego_SE3_sensor": channel["ego_SE3_sensor"]}
                for name, channel in calibration["channels"].items()
            },
        },
        "metadata": recording_metadata(key, rig.name, inventory),
    }
    inputs = {f"channel:{name}": artifact.digest for name, artifact in cameras.items()}
    topics = tuple(sorted({*tf, *tf_static}))
    return Request(params, topics, {**inputs, "ego_poses": ego_poses.digest})


def make(
    params: Mapping[str, Any],
    recording: Recording,
    out: ArtifactWriter,
    *,
    trajectory: Trajectory,
    ego_poses: Artifact,
    frames: Mapping[str, Artifact],
) -> dict[str, Any]:
    """Write the recording's part of the dataset; return the summary.

    Args:
        params: as made by `request`.
        recording: the declared topics of TF, perhaps none.
        out: the artifact.
        trajectory: `global_SE3_ego`, the content of `ego_poses`.
        ego_poses: the artifact of poses, for the origin of the global frame.
        frames: channel -> artifact of its images.
    """
    poses_json = ego_poses.read_json("ego_poses.json")
    cameras = {name: frames[name].read_json("channel.json") for name in params["cameras"]}
    written = [
        out.write_json("metadata.json", params["metadata"]),
        out.write_json("transforms.json", transforms_json(params["calibration"], cameras)),
    ]
    missing = _write_trajectories(params, recording, out, trajectory, poses_json)
    rows: list[dict[str, Any]] = []
    files: list[dict[str, str]] = []
    counts: dict[str, dict[str, int]] = {}
    for name in params["cameras"]:
        counts[name] = _cut_camera(name, frames[name], cameras[name], params, trajectory, rows, files)
    for row in rows:
        out.write_json(f"{row['channel']}/{row['sequence']}.json", row)
    # The folder's name is told by what is in it, so that a reader never sees it change.
    content = [[entry.digest for entry in written], rows, files, params, poses_json]
    folder = f"{params['key']}-{digest_json(content)[:12]}"
    lines = [
        json.dumps(
            {**row, "folder": f"recordings/{folder}/{row['folder']}"}, sort_keys=True, ensure_ascii=False
        )
        for row in rows
    ]
    out.write(SEQUENCES, (("[\n" + ",\n".join(lines) + "\n]\n") if lines else "[]\n").encode())
    out.write_json(FILES, files, indent=None)
    facts = {
        "key": params["key"],
        "rig": params["rig"],
        "folder": folder,
        "duration_s": params["metadata"]["duration_s"],
        "daylight": params["metadata"]["daylight"],
        "start": _start(params["metadata"], poses_json),
        "sequences": len(rows),
        "images": len(files),
        "channels": counts,
        "missing_trajectories": missing,
    }
    out.write_json(FACTS, facts)
    return facts


def _cameras(rig: Rig, vision: Vision, frames: Mapping[str, Artifact]) -> dict[str, Artifact]:
    """Return the cameras that make sequences, of those that the recording has."""
    wanted = [
        name
        for name, channel in rig.channels.items()
        if isinstance(channel, CameraChannel) and (vision.cameras is None or name in vision.cameras)
    ]
    return {name: frames[name] for name in sorted(wanted) if name in frames}


def _cut_camera(
    name: str,
    artifact: Artifact,
    camera: Mapping[str, Any],
    params: Mapping[str, Any],
    trajectory: Trajectory,
    rows: list[dict[str, Any]],
    files: list[dict[str, str]],
) -> dict[str, int]:
    """Add the sequences of one camera and the files they consist of; return where its images went."""
    index = artifact.read_table("index.parquet")
    stamps_ns = index.column("stamp_ns").to_numpy()
    names = index.column("file").to_pylist()
    widths, heights = index.column("width").to_pylist(), index.column("height").to_pylist()
    positions, rotations, has_pose = trajectory.at(stamps_ns)
    cuts = cut_sequences(
        stamps_ns,
        has_pose,
        length=params["frames"],
        stride=params["stride"],
        max_gap_ns=round(params["max_gap_s"] * 1e9),
    )
    digits = max(_LEAST_DIGITS, len(str(len(cuts.sequences))))
    for number, images in enumerate(cuts.sequences):
        sequence = f"{number:0{digits}d}"
        folder = f"{name}/{sequence}"
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
                "recording": params["key"],
                "channel": name,
                "sequence": sequence,
                "folder": folder,
                "start_ns": int(stamps_ns[first]),
                "duration_s": round(float(stamps_ns[images[-1]] - stamps_ns[first]) / 1e9, 6),
                "width": widths[first],
                "height": heights[first],
                "intrinsics": camera["camera_intrinsic"],
                "ego_SE3_sensor": params["calibration"]["channels"][name]["ego_SE3_sensor"],
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
    params: Mapping[str, Any],
    recording: Recording,
    out: ArtifactWriter,
    trajectory: Trajectory,
    poses_json: Mapping[str, Any],
) -> dict[str, str]:
    """Write the configured trajectories; return pair -> why it could not be made."""
    bodies = Bodies.of(params["calibration"], poses_json["global_frame"])
    tree = TfTree(
        read_transforms(recording, params["tf_static"], "tf_static"),
        read_transforms(recording, params["tf"], "tf", clock=params["tf_clock"] or "header"),
    )
    missing = {}
    for pair in params["trajectories"]:
        sensor, _, reference = pair.partition(":")
        try:
            poses = (
                bodies.poses(sensor, reference, trajectory)
                if bodies.know(sensor, reference)
                else tf_poses(sensor, reference, bodies, tree, round(params["tf_max_gap_s"] * 1e9))
            )
        except CalibrationError as err:
            missing[pair] = str(err)
            continue
        table = trajectory_table(poses, poses_json["origin"])
        name = f"{sensor}-{reference}".replace("/", "_")
        out.write(f"trajectories/{name}.csv", csv_bytes(table))
        out.write_table(f"trajectories/{name}.parquet", table)
    return missing


def _start(metadata: Mapping[str, Any], poses_json: Mapping[str, Any]) -> dict[str, float] | None:
    """Return where on Earth the recording begins, if it says so anywhere."""
    if metadata["gnss"] is not None:
        first = metadata["gnss"]["first"]
        return {"lat": first["lat"], "lon": first["lon"]}
    origin = poses_json["origin"]
    if origin is not None and origin.get("kind") == "wgs84":
        return {"lat": origin["lat"], "lon": origin["lon"]}
    return None
