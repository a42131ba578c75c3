"""The sample arm: what it does, in closed form, and the messages that record it.

Seven joints and a gripper swing about their centres. A command is where the arm will be `LEAD_S` later. Every `CYCLE_S`
seconds it does a task, said on `/task`; `/episode` says when it begins and ends. The images of both cameras show the arm as
it is at their stamps, and the number of the image as a strip of cells, which survives compression.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.se3 import Floats
from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.schedule import Event, image_message, merged, sensed

JOINTS = tuple(f"joint_{number}" for number in range(1, 8))
ELEMENTS = (*JOINTS, "gripper")
"""Radians of each joint, metres of the gripper's width."""

TASKS = (
    "Put the red cube into the bowl.",
    "Stack the blue cube on the green one.",
    "Move the bowl to the left.",
)
CAMERAS = {"workspace": "/workspace/image_raw/compressed", "wrist": "/wrist/image_raw"}
"""Camera -> its topic."""

STATES, COMMANDS, TASK, EPISODE = "/joint_states", "/joint_commands", "/task", "/episode"
LEAD_S, CYCLE_S, REST_S = 0.1, 2.0, 0.1

_MS = 1_000_000
STATE_PERIOD_NS, COMMAND_PERIOD_NS = 10 * _MS, 20 * _MS
IMAGE_PERIOD_NS = 33_333_333
_IMAGE_DELAY_NS, _LATENCY_NS, _IMAGE_LATENCY_NS = 5 * _MS, 1 * _MS, 12 * _MS
_JOINT_STATE = "sensor_msgs/msg/JointState"
_TEXT = "std_msgs/msg/String"
_CELLS, _CELL_HEIGHT = 16, 8


@dataclass(frozen=True)
class ArmTruth:
    """The ground truth of one recording.

    Attributes:
        seed: each has its own motion.
        start_ns: stamp of its start.
        width: of its images in pixels.
        height: of its images in pixels.
    """

    seed: int
    start_ns: int
    width: int
    height: int

    def seconds(self, stamp_ns: int) -> float:
        """Return seconds since the start."""
        return (stamp_ns - self.start_ns) / 1e9

    def positions(self, times_s: Floats) -> Floats:
        """Return where the joints and the gripper are at times (N,) since the start: (N, 8), in the order of `ELEMENTS`."""
        rows = []
        for number in range(len(JOINTS)):
            amplitude, rate_hz = 0.9 - 0.1 * number, 0.11 + 0.03 * ((number + self.seed) % 5)
            centre = 0.2 * (number - 3)
            rows.append(centre + amplitude * np.sin(2 * np.pi * rate_hz * times_s + self.seed + number))
        rows.append(0.04 + 0.04 * np.cos(2 * np.pi * times_s / CYCLE_S))
        return np.stack(rows, axis=1)

    def commands(self, times_s: Floats) -> Floats:
        """Return what is commanded at times (N,): (N, 8)."""
        return self.positions(times_s + LEAD_S)

    def episodes(self, duration_s: float) -> list[tuple[float, float, str]]:
        """Return begin, end and task of each episode that a recording of this length holds."""
        return [
            (
                cycle * CYCLE_S + REST_S,
                (cycle + 1) * CYCLE_S - REST_S,
                TASKS[(cycle + self.seed) % len(TASKS)],
            )
            for cycle in range(int((duration_s + REST_S) / CYCLE_S))
        ]

    def image(self, camera: str, number: int) -> NDArray[np.uint8]:
        """Return an image of a camera by its number: (H, W, 3) BGR."""
        pose = self.positions(np.array([self.seconds(self.image_stamp_ns(number))]))[0]
        image = _background(self.width, self.height, pose if camera == "wrist" else None)
        if camera == "workspace":
            _draw_arm(image, pose)
        else:
            _draw_gripper(image, float(pose[-1]))
        cell = self.width // _CELLS
        for bit in range(_CELLS):
            lit = 235 if number >> bit & 1 else 20
            image[-_CELL_HEIGHT:, bit * cell : (bit + 1) * cell] = lit
        return image

    def image_stamp_ns(self, number: int) -> int:
        """Return the stamp of an image by its number; the cameras are triggered together."""
        return self.start_ns + _IMAGE_DELAY_NS + number * IMAGE_PERIOD_NS


def arm_events(truth: ArmTruth, duration_s: float) -> Iterator[Event]:
    """Yield all messages of a recording, in the order of their log times."""
    end_ns = truth.start_ns + round(duration_s * 1e9)
    return merged(
        _joints(truth, STATES, STATE_PERIOD_NS, end_ns),
        _joints(truth, COMMANDS, COMMAND_PERIOD_NS, end_ns),
        _texts(truth, duration_s),
        *(_images(truth, camera, end_ns) for camera in CAMERAS),
    )


