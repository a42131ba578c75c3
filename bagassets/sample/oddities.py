"""What real recordings do and the sample car does not: each oddity changes the messages of a drive."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial
from itertools import tee
from math import atan2, cos, hypot, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.decode.fields import stamp_and_frame, stamp_ns
from bagassets.decode.pointcloud2 import point_fields
from bagassets.geometry.se3 import SE3
from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.render import CameraView, radar_targets
from bagassets.sample.rig import EGO_SE3_LIDAR, Camera
from bagassets.sample.schedule import (
    CAMERA_LATENCY_NS,
    LATENCY_NS,
    Event,
    Make,
    camera_events,
    merged,
    sensed,
)
from bagassets.sample.truth import Truth

# --- the stream of messages -----------------------------------------------------------------

# Gets events in the order of their log times, and yields them in that order.
_Oddity = Callable[[Iterator[Event], Truth], Iterator[Event]]
# (factory, message, its number on the topic) -> the message to record.
_Edit = Callable[[Messages, Message, int], Message]
# What another clock says at a time.
_Clock = Callable[[int], int]


def edited(events: Iterator[Event], topics: Collection[str], edit: _Edit) -> Iterator[Event]:
    """Yield all events, with those of some topics edited; times, topics and types stay."""
    numbers = dict.fromkeys(topics, 0)
    for one in events:
        if one.topic not in numbers:
            yield one
            continue
        number, make = numbers[one.topic], one.make
        numbers[one.topic] += 1
        yield Event(one.log_time_ns, one.topic, one.msgtype, partial(_edit, edit, make, number))


def _editing(topic: str, edit: _Edit) -> _Oddity:
    """Return the oddity that the messages of a topic are edited."""
    return lambda events, _truth: edited(events, {topic}, edit)


def _edit(edit: _Edit, make: Make, number: int, messages: Messages) -> Message:
    return edit(messages, make(messages), number)


def _on_clock(events: Iterator[Event], clock: _Clock) -> Iterator[Event]:
    """Yield events as on another clock: their log times, and the stamps in their messages."""
    for one in events:
        yield Event(clock(one.log_time_ns), one.topic, one.msgtype, partial(_stamped, clock, one.make))


def _stamped(clock: _Clock, make: Make, messages: Messages) -> Message:
    message = make(messages)
    parts = getattr(message, "transforms", [message, *getattr(message, "detections", ())])
    for header in {id(part.header): part.header for part in parts}.values():  # some share one
        header.stamp = messages.time(clock(stamp_ns(header.stamp)))
    return message


def with_fields(message: Message, **fields: object) -> Message:
    """Set fields of a message and return it."""
    for name, value in fields.items():
        setattr(message, name, value)
    return message


# --- cameras --------------------------------------------------------------------------------


def rectified(camera: Camera) -> Camera:
    """Return what a camera is after its driver has rectified its images: without distortion, a little wider."""
    lens = camera.model
    return replace(
        camera, model=lens.undistorted((0.9 * lens.fx, 0.9 * lens.fy, lens.cx - 3.0, lens.cy + 2.0))
    )


def _projection_only(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """Rectified images, and the CameraInfo of such: K, D and R are zero, only P is filled in."""
    cameras = {camera.name: rectified(camera) for camera in truth.cameras.values()}
    views = {name: CameraView(truth.world, camera) for name, camera in cameras.items()}
    for one in events:
        name, _, topic = one.topic[1:].partition("/")
        if name not in cameras:
            yield one
        elif topic == "camera_info":
            camera, stamp_ns = cameras[name], one.log_time_ns - CAMERA_LATENCY_NS
            image = sensed(camera.encoding, views[name].image(truth.seconds(stamp_ns)))
            info, picture = camera_events(camera, stamp_ns, image)
            yield from (replace(info, make=partial(_only_p, stamp_ns, camera)), picture)


def _only_p(stamp_ns: int, camera: Camera, messages: Messages) -> Message:
    k, d, r = "KDR" if messages.ros1 else "kdr"
    info = messages.camera_info(stamp_ns, camera)
    return with_fields(info, distortion_model="", **{k: np.zeros(9), d: np.zeros(0), r: np.zeros(9)})


# --- lidars: times of points, and what is sent where nothing was hit ------------------------

_Columns = dict[str, NDArray[Any]]
# (columns of a cloud, its header stamp, its number) -> the columns to record.
_Change = Callable[[_Columns, int, int], _Columns]

UNTIMED = slice(50, 90)
"""Points whose times are spoilt, where some are."""
_UPTIME_NS = 3_298_372_665_000


def _clouds(change: _Change) -> _Oddity:
    def edit(messages: Messages, cloud: Message, number: int) -> Message:
        header_ns, frame = stamp_and_frame(cloud.header)
        columns = {name: values[0].copy() for name, values in point_fields(cloud).items()}
        changed = change(columns, header_ns, number)
        points = np.zeros(len(changed["x"]), [(name, values.dtype) for name, values in changed.items()])
        for name, values in changed.items():
            points[name] = values
        return messages.cloud(header_ns, frame, points)

    return _editing("/lidar_top/points", edit)


def _dated(columns: _Columns, header_ns: int, _number: int) -> _Columns:
    dates_s = (header_ns + columns.pop("t").astype(np.int64)) / 1e9
    return columns | {"timestamp": dates_s}


def _with_zeros(columns: _Columns, header_ns: int, number: int) -> _Columns:
    dated = _dated(columns, header_ns, number)
    dated["timestamp"][UNTIMED] = 0.0
    return dated


def _with_garbage(columns: _Columns, _header_ns: int, number: int) -> _Columns:
    if number in {0, 3, 4, 5}:
        columns["t"][UNTIMED] = 1_100_000_000 if number else 3_604_361_924
    return columns


def _uptime(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    def tell(columns: _Columns, header_ns: int, _number: int) -> _Columns:
        since_start_ns = header_ns - truth.start_ns + columns["t"].astype(np.int64)
        return columns | {"t": (_UPTIME_NS + since_start_ns).astype(np.float64)}

    return _clouds(tell)(events, truth)


def _simulated(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """All clocks start at 0, that of the recorder, too, and points tell seconds of it."""
    return _clouds(_dated)(_on_clock(events, lambda at_ns: at_ns - truth.start_ns), truth)


# --- radars: what velocities are, of one that looks half to the left from the left corner ---

EGO_SE3_TURNED_RADAR = SE3((cos(0.4), 0.0, 0.0, sin(0.4)), (3.4, 0.7, 0.5))

_Targets = list[dict[str, float]]
_TOPIC, _FRAME = "/radar_front/points", "radar_front"
_PLACE = ("x", "y", "z", "rcs")


def _turned(msgtype: str, make: Callable[[int, _Targets, Messages], Message]) -> _Oddity:
    """Return the oddity of a turned radar that sees buildings, too, and sends these messages."""

    def oddity(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
        for one in edited(events, {"/tf_static"}, _turn):
            if one.topic == _TOPIC:
                stamp_ns = one.log_time_ns - LATENCY_NS
                targets = radar_targets(
                    truth.world, truth.seconds(stamp_ns), EGO_SE3_TURNED_RADAR, buildings=True
                )
                yield Event(one.log_time_ns, _TOPIC, msgtype, partial(make, stamp_ns, targets))
            else:
                yield one

    return oddity


def _turn(messages: Messages, message: Message, _number: int) -> Message:
    (turned,) = messages.transforms(0, "base_link", [(_FRAME, EGO_SE3_TURNED_RADAR)]).transforms
    for edge in message.transforms:
        if edge.child_frame_id == _FRAME:
            with_fields(edge, transform=turned.transform)
    return message


def _cloud(suffix: str, stamp_ns: int, targets: _Targets, messages: Messages) -> Message:
    """Return a cloud with one kind of velocities, under the names that say nothing about it."""
    kind = [(name, "<f4") for name in (*_PLACE, "vx", "vy")]
    names = (*_PLACE, f"vx{suffix}", f"vy{suffix}")
    return messages.cloud(stamp_ns, _FRAME, np.array([tuple(map(one.get, names)) for one in targets], kind))


def _scan(stamp_ns: int, targets: _Targets, messages: Messages) -> Message:
    returns = []
    for one in targets:
        x, y, z = (one[axis] for axis in "xyz")
        distance, ground = sqrt(x * x + y * y + z * z), hypot(x, y)
        doppler = (x * one["vx"] + y * one["vy"] + z * one["vz"]) / distance
        angles = atan2(y, x), atan2(z, ground)
        returns.append(messages.make("radar_msgs/RadarReturn", distance, *angles, doppler, one["rcs"]))
    return messages.make("radar_msgs/RadarScan", messages.header(stamp_ns, _FRAME), returns)


_CLOUD = "sensor_msgs/msg/PointCloud2"


# --- clocks, and what says where the car and its sensors are --------------------------------

SET_AFTER_NS = 2_000_000_000
BOOTED_NS = 200_000_000_000_000
SET_BACK_NS = 503_000_000
_STRAY_DEG, _APART_M, _LATER_NS = 4.6, 0.29, 7_000_000


def _clock_set_late(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """The clock of the recorder, and of all drivers, starts in 1970 and is set after 2 s."""
    set_ns = truth.start_ns + SET_AFTER_NS
    return _on_clock(events, lambda at_ns: at_ns if at_ns >= set_ns else at_ns - truth.start_ns + BOOTED_NS)


def _clock_set_back(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """After 2 s, the clock is set back by half a second, so that this half second is recorded twice."""
    set_ns = truth.start_ns + SET_AFTER_NS
    return _on_clock(events, lambda at_ns: at_ns if at_ns < set_ns else at_ns - SET_BACK_NS)


def _stray_fix(_: Messages, fix: Message, number: int) -> Message:
    """The first two fixes are 512 km off."""
    return with_fields(fix, latitude=fix.latitude + _STRAY_DEG * (number < 2))


def _zero_quaternion(_: Messages, odometry: Message, number: int) -> Message:
    """The quaternions of the first ten odometry messages are zero."""
    if number < 10:
        with_fields(odometry.pose.pose.orientation, x=0.0, y=0.0, z=0.0, w=0.0)
    return odometry


def _two_publishers(events: Iterator[Event], truth: Truth) -> Iterator[Event]:
    """Another node publishes on /odom, 0.29 m to the side."""
    first, second = tee(events)
    moved = edited((one for one in second if one.topic == "/odom"), ["/odom"], partial(_aside, truth))
    return merged(first, _on_clock(moved, lambda at_ns: at_ns + _LATER_NS))


def _aside(truth: Truth, _: Messages, odometry: Message, _number: int) -> Message:
    # The pose of the other node is that of the car at its own, later stamp.
    ego = truth.odom_SE3_ego(stamp_ns(odometry.header.stamp) + _LATER_NS)
    x, y, z = (ego @ SE3(translation=(0.0, _APART_M, 0.0))).translation
    with_fields(odometry.pose.pose.position, x=x, y=y, z=z)
    return odometry


def _with_edge(parent: str, child: str, parent_SE3_child: SE3) -> _Oddity:
    """Return the oddity that a static transform is sent besides all others, at the same time."""

    def edit(messages: Messages, message: Message, _number: int) -> Message:
        (edge,) = messages.transforms(0, parent, [(child, parent_SE3_child)]).transforms
        edge.header.stamp = message.transforms[0].header.stamp
        return with_fields(message, transforms=[*message.transforms, edge])

    return _editing("/tf_static", edit)


# --- namespaces: which robot a topic belongs to ---------------------------------------------

APART_M = 50.0


def _two_robots(events: Iterator[Event], _truth: Truth) -> Iterator[Event]:
    """Two cars with frames of equal names: `/robot1`, and `/robot2` 50 m further along x of `odom`."""
    one, other = tee(events)
    moved = {f"/robot2/{name}" for name in ("odom", "tf", "annotations")}
    return merged(_below("/robot1", one), edited(_below("/robot2", other), moved, _moved))


def _one_robot(events: Iterator[Event], _truth: Truth) -> Iterator[Event]:
    """One car below `/robot1`, whose wheels and cameras both give its odometry."""
    for one in _below("/robot1", events):
        estimators = ("wheels/odom", "cameras/odom") if one.topic == "/robot1/odom" else ()
        yield from [replace(one, topic=f"/robot1/{name}") for name in estimators] or [one]


def _below(namespace: str, events: Iterator[Event]) -> Iterator[Event]:
    return (replace(one, topic=f"{namespace}{one.topic}") for one in events)


def _moved(_messages: Messages, message: Message, _number: int) -> Message:
    """Move a car and its boxes; transforms to frames of the map and of the car stay."""
    edges = [one for one in getattr(message, "transforms", ()) if one.child_frame_id == "base_link"]
    positions = [one.transform.translation for one in edges]
    positions += [one.bbox.center.position for one in getattr(message, "detections", ())]
    positions += [message.pose.pose.position] if hasattr(message, "pose") else []
    for position in positions:
        position.x += APART_M
    return message


ODDITIES: dict[str, _Oddity] = {
    "dates-with-zeros": _clouds(_with_zeros),
    "garbage-times": _clouds(_with_garbage),
    "uptime": _uptime,
    "simulated-clock": _simulated,
    "zero-points": _clouds(
        lambda columns, *_: {name: np.insert(one, slice(0, None, 3), 0) for name, one in columns.items()}
    ),
    "unit-intensity": _clouds(
        lambda columns, *_: columns | {"intensity": columns["intensity"] / np.float32(256)}
    ),
    "radar-relative": _turned(_CLOUD, partial(_cloud, "")),
    "radar-over-ground": _turned(_CLOUD, partial(_cloud, "_comp")),
    "radar-scan": _turned("radar_msgs/msg/RadarScan", _scan),
    "clock-set-late": _clock_set_late,
    "clock-set-back": _clock_set_back,
    "stray-fixes": _editing("/gnss/fix", _stray_fix),
    "zero-quaternions": _editing("/odom", _zero_quaternion),
    "two-publishers": _two_publishers,
    "static-again": _with_edge("base_link", "lidar_top", SE3(translation=(0.9 + 3e-8, 0.0, 1.85))),
    "static-disputed": _with_edge("base_link", "lidar_top", SE3(translation=(0.9, 0.0, 1.95))),
    "static-loop": _with_edge("lidar_top", "base_link", EGO_SE3_LIDAR),
    "projection-only": _projection_only,
    "two-robots": _two_robots,
    "one-robot": _one_robot,
}
