"""Who says what when: the messages of a sample drive, in the order in which they are logged.

Each sensor is a stream of its own; a message is logged a constant time after its header stamp, as
on a real car, and the streams are merged by log time.
"""

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.se3 import SE3, quaternion_multiply, rotate
from bagassets.geometry.wgs84 import LocalFrame
from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.recorder import Recorder
from bagassets.sample.render import CameraView, lidar_points, radar_targets
from bagassets.sample.rig import EGO_SE3_LIDAR, EGO_SE3_RADAR, LIDAR, RADAR, Camera
from bagassets.sample.truth import Truth
from bagassets.sample.world import RADIUS_M

__all__ = [
    "CAMERA_LATENCY_NS",
    "GEODETIC_ORIGIN",
    "MAP_SE3_ODOM",
    "Event",
    "Make",
    "camera_image",
    "drive_events",
    "event",
    "merged",
    "mosaic",
    "motion_events",
]

Make = Callable[[Messages], Message]

# Where the frame `odom` of seed 0 lies on Earth; x is east, y north.
GEODETIC_ORIGIN = LocalFrame(48.0775, 11.6405, 552.0)
MAP_SE3_ODOM = SE3((0.9950041652780258, 0.0, 0.0, 0.09983341664682815), (12.0, -7.0, 0.0))

_MS = 1_000_000
# How long after its header stamp a message is logged.
CAMERA_LATENCY_NS, LIDAR_LATENCY_NS, LATENCY_NS = 30 * _MS, 105 * _MS, 2 * _MS
GRAVITY_MPS2 = 9.81


@dataclass(frozen=True)
class Event:
    """One message to record.

    Attributes:
        log_time_ns: when it is logged.
        topic: its topic.
        msgtype: `pkg/msg/Type`.
        payload: gives the serialized message for a recorder.
        make: gives the message itself; None for the serialized messages of the profile `tas`.
    """

    log_time_ns: int
    topic: str
    msgtype: str
    payload: Callable[[Recorder], bytes | bytearray]
    make: Make | None = None


def event(log_time_ns: int, topic: str, msgtype: str, make: Make) -> Event:
    """Return the event of a message that `make` makes."""
    return Event(
        log_time_ns,
        topic,
        msgtype,
        lambda recorder: recorder.serialize(msgtype, make(recorder.messages)),
        make,
    )


def merged(*streams: Iterator[Event]) -> Iterator[Event]:
    """Yield the events of several streams in the order of their log times."""
    return heapq.merge(*streams, key=lambda one: one.log_time_ns)


def drive_events(truth: Truth, duration_s: float) -> Iterator[Event]:
    """Yield all messages of a drive with every sensor, in the order of their log times."""
    end_ns = truth.start_ns + round(duration_s * 1e9)
    return merged(
        motion_events(truth, end_ns),
        _lidar(truth, end_ns),
        _radar(truth, end_ns),
        _boxes(truth, end_ns),
        *(_camera(truth, camera, number, end_ns) for number, camera in enumerate(truth.cameras.values())),
    )


def motion_events(truth: Truth, end_ns: int) -> Iterator[Event]:
    """Yield where the car is and where its sensors sit: TF, odometry, GNSS and IMU."""
    return merged(
        _static(truth),
        _odometry(truth, end_ns),
        _transforms(truth, end_ns),
        _map(truth, end_ns),
        _gnss(truth, end_ns),
        _imu(truth, end_ns),
    )


def _stamps(truth: Truth, end_ns: int, period_ns: int, offset_ns: int = 0) -> range:
    """Return header stamps up to and with the end."""
    return range(truth.start_ns + offset_ns, end_ns + 1, period_ns)


def _static(truth: Truth) -> Iterator[Event]:
    sensors = [(camera.frame, camera.ego_SE3_cam) for camera in truth.cameras.values()]
    sensors += [("lidar_top", EGO_SE3_LIDAR), ("radar_front", EGO_SE3_RADAR)]
    make = partial(Messages.transforms, stamp_ns=truth.start_ns, parent="base_link", children=sensors)
    yield event(truth.start_ns, "/tf_static", "tf2_msgs/msg/TFMessage", make)


def _odometry(truth: Truth, end_ns: int) -> Iterator[Event]:
    speed = truth.world.ego.speed_mps
    for stamp_ns in _stamps(truth, end_ns, 20 * _MS):
        make = partial(
            Messages.odometry,
            stamp_ns=stamp_ns,
            odom_SE3_ego=truth.odom_SE3_ego(stamp_ns),
            speed_mps=speed,
            yaw_rate=speed / RADIUS_M,
        )
        yield event(stamp_ns + LATENCY_NS, "/odom", "nav_msgs/msg/Odometry", make)


def _transforms(truth: Truth, end_ns: int) -> Iterator[Event]:
    for stamp_ns in _stamps(truth, end_ns, 20 * _MS):
        edge = [("base_link", truth.odom_SE3_ego(stamp_ns))]
        make = partial(Messages.transforms, stamp_ns=stamp_ns, parent="odom", children=edge)
        yield event(stamp_ns + LATENCY_NS, "/tf", "tf2_msgs/msg/TFMessage", make)


def _map(truth: Truth, end_ns: int) -> Iterator[Event]:
    """Yield where the localization sees `odom` in the map, at its own slow rate."""
    for stamp_ns in _stamps(truth, end_ns, 200 * _MS):
        edge = [("odom", MAP_SE3_ODOM)]
        make = partial(Messages.transforms, stamp_ns=stamp_ns, parent="map", children=edge)
        yield event(stamp_ns + 2 * LATENCY_NS, "/tf", "tf2_msgs/msg/TFMessage", make)


