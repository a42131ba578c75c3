"""Recordings of a small arm, written by tests: joints, commands, and cameras whose images have their number painted in."""

import cv2
import numpy as np

from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.lerobot.format import LEROBOT
from bagassets.recipe import load_recipe
from bagassets.recipe.model_splits import Splits
from bagassets.store.store import Store
from bagassets_tests.painted_numbers import painted
from bagassets_tests.recorded_bags import NOON_NS, SECOND, Message, header, write_mcap
from bagassets_tests.sample_drives import build_recordings

RECIPE = """
name: arm
bags: {root: bags, settle_s: 0}
rigs:
  - name: arm
    channels:
      CAM_WRIST: {modality: camera, topic: /wrist, undistort: false}
    signals:
      joints: {topic: /joint_states, field: position, names: [elbow, wrist]}
      command: {topic: /command, field: position, names: [elbow, wrist]}
preview: {enabled: false}
lerobot:
  fps: 30
  features:
    observation.state: {signals: [joints], at: linear}
    action: {signals: [command]}
    observation.images.wrist: {camera: CAM_WRIST}
  task: Lift the cube.
"""


def joints_at(time_s):
    """Return the positions of both joints at a time of the recording."""
    return np.array([np.sin(time_s), 0.5 * np.cos(2.0 * time_s)])


def joint_state(log_time_ns, topic, names, positions):
    def make(store):
        kind = store.types["sensor_msgs/msg/JointState"]
        empty = np.zeros(0)
        return kind(header(store, log_time_ns, ""), list(names), np.asarray(positions, float), empty, empty)

    return Message(topic, "sensor_msgs/msg/JointState", log_time_ns, make)


def picture(log_time_ns, topic, image):
    def make(store):
        data = np.frombuffer(cv2.imencode(".png", image)[1].tobytes(), np.uint8)
        return store.types["sensor_msgs/msg/CompressedImage"](header(store, log_time_ns, "cam"), "png", data)

    return Message(topic, "sensor_msgs/msg/CompressedImage", log_time_ns, make)


def arm_messages(
    seconds=2.0, *, first=0, camera_hz=30, joint_hz=100, start_ns=NOON_NS, size=(64, 64), names=("elbow", "wrist"), skip=lambda topic, time_s: False,
    draw=painted,
):  # fmt: skip
    """Return the messages of a recording whose images show `first` and on; `skip` leaves some out."""
    messages = []
    for number in range(int(seconds * camera_hz)):
        stamp_ns = start_ns + number * SECOND // camera_hz
        messages.append(picture(stamp_ns, "/wrist", draw((first + number) % 65_536, size)))
    for number in range(int(seconds * joint_hz)):
        stamp_ns = start_ns + number * SECOND // joint_hz
        positions = joints_at(number / joint_hz)
        messages.append(joint_state(stamp_ns, "/joint_states", names, positions))
        messages.append(joint_state(stamp_ns, "/command", names, positions + 0.25))
    return sorted(
        (one for one in messages if not skip(one.topic, (one.log_time_ns - start_ns) / SECOND)),
        key=lambda one: one.log_time_ns,
    )


def write_arm(folder, name, messages=None, **options):
    """Write a recording into the project in `folder`."""
    (folder / "bags").mkdir(parents=True, exist_ok=True)
    return write_mcap(
        folder / "bags" / f"{name}.mcap", arm_messages(**options) if messages is None else messages
    )


def make_project(folder, recipe=RECIPE):
    """Write a recipe; return it as it is read."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recipe.yaml").write_text(recipe)
    return load_recipe(folder / "recipe.yaml")


def parts_of(recipe):
    """Build every recording of a recipe without Dagster; return the parts of its dataset, and the facts of each."""
    parts, facts = [], {}
    for key, made in build_recordings(recipe).items():
        artifact = made["lerobot_episodes"].artifact
        parts.append(Part(key, key, artifact.digest))
        facts[key] = artifact.read_json("facts.json")
    return parts, facts


def join(recipe, parts, *, suspects=None, splits=None):
    """Assemble the dataset; return the summary."""
    return assemble(
        LEROBOT,
        parts,
        recipe.lerobot,
        Store(recipe.store_path),
        recipe.lerobot.output,
        splits=splits or Splits(shares={"train": 1.0}),
        suspects=suspects,
    )
