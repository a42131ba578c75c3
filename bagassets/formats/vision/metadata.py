"""`metadata.json` and `transforms.json` of a recording in the vision dataset."""

from collections.abc import Mapping

from bagassets.assets.asset import as_json
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.geometry.calibration import Mounts
from bagassets.geometry.sun import sun_elevation_deg
from bagassets.recordings.inventory import Inventory

__all__ = ["recording_metadata", "transforms_json"]


def recording_metadata(key: str, rig: str, inventory: Inventory) -> JsonObject:
    """Return the facts about a recording as a whole.

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