def _gnss(truth: Truth, end_ns: int) -> Iterator[Event]:
    for stamp_ns in _stamps(truth, end_ns, 100 * _MS):
        position = np.array([truth.odom_SE3_ego(stamp_ns).translation])
        lat, lon, alt = (float(value[0]) for value in GEODETIC_ORIGIN.to_geodetic(position))
        make = partial(
            Messages.fix, stamp_ns=stamp_ns, frame="base_link", lat_deg=lat, lon_deg=lon, alt_m=alt
        )
        yield event(stamp_ns + LATENCY_NS, "/gnss/fix", "sensor_msgs/msg/NavSatFix", make)


def _imu(truth: Truth, end_ns: int) -> Iterator[Event]:
    """Yield turn rates and accelerations, as central differences of the true motion."""
    step_s = 1e-3
    for stamp_ns in _stamps(truth, end_ns, 10 * _MS):
        positions, rotations = truth.world.ego.pose(
            truth.seconds(stamp_ns) + np.array([-step_s, 0.0, step_s])
        )
        ego_from_odom = rotations[1] * [1.0, -1.0, -1.0, -1.0]
        turn = quaternion_multiply(rotations[0] * [1.0, -1.0, -1.0, -1.0], rotations[2])
        force = (positions[2] - 2 * positions[1] + positions[0]) / step_s**2 + [0.0, 0.0, GRAVITY_MPS2]
        make = partial(
            Messages.imu,
            stamp_ns=stamp_ns,
            frame="base_link",
            enu_SE3_ego=SE3.create(rotations[1], positions[1]),
            rate=turn[1:] / step_s,  # twice the vector part is the angle, turned in two steps
            acceleration=rotate(ego_from_odom, force),
        )
        yield event(stamp_ns + LATENCY_NS, "/imu/data", "sensor_msgs/msg/Imu", make)


def _lidar(truth: Truth, end_ns: int) -> Iterator[Event]:
    """Yield revolutions, stamped when they begin and logged when they are over."""
    for stamp_ns in _stamps(truth, end_ns - LIDAR.period_ns, LIDAR.period_ns):
        points = lidar_points(truth.world, truth.seconds(stamp_ns))
        make = partial(Messages.cloud, stamp_ns=stamp_ns, frame="lidar_top", points=points)
        yield event(stamp_ns + LIDAR_LATENCY_NS, "/lidar_top/points", "sensor_msgs/msg/PointCloud2", make)


def _radar(truth: Truth, end_ns: int) -> Iterator[Event]:
    names = ("x", "y", "z", "rcs", "vx", "vy", "vx_comp", "vy_comp")
    for stamp_ns in _stamps(truth, end_ns, RADAR.period_ns):
        targets = radar_targets(truth.world, truth.seconds(stamp_ns))
        points = np.array(
            [tuple(target[name] for name in names) for target in targets], [(name, "<f4") for name in names]
        )
        make = partial(Messages.cloud, stamp_ns=stamp_ns, frame="radar_front", points=points)
        yield event(stamp_ns + LATENCY_NS, "/radar_front/points", "sensor_msgs/msg/PointCloud2", make)


def _boxes(truth: Truth, end_ns: int) -> Iterator[Event]:
    for stamp_ns in _stamps(truth, end_ns, 100 * _MS):
        make = partial(Messages.detections, stamp_ns=stamp_ns, frame="odom", boxes=truth.boxes(stamp_ns))
        yield event(stamp_ns + LATENCY_NS, "/annotations", "vision_msgs/msg/Detection3DArray", make)


def _camera(truth: Truth, camera: Camera, number: int, end_ns: int) -> Iterator[Event]:
    view = CameraView(truth.world, camera)
    for stamp_ns in _stamps(truth, end_ns, 100 * _MS, (10 + 5 * number) * _MS):
        log_time_ns = stamp_ns + CAMERA_LATENCY_NS
        info = partial(Messages.camera_info, stamp_ns=stamp_ns, camera=camera)
        yield event(log_time_ns, f"/{camera.name}/camera_info", "sensor_msgs/msg/CameraInfo", info)
        topic, msgtype, make = camera_image(camera, stamp_ns, view.image(truth.seconds(stamp_ns)))
        yield event(log_time_ns, topic, msgtype, make)


def camera_image(camera: Camera, stamp_ns: int, image_bgr: NDArray[np.uint8]) -> tuple[str, str, Make]:
    """Return topic, type and message of an image as its camera records it."""
    topic, frame = f"/{camera.name}/image_raw", camera.frame
    if camera.encoding == "jpeg":
        data = cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        make = partial(Messages.compressed_image, stamp_ns=stamp_ns, frame=frame, kind="jpeg", data=data)
        return f"{topic}/compressed", "sensor_msgs/msg/CompressedImage", make
    pixels = mosaic(image_bgr) if camera.encoding.startswith("bayer") else image_bgr[:, :, ::-1]
    encoding = camera.encoding
    image = partial(Messages.image, stamp_ns=stamp_ns, frame=frame, encoding=encoding, pixels=pixels)
    return topic, "sensor_msgs/msg/Image", image


def mosaic(image_bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return what a sensor with an RGGB filter records of an image (H, W, 3): (H, W)."""
    raw = image_bgr[:, :, 1].copy()
    raw[0::2, 0::2] = image_bgr[0::2, 0::2, 2]
    raw[1::2, 1::2] = image_bgr[1::2, 1::2, 0]
    return raw
