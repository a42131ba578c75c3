"""Recordings to measure with: drives of the profile `tas`, whose lidar is recorded packet by packet.

Research cars record the packets of their lidar as they come from the network, one
`ethernet_msgs/Packet` each; that is also what converters in use expect.
"""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.typesys import get_types_from_msg

from bagassets.geometry.se3 import SE3
from bagassets.propose.project import write_project
from bagassets.sample.drive import PROFILES, drive_start_ns
from bagassets.sample.recipe import sample_recipe
from bagassets.sample.recorder import Compression, Recorder, RecordingFormat, open_recorder
from bagassets.sample.schedule import Event
from bagassets.sample.throughput import (
    PACKET_NS,
    PERIOD_NS,
    throughput_cameras,
    throughput_events,
)
from bagassets.sample.truth import Truth
from bagassets.sample.world import World

__all__ = [
    "BYTES_PER_SECOND",
    "LEAST_BYTES",
    "LIDAR_TOPIC",
    "seconds_of",
    "tas_recipe",
    "with_short_scenes",
    "write_jpeg_project",
    "write_tas_drive",
]

BYTES_PER_SECOND = 90e6
LEAST_BYTES = 27e6
_LEAST_SCENE_S = 0.2
LIDAR_TOPIC = "/lidar_top/packets"
_SCANS = "/lidar_top/velodyne_packets"
_INFO = "sensor_msgs/msg/CameraInfo"
_TYPE = "ethernet_msgs/msg/Packet"
_DEFINITION = """std_msgs/Header header
uint8[4] sender_ip
uint16 sender_port
uint8[4] receiver_ip
uint16 receiver_port
uint8[] payload
"""
_LIDAR_IP, _HOST_IP, _PORT = (192, 168, 3, 43), (255, 255, 255, 255), 2368
_LATENCY_NS = 200_000
_EXTRINSICS = "extrinsics: {translation: [1, 0, 1], rotation: [1, 0, 0, 0]}"
_JPEG_RECIPE = f"""name: jpeg
bags: {{root: recordings, settle_s: 0}}
nuscenes: {{output: nuscenes, version: v1.0-jpeg}}
scenes: {{min_length_s: {_LEAST_SCENE_S}}}
rigs:
  - name: jpeg
    ego_frame: base_link
    ego_pose: {{source: odometry, topic: /odom}}
    channels:
""" + "".join(
    f"      {channel}: {{modality: camera, topic: /cam{number}, output: as_recorded, undistort: false, {_EXTRINSICS}}}\n"
    for number, channel in enumerate(("CAM_FRONT", "CAM_BACK", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"))
)


def seconds_of(size: float) -> float:
    """Return how long a drive of `size` bytes takes."""
    return size / BYTES_PER_SECOND


def write_tas_drive(
    path: Path,
    file_format: RecordingFormat,
    seed: int,
    duration_s: float,
    compression: Compression = "none",
) -> Path:
    """Write one drive, unless it is there already, and return its path."""
    if path.exists():
        return path
    kind = PROFILES["tas"]
    rig = {camera.channel: camera for camera in throughput_cameras(kind.width, kind.height)}
    truth = Truth(World(seed), drive_start_ns(seed), rig)
    unfinished = path.with_name(f"unfinished-{path.name}")
    with ExitStack() as stack:
        recorder = open_recorder(unfinished, file_format, compression, stack)
        recorder.messages.store.register(get_types_from_msg(_DEFINITION, _TYPE))
        for event in throughput_events(truth, duration_s, seed):
            if event.topic == _SCANS:
                for log_time_ns, message in _packets(recorder, event):
                    recorder.write(LIDAR_TOPIC, _TYPE, log_time_ns, message)
            elif event.msgtype == _INFO:
                recorder.write(event.topic, _INFO, event.log_time_ns, _with_region(recorder, event))
            else:
                recorder.write(event.topic, event.msgtype, event.log_time_ns, event.make(recorder.messages))
    unfinished.rename(path)
    return path


def tas_recipe(root: Path, output: str = "nuscenes") -> str:
    """Return the recipe of such drives."""
    text = sample_recipe(root=str(root), output=output, throughput=True)
    return with_short_scenes(text.replace(_SCANS, LIDAR_TOPIC).replace("settle_s: 2", "settle_s: 0"))


def with_short_scenes(recipe: str) -> str:
    """Return a sample recipe that has scenes of recordings of a fraction of a second, too."""
    return recipe.replace("  length_s: 20\n", f"  length_s: 20\n  min_length_s: {_LEAST_SCENE_S}\n")


def write_jpeg_project(folder: Path, size: float) -> Path:
    """Write a project of one ROS 1 bag of about `size` bytes, four cameras that record JPEG; return its recipe.

    Images are a few of different noise, as large as a camera's; nothing undistorts them.
    """
    write_project(folder, _JPEG_RECIPE)
    path = folder / "recordings" / "jpeg.bag"
    path.parent.mkdir(exist_ok=True)
    if path.exists():
        return folder / "recipe.yaml"
    dice = np.random.default_rng(1)
    smooth = cv2.resize(
        dice.integers(0, 256, (17, 30, 3), np.uint8), (1920, 1080), interpolation=cv2.INTER_CUBIC
    )
    images = []
    for _ in range(5):
        noisy = np.clip(smooth + dice.normal(0, 6, (1080, 1920, 1)), 0, 255).astype(np.uint8)
        images.append(bytes(cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]))
    start_ns, per_camera = drive_start_ns(0), max(2, round(size / 4 / np.mean([len(one) for one in images])))
    with ExitStack() as stack:
        recorder = open_recorder(path, "ros1", "none", stack)
        make = recorder.messages
        for number in range(per_camera):
            stamp_ns = start_ns + number * PERIOD_NS
            pose = SE3((1.0, 0.0, 0.0, 0.0), (0.1 * number, 0.0, 0.0))
            recorder.write(
                "/odom", "nav_msgs/msg/Odometry", stamp_ns, make.odometry(stamp_ns, pose, 1.0, 0.0)
            )
            for camera in range(4):
                image = make.compressed_image(stamp_ns, f"cam{camera}", "jpeg", images[number % len(images)])
                recorder.write(f"/cam{camera}", "sensor_msgs/msg/CompressedImage", stamp_ns, image)
    return folder / "recipe.yaml"


def _packets(recorder: Recorder, scan: Event) -> Iterator[tuple[int, Any]]:
    """Yield log time and message of each packet of a revolution, which is written when it is complete."""
    make = recorder.messages
    start_ns = scan.log_time_ns - PERIOD_NS - 5_000_000
    packets: Any = scan.make(make)
    for number, packet in enumerate(packets.packets):
        stamp_ns = start_ns + number * PACKET_NS
        fields = (_ip(_LIDAR_IP), _PORT, _ip(_HOST_IP), _PORT, packet.data)
        # Not before the messages that were written meanwhile: recorders keep the order of arrival.
        log_time_ns = max(stamp_ns + _LATENCY_NS, scan.log_time_ns)
        yield log_time_ns, make.make("ethernet_msgs/Packet", make.header(stamp_ns, "lidar_top"), *fields)


def _with_region(recorder: Recorder, event: Event) -> Any:
    """Return a CameraInfo that says "the whole image" in numbers: converters take zeros for its size."""
    info: Any = event.make(recorder.messages)
    info.roi.width, info.roi.height = info.width, info.height
    return info


def _ip(address: tuple[int, ...]) -> Any:
    return np.array(address, np.uint8)