def _joints(truth: ArmTruth, topic: str, period_ns: int, end_ns: int) -> Iterator[Event]:
    for stamp_ns in range(truth.start_ns, end_ns + 1, period_ns):
        times_s = np.array([truth.seconds(stamp_ns)])
        values = truth.positions(times_s) if topic == STATES else truth.commands(times_s)
        make = partial(joint_state, stamp_ns, ELEMENTS, values[0])
        yield Event(stamp_ns + _LATENCY_NS, topic, _JOINT_STATE, make)


def joint_state(stamp_ns: int, names: tuple[str, ...], values: Floats, messages: Messages) -> Message:
    """Return `sensor_msgs/JointState` with positions only."""
    nothing = np.zeros(0)
    return messages.make(
        "sensor_msgs/JointState", messages.header(stamp_ns, ""), list(names), values, nothing, nothing
    )


def _texts(truth: ArmTruth, duration_s: float) -> Iterator[Event]:
    """Yield the task before each episode, and its begin and end."""
    for begin_s, end_s, task in truth.episodes(duration_s):
        for time_s, topic, text in (
            (begin_s - REST_S / 2, TASK, task),
            (begin_s, EPISODE, "start"),
            (end_s, EPISODE, "end"),
        ):
            log_time_ns = truth.start_ns + round(time_s * 1e9)
            yield Event(log_time_ns, topic, _TEXT, partial(said, text))


def said(text: str, messages: Messages) -> Message:
    """Return `std_msgs/String`."""
    return messages.make("std_msgs/String", text)


def _images(truth: ArmTruth, camera: str, end_ns: int) -> Iterator[Event]:
    number = 0
    while (stamp_ns := truth.image_stamp_ns(number)) <= end_ns:
        yield _image_event(truth, camera, number, stamp_ns)
        number += 1


def _image_event(truth: ArmTruth, camera: str, number: int, stamp_ns: int) -> Event:
    encoding = "jpeg" if camera == "workspace" else "rgb8"
    message = image_message(camera, encoding, stamp_ns, sensed(encoding, truth.image(camera, number)))
    return Event(stamp_ns + _IMAGE_LATENCY_NS, CAMERAS[camera], *message)


def _background(width: int, height: int, pose: Floats | None) -> NDArray[np.uint8]:
    """Return the table, which moves below the wrist."""
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    x, y = (0.0, 0.0) if pose is None else (60.0 * float(pose[0]), 60.0 * float(pose[1]))
    squares = (np.floor((columns + x) / 40) + np.floor((rows + y) / 40)) % 2
    image = np.empty((height, width, 3), np.uint8)
    for channel, (dark, light) in enumerate(((70, 95), (90, 115), (105, 135))):
        image[:, :, channel] = np.where(squares > 0, light, dark) + rows * 20 // height
    return image


def _draw_arm(image: NDArray[np.uint8], pose: Floats) -> None:
    """Draw the arm as seen from the side: joints 2, 4 and 6 bend it, the gripper's fingers show its width."""
    height, width = image.shape[:2]
    x, y, angle = width / 2, height * 0.85, -np.pi / 2
    length = height * 0.25
    points = [(x, y)]
    for joint in (1, 3, 5):
        angle += float(pose[joint]) * 0.7
        x, y = x + length * np.cos(angle), y + length * np.sin(angle)
        points.append((x, y))
    for (x0, y0), (x1, y1) in pairwise(points):
        cv2.line(image, (round(x0), round(y0)), (round(x1), round(y1)), (200, 200, 210), 7, cv2.LINE_8)
        cv2.circle(image, (round(x0), round(y0)), 6, (60, 120, 220), -1)
    half = 4 + 150 * float(pose[-1])
    for side in (-half, half):
        centre = (round(x + side * np.sin(angle)), round(y - side * np.cos(angle)))
        cv2.circle(image, centre, 4, (40, 40, 200), -1)


def _draw_gripper(image: NDArray[np.uint8], gripper_m: float) -> None:
    """Draw the two fingers as the wrist sees them."""
    height, width = image.shape[:2]
    half = width * (0.05 + 2.5 * gripper_m)
    for side in (-1, 1):
        x = round(width / 2 + side * half)
        cv2.rectangle(image, (x - 8, height // 2), (x + 8, height - 12), (60, 60, 70), -1)
