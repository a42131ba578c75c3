"""The step `preview`: pictures of a recording for people.

Files: `lidar_over_camera.jpg`, `birds_eye.jpg`, `future_trajectory.jpg`, `contact_sheet.jpg`,
`timeline.jpg` in full size; the same below `inline/`, small enough for the web UI; `thumbnail.jpg` for the
report. `facts.json` says which there are, and why others are not: a picture that cannot be drawn costs
nothing but itself.
"""

from collections.abc import Mapping
from typing import Any

from bagassets.annotations.table import BoxTable
from bagassets.bags.inventory import Inventory
from bagassets.geometry.trajectory import Trajectory
from bagassets.preview.canvas import Image, jpeg, jpeg_within
from bagassets.preview.channels import CameraImages, Clouds
from bagassets.preview.pictures import TITLES, CannotDrawError, Pictures
from bagassets.preview.timeline import timeline, timeline_facts
from bagassets.recipe.model import CameraChannel, LidarChannel, Rig
from bagassets.recipe.model_preview import Preview
from bagassets.steps.channel import Request
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json

__all__ = ["FACTS", "INLINE_BYTES", "STEP", "THUMBNAIL", "make", "request"]

STEP = Step("preview", 5, ("opencv-python-headless",))

FACTS = "facts.json"
THUMBNAIL = "thumbnail.jpg"
# What is shown in the web UI lies in Dagster's event log, once per materialization: five of these are 100 KB.
INLINE_BYTES = 16 * 1024
INLINE_WIDTH_PX = 560
THUMBNAIL_BYTES = 2600
THUMBNAIL_WIDTH_PX = 200
# The first of these that there is stands for the recording.
_THUMBNAILS = ("lidar_over_camera", "contact_sheet", "birds_eye", "timeline")


def request(
    rig: Rig,
    preview: Preview,
    inventory: Inventory,
    *,
    calibration: Mapping[str, Any],
    ego_poses: Artifact,
    annotations: Artifact,
    frames: Mapping[str, Artifact],
    sweeps: Mapping[str, Artifact],
) -> Request:
    """Return what the step reads of this recording.

    Args:
        rig: the rig that made the recording.
        preview: the recipe's `preview`.
        inventory: what is in the recording.
        calibration: content of `calibration.json`.
        ego_poses: the artifact of poses.
        annotations: the artifact of boxes.
        frames: channel -> artifact of its images.
        sweeps: channel -> artifact of its point files.
    """
    cameras = _first(preview.camera or "CAM_FRONT", [n for n in rig.channels if n in frames])
    lidars = [n for n, channel in rig.channels.items() if n in sweeps and isinstance(channel, LidarChannel)]
    lidar = next(iter(_first(preview.lidar or "LIDAR_TOP", lidars)), None)
    shown = [*cameras, *([lidar] if lidar else [])]
    params = {
        "cameras": {name: _lens(rig, calibration, name) for name in cameras},
        "order": cameras,
        "lidar": lidar,
        "extrinsics": {name: calibration["channels"][name]["ego_SE3_sensor"] for name in shown},
        **preview.model_dump(mode="json", include={"columns", "width", "future_s", "range_m"}),
    }
    artifacts = {name: frames[name] if name in frames else sweeps[name] for name in shown}
    inputs = {f"channel:{name}": artifact.digest for name, artifact in artifacts.items()}
    inputs |= {"ego_poses": ego_poses.digest, "annotations": annotations.digest}
    return Request(params, (), inputs | {"timeline": digest_json(timeline_facts(inventory))})


def make(
    params: Mapping[str, Any],
    out: ArtifactWriter,
    *,
    inventory: Inventory,
    trajectory: Trajectory,
    annotations: Artifact,
    frames: Mapping[str, Artifact],
    sweeps: Mapping[str, Artifact],
) -> dict[str, Any]:
    """Draw the pictures; return the summary.

    Args:
        params: as made by `request`.
        out: the artifact.
        inventory: what is in the recording.
        trajectory: `global_SE3_ego`, the content of `ego_poses`.
        annotations: the artifact of boxes.
        frames: channel -> artifact of its images.
        sweeps: channel -> artifact of its point files.
    """
    extrinsics, lidar = params["extrinsics"], params["lidar"]
    cameras = {
        name: CameraImages.of(name, frames[name], extrinsics[name], params["cameras"][name])
        for name in params["order"]
    }
    pictures = Pictures(
        cameras={name: camera for name, camera in cameras.items() if len(camera.files)},
        clouds=None if lidar is None else Clouds.of(lidar, sweeps[lidar], extrinsics[lidar]),
        trajectory=trajectory,
        boxes=BoxTable.from_arrow(annotations.read_table("annotations.parquet")),
        timeline_facts=timeline_facts(inventory),
        width=params["width"],
        columns=params["columns"],
        future_s=params["future_s"],
        range_m=params["range_m"],
    )
    drawn: dict[str, Image] = {}
    missing: dict[str, str] = {}
    for name in TITLES:
        try:
            drawn[name] = pictures.draw(name)
        except CannotDrawError as err:
            missing[name] = str(err)
            continue
        out.write(f"{name}.jpg", jpeg(drawn[name]))
        # Words shrink with a picture: the one that consists of words is drawn anew.
        inline = timeline(pictures.timeline_facts, INLINE_WIDTH_PX) if name == "timeline" else drawn[name]
        out.write(f"inline/{name}.jpg", jpeg_within(inline, INLINE_BYTES, INLINE_WIDTH_PX))
    stands_for_all = next(drawn[name] for name in _THUMBNAILS if name in drawn)
    out.write(THUMBNAIL, jpeg_within(stands_for_all, THUMBNAIL_BYTES, THUMBNAIL_WIDTH_PX))
    facts = {"pictures": list(drawn), "missing": missing, "moment_ns": pictures.moment_ns}
    out.write_json(FACTS, facts)
    return facts


def _first(wanted: str, names: list[str]) -> list[str]:
    """Return the names with the wanted one, if it is there, at the front."""
    return sorted(names, key=lambda name: (name != wanted, names.index(name)))


def _lens(rig: Rig, calibration: Mapping[str, Any], name: str) -> Mapping[str, Any] | None:
    """Return the lens that images of a camera were written with; None if they are free of distortion."""
    channel = rig.channels[name]
    if isinstance(channel, CameraChannel) and not channel.undistort:
        lens: Mapping[str, Any] | None = calibration["channels"][name]["camera"]
        return lens
    return None
