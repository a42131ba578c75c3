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
from bagassets.sample.render import CameraView, lidar_points, radar_targets
from bagassets.sample.rig import EGO_SE3_LIDAR, EGO_SE3_RADAR, LIDAR, RADAR, Camera
from bagassets.sample.truth import Truth
from bagassets.sample.world import RADIUS_M

Make = Callable[[Messages], Message]

# Where the frame `odom` of seed 0 lies on Earth; x is east, y north.
GEODETIC_ORIGIN = LocalFrame(48.0775, 11.6405, 552.0)
MAP_SE3_ODOM = SE3((0.9950041652780258, 0.0, 0.0, 0.09983341664682815), (12.0, -7.0, 0.0))

_MS = 1_000_000
# How long after its header stamp a message is logged.
CAMERA_LATENCY_NS, LIDAR_LATENCY_NS, LATENCY_NS = 30 * _MS, 105 * _MS, 2 * _MS
GRAVITY_MPS2 = 9.81
_CLOUD = "sensor_msgs/msg/PointCloud2"


@dataclass(frozen=True)
class Event:
    """One message to record.

    Attributes:
        log_time_ns: when it is logged.
        topic: its topic.
        msgtype: `pkg/msg/Type`.
        make: gives the message itself.
    """

    log_time_ns: int
    topic: str
    msgtype: str
    make: Make


def merged(*streams: Iterator[Event]) -> Iterator[Event]:
    """Yield the events of several streams in the order of their log times."""
    return heapq.merge(*streams, key=lambda one: one.log_time_ns)


def drive_events(truth: Truth, duration_s: float) -> Iterator[Event]:
    """Yield all messages of a drive with every sensor, in the order of their log times."""
    end_ns = truth.start_ns + round(duration_s * 1e9)
    periodic = partial(_periodic, truth, end_ns)
    return merged(
        motion_events(truth, end_ns),
        # Revolutions are stamped when they begin and logged when they are over.
        _periodic(
            truth, end_ns - LIDAR.period_ns, LIDAR.period_ns, "/lidar_top/points", _CLOUD,
            partial(_revolution, truth), LIDAR_LATENCY_NS,
        ),
        periodic(RADAR.period_ns, "/radar_front/points", _CLOUD, partial(_targets, truth)),
        periodic(100 * _MS, "/annotations", "vision_msgs/msg/Detection3DArray", partial(_boxes, truth)),
        *(_camera(truth, camera, number, end_ns) for number, camera in enumerate(truth.cameras.values())),
    )  # fmt: skip


def motion_events(truth: Truth, end_ns: int) -> Iterator[Event]:
    """Yield where the car is and where its sensors sit: TF, odometry, GNSS and IMU."""
    periodic, tf = partial(_periodic, truth, end_ns), "tf2_msgs/msg/TFMessage"
    return merged(
        iter([Event(truth.start_ns, "/tf_static", tf, partial(_mounts, truth))]),
        periodic(20 * _MS, "/odom", "nav_msgs/msg/Odometry", partial(_odometry, truth)),
        periodic(
            20 * _MS, "/tf", tf, lambda at_ns: _edge(at_ns, "odom", "base_link", truth.odom_SE3_ego(at_ns))
        ),
        # Where the localization sees `odom` in the map, at its own slow rate.
        periodic(
            200 * _MS, "/tf", tf, lambda at_ns: _edge(at_ns, "map", "odom", MAP_SE3_ODOM), 2 * LATENCY_NS
        ),
        periodic(100 * _MS, "/gnss/fix", "sensor_msgs/msg/NavSatFix", partial(_fix, truth)),
        periodic(10 * _MS, "/imu/data", "sensor_msgs/msg/Imu", partial(_imu, truth)),
    )


def _periodic(
    truth: Truth,
    end_ns: int,
    period_ns: int,
    topic: str,
    msgtype: str,
    make_at: Callable[[int], Make],
    latency_ns: int = LATENCY_NS,
) -> Iterator[Event]:
    """Yield the messages of a topic, one a period up to and with the end; `make_at` takes the header stamp of each."""
    for stamp_ns in range(truth.start_ns, end_ns + 1, period_ns):
        yield Event(stamp_ns + latency_ns, topic, msgtype, make_at(stamp_ns))


def _mounts(truth: Truth, messages: Messages) -> Message:
    sensors = [(camera.frame, camera.ego_SE3_cam) for camera in truth.cameras.values()]
    sensors += [("lidar_top", EGO_SE3_LIDAR), ("radar_front", EGO_SE3_RADAR)]
    return messages.transforms(truth.start_ns, "base_link", sensors)


def _edge(stamp_ns: int, parent: str, child: str, parent_SE3_child: SE3) -> Make:
    return lambda messages: messages.transforms(stamp_ns, parent, [(child, parent_SE3_child)])


