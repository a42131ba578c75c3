"""Code versions of assets: step version plus the recipe fields and decoder plug-ins that the asset uses.

Dagster cannot see parameters; through this string a changed recipe shows in its UI as a
changed code version.
"""

from collections.abc import Mapping
from typing import Any

from bagassets.plugins import Family, installed_decoders
from bagassets.recipe.model import READING_LIMITS, CameraChannel, Channel, Recipe, Rig
from bagassets.steps import (
    annotations,
    calibration,
    ego_poses,
    frames,
    inventory,
    nuscenes_tables,
    preview,
    sweeps,
    vision_sequences,
)
from bagassets.store.canonical import digest_json

__all__ = ["code_version"]

_STEPS = {
    "inventory": inventory.STEP,
    "calibration": calibration.STEP,
    "ego_poses": ego_poses.STEP,
    "annotations": annotations.STEP,
    "frames": frames.STEP,
    "sweeps": sweeps.STEP,
    "nuscenes_tables": nuscenes_tables.STEP,
    "vision_sequences": vision_sequences.STEP,
    "preview": preview.STEP,
}
# Plug-ins of these families may decode what an asset reads.
_FAMILIES: Mapping[str, tuple[Family, ...]] = {
    "ego_poses": ("pose",),
    "annotations": ("boxes",),
    "frames": ("image",),
    "sweeps": ("cloud", "radar"),
}


def code_version(recipe: Recipe, asset: str) -> str:
    """Return `<step version>-<digest of the recipe fields and plug-ins>` of one per-recording asset."""
    fields = {rig.name: _rig_fields(recipe, rig, asset) for rig in recipe.rigs}
    selection = recipe.bags.model_dump(mode="json", include={"min_duration_s"})
    plugins = [
        [plugin.name, plugin.as_json()]
        for family in _FAMILIES.get(asset, ())
        for plugin in installed_decoders().of_family(family)
    ]
    used = {"rigs": fields, "selection": selection if asset != "inventory" else None}
    digest = digest_json(used | ({"plugins": plugins} if plugins else {}))
    return f"{_STEPS[asset].version}-{digest[:12]}"


def _rig_fields(recipe: Recipe, rig: Rig, asset: str) -> Any:
    channels = {name: _channel_fields(recipe, channel) for name, channel in sorted(rig.channels.items())}
    cameras = {name for name, channel in rig.channels.items() if isinstance(channel, CameraChannel)}
    limits = recipe.limits
    common = {"clock": recipe.clock, "limits": {"lost_messages": limits.lost_messages}, "match": rig.match,
              "required": rig.required}  # fmt: skip
    match asset:
        case "inventory":
            return limits.changed(*READING_LIMITS) or None
        case "calibration":
            keep = ("topic", "frame", "extrinsics", "camera_info", "intrinsics", "undistort", "rectified")
            parts = {
                name: {k: v for k, v in fields.items() if k in keep} for name, fields in channels.items()
            }
            return [parts, rig.ego_frame, rig.tf, rig.tf_static, str(rig.urdf and rig.urdf.name)]
        case "ego_poses":
            urdf = str(rig.urdf and rig.urdf.name)
            return [common, rig.ego_pose.model_dump(mode="json"), rig.ego_frame, rig.tf, rig.tf_static, urdf]
        case "annotations":
            boxes = [*rig.annotations, *rig.annotation_files]
            return [common, [source.model_dump(mode="json") for source in boxes], rig.ego_frame]
        case "frames":
            cameras_only = {name: fields for name, fields in channels.items() if name in cameras}
            return [common | limits.changed("image_pixels"), cameras_only]
        case "sweeps":
            others = {name: fields for name, fields in channels.items() if name not in cameras}
            return [common | limits.changed("cloud_points"), others]
        case "preview":
            pictures = recipe.preview.model_dump(mode="json", exclude={"enabled", "trajectory_map"})
            return [pictures, sorted(channels)]
        case "vision_sequences":
            vision = recipe.vision and recipe.vision.model_dump(mode="json", exclude={"output", "files"})
            return [vision, rig.name, rig.tf, rig.tf_static, sorted(cameras)]
        case _:
            scenes = recipe.scenes.model_dump(mode="json")
            attributes = recipe.nuscenes.attributes_by_motion.model_dump(mode="json")
            return [scenes, attributes, rig.name, rig.vehicle, rig.location, sorted(channels)]


def _channel_fields(recipe: Recipe, channel: Channel) -> dict[str, Any]:
    """Return the fields of a channel; its clock only if it is another than the recipe's, which stands beside them."""
    clock = recipe.clock_of(channel)
    own = {} if clock == recipe.clock else {"clock": clock}
    return channel.model_dump(mode="json", exclude={"clock"}) | own
