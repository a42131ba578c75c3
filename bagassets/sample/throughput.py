"""A drive for measuring speed: as much data as a research car records, written fast.

Four Bayer cameras of 1920 x 1080 pixels at 10 Hz and the packets of a lidar with 128 beams make
about 90 MB per second of drive. Images and revolutions are rendered once per seed and then cycle:
stamps, poses and calibration are true at all times, pictures and points are those of the first
half second. Sensor noise is drawn per image of the cycle, so that JPEG works as hard as on real ones.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import velodyne_decoder
import yaml
from numpy.typing import NDArray

from bagassets.geometry.kernels.returns import BANK_FLAGS, PACKET
from bagassets.geometry.se3 import Floats
from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.render import CameraView, cast_from
from bagassets.sample.rig import Camera, cameras, rear_camera
from bagassets.sample.schedule import Event, camera_events, merged, motion_events, sensed
from bagassets.sample.truth import Truth
from bagassets.sample.world import World

_CYCLE = 5  # different images per camera, different revolutions
_RENDER_SCALE = 4  # rendered at a quarter of the size, then enlarged
_NOISE = 4.0  # standard deviation, grey values
PERIOD_NS = 100_000_000

# Velodyne VLS-128 User Manual (63-9483), section 9: three firings of four blocks of 32 lasers a packet.
_LASERS, _FIRINGS, _FIRING_NS = 128, 3, 57_800
_DISTANCE_UNIT_M, _MAX_RANGE_M = 0.004, 200.0
_STRONGEST_RETURN, _VLS_128 = 0x37, 0xA1
PACKET_NS = _FIRINGS * _FIRING_NS
PACKETS = PERIOD_NS // PACKET_NS + 1


def throughput_cameras(width: int, height: int) -> list[Camera]:
    """Return four cameras, all of which record Bayer images."""
    rig = [*cameras(width, height), rear_camera(width, height)]
    return [replace(camera, encoding="bayer_rggb8") for camera in rig]


def throughput_events(truth: Truth, duration_s: float, seed: int) -> Iterator[Event]:
    """Yield all messages of a drive, in the order of their log times."""
    end_ns = truth.start_ns + round(duration_s * 1e9)
    streams = [motion_events(truth, end_ns), _lidar(truth, end_ns)]
    streams += [
        _camera(truth, camera, number, seed, end_ns) for number, camera in enumerate(truth.cameras.values())
    ]
    return merged(*streams)


def _camera(truth: Truth, camera: Camera, number: int, seed: int, end_ns: int) -> Iterator[Event]:
    images = [
        sensed(camera.encoding, image)
        for image in _images(truth.world, camera, np.random.default_rng([seed, number]))
    ]
    first_ns = truth.start_ns + (10 + 5 * number) * 1_000_000
    for count, stamp_ns in enumerate(range(first_ns, end_ns + 1, PERIOD_NS)):
        yield from camera_events(camera, stamp_ns, images[count % _CYCLE])


def _images(world: World, camera: Camera, dice: np.random.Generator) -> Iterator[NDArray[np.uint8]]:
    model = camera.model
    size = (model.width, model.height)
    # Pixel centres scale about the corner of the image, not about the centre of its first pixel.
    coarse = replace(
        model,
        width=model.width // _RENDER_SCALE,
        height=model.height // _RENDER_SCALE,
        fx=model.fx / _RENDER_SCALE,
        fy=model.fy / _RENDER_SCALE,
        cx=(model.cx + 0.5) / _RENDER_SCALE - 0.5,
        cy=(model.cy + 0.5) / _RENDER_SCALE - 0.5,
    )
    view = CameraView(world, replace(camera, model=coarse))
    for count in range(_CYCLE):
        image = cv2.resize(view.image(count * PERIOD_NS * 1e-9), size, interpolation=cv2.INTER_LINEAR)
        noise = dice.normal(0.0, _NOISE, (*image.shape[:2], 1)).astype(np.float32)
        yield np.clip(image + noise, 0, 255).astype(np.uint8)


def _lidar(truth: Truth, end_ns: int) -> Iterator[Event]:
    revolutions = [packets_of_revolution(truth.world, count * PERIOD_NS * 1e-9) for count in range(_CYCLE)]
    for count, stamp_ns in enumerate(range(truth.start_ns, end_ns + 1 - PERIOD_NS, PERIOD_NS)):
        yield Event(
            stamp_ns + PERIOD_NS + 5_000_000,
            "/lidar_top/velodyne_packets",
            "velodyne_msgs/msg/VelodyneScan",
            partial(_scan, stamp_ns=stamp_ns, packets=revolutions[count % _CYCLE]),
        )


def _scan(messages: Messages, stamp_ns: int, packets: NDArray[np.void]) -> Message:
    """Return a revolution, with stamps and the lidar's own clock in its packets."""
    times_ns = stamp_ns + np.arange(PACKETS) * PACKET_NS
    packets["us"] = times_ns // 1000 % 3_600_000_000
    payloads = packets.view(np.uint8).reshape(PACKETS, PACKET.itemsize)
    return messages.velodyne_scan("lidar_top", times_ns.tolist(), payloads)


def packets_of_revolution(world: World, start_s: float) -> NDArray[np.void]:
    """Return the packets (`PACKETS`,) of a revolution that begins at a time, straight ahead.

    The 128 lasers of a firing are taken to fire at once, 53 us earlier or later than they do.
    """
    elevation, turn = _laser_angles()
    firings = np.arange(PACKETS * _FIRINGS)
    head = firings * (2 * np.pi * _FIRING_NS / PERIOD_NS)  # clockwise
    times = np.repeat(start_s + firings * _FIRING_NS * 1e-9, _LASERS)
    # An azimuth is that of the head, turned by each laser's own.
    azimuths = -(head[:, None] - turn[None, :]).reshape(-1)
    elevations = np.tile(elevation, len(firings))
    _, hits = cast_from(world, azimuths, elevations, times)
    seen = (hits.thing >= 0) & (hits.distance_m < _MAX_RANGE_M)
    packets = np.zeros(PACKETS, PACKET)
    blocks = packets["blocks"]
    blocks["flag"] = np.tile(BANK_FLAGS, _FIRINGS)
    hundredths = np.mod(np.round(np.rad2deg(head) * 100), 36_000).astype(np.uint16)
    blocks["azimuth"] = np.repeat(hundredths, len(BANK_FLAGS)).reshape(PACKETS, 12)
    shape = (PACKETS, 12, 32)
    distance = np.where(seen, np.where(seen, hits.distance_m, 0.0) / _DISTANCE_UNIT_M, 0.0)
    blocks["returns"]["distance"] = np.round(distance).astype(np.uint16).reshape(shape)
    blocks["returns"]["intensity"] = (
        np.where(seen, 20 + (hits.thing * 37) % 200, 0).astype(np.uint8).reshape(shape)
    )
    packets["mode"], packets["product"] = _STRONGEST_RETURN, _VLS_128
    return packets


def _laser_angles() -> tuple[Floats, Floats]:
    """Return elevation and azimuth offset of each laser (128,), radians, as the decoder knows them."""
    file = Path(velodyne_decoder.__file__).parent / "calibrations" / "Alpha Prime.yml"
    lasers = yaml.safe_load(file.read_text(encoding="utf-8"))["lasers"]
    angles = np.array([[laser["vert_correction"], laser["rot_correction"]] for laser in lasers])
    return angles[:, 0], angles[:, 1]