def _odometry(truth: Truth, stamp_ns: int) -> Make:
    speed, ego = truth.world.ego.speed_mps, truth.odom_SE3_ego(stamp_ns)
    return lambda messages: messages.odometry(stamp_ns, ego, speed, speed / RADIUS_M)


def _fix(truth: Truth, stamp_ns: int) -> Make:
    position = np.array([truth.odom_SE3_ego(stamp_ns).translation])
    place = [float(value[0]) for value in GEODETIC_ORIGIN.to_geodetic(position)]
    return lambda messages: messages.fix(stamp_ns, "base_link", *place)


def _imu(truth: Truth, stamp_ns: int) -> Make:
    """Return turn rate and acceleration, as central differences of the true motion."""
    step_s = 1e-3
    positions, rotations = truth.world.ego.pose(truth.seconds(stamp_ns) + np.array([-step_s, 0.0, step_s]))
    ego_from_odom = rotations[1] * [1.0, -1.0, -1.0, -1.0]
    turn = quaternion_multiply(rotations[0] * [1.0, -1.0, -1.0, -1.0], rotations[2])
    force = (positions[2] - 2 * positions[1] + positions[0]) / step_s**2 + [0.0, 0.0, GRAVITY_MPS2]
    return partial(
        Messages.imu,
        stamp_ns=stamp_ns,
        frame="base_link",
        enu_SE3_ego=SE3.create(rotations[1], positions[1]),
        rate=turn[1:] / step_s,  # twice the vector part is the angle, turned in two steps
        acceleration=rotate(ego_from_odom, force),
    )


def _revolution(truth: Truth, stamp_ns: int) -> Make:
    points = lidar_points(truth.world, truth.seconds(stamp_ns))
    return lambda messages: messages.cloud(stamp_ns, "lidar_top", points)


def _targets(truth: Truth, stamp_ns: int) -> Make:
    kind = [(name, "<f4") for name in ("x", "y", "z", "rcs", "vx", "vy", "vx_comp", "vy_comp")]
    targets = radar_targets(truth.world, truth.seconds(stamp_ns))
    points = np.array([tuple(target[name] for name, _ in kind) for target in targets], kind)
    return lambda messages: messages.cloud(stamp_ns, "radar_front", points)


def _boxes(truth: Truth, stamp_ns: int) -> Make:
    boxes = truth.boxes(stamp_ns)
    return lambda messages: messages.detections(stamp_ns, "odom", boxes)


def _camera(truth: Truth, camera: Camera, number: int, end_ns: int) -> Iterator[Event]:
    view = CameraView(truth.world, camera)
    for stamp_ns in range(truth.start_ns + (10 + 5 * number) * _MS, end_ns + 1, 100 * _MS):
        yield from camera_events(
            camera, stamp_ns, sensed(camera.encoding, view.image(truth.seconds(stamp_ns)))
        )


def camera_events(camera: Camera, stamp_ns: int, recorded: NDArray[np.uint8]) -> Iterator[Event]:
    """Yield the calibration of a camera and an image, which is as of `sensed`."""
    info = partial(Messages.camera_info, stamp_ns=stamp_ns, camera=camera)
    log_time_ns, below = stamp_ns + CAMERA_LATENCY_NS, f"/{camera.name}"
    yield Event(log_time_ns, f"{below}/camera_info", "sensor_msgs/msg/CameraInfo", info)
    topic = f"{below}/image_raw" + ("/compressed" if camera.encoding == "jpeg" else "")
    yield Event(log_time_ns, topic, *image_message(camera.frame, camera.encoding, stamp_ns, recorded))


def sensed(encoding: str, image_bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return what messages of an encoding hold of an image (H, W, 3): a mosaic (H, W), RGB (H, W, 3), or a JPEG file (N,)."""
    if encoding == "jpeg":
        return np.asarray(cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])[1], np.uint8)
    if not encoding.startswith("bayer"):
        return image_bgr[:, :, ::-1]
    raw = image_bgr[:, :, 1].copy()
    raw[0::2, 0::2] = image_bgr[0::2, 0::2, 2]
    raw[1::2, 1::2] = image_bgr[1::2, 1::2, 0]
    return raw


def image_message(frame: str, encoding: str, stamp_ns: int, recorded: NDArray[np.uint8]) -> tuple[str, Make]:
    """Return type and message of an image, which is as of `sensed`."""
    if encoding == "jpeg":
        make = partial(
            Messages.compressed_image, stamp_ns=stamp_ns, frame=frame, kind=encoding, data=recorded.tobytes()
        )
        return "sensor_msgs/msg/CompressedImage", make
    image = partial(Messages.image, stamp_ns=stamp_ns, frame=frame, encoding=encoding, pixels=recorded)
    return "sensor_msgs/msg/Image", image
