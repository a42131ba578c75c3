"""Parts of a ROS 2 folder are read in order of time, whatever the order in which its metadata list them."""

import shutil

import pytest
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from bagassets.recordings.open import open_recording

STORE = get_typestore(Stores.ROS2_JAZZY)
VECTOR, START_NS, STEP_NS = "geometry_msgs/msg/Vector3", 1_700_000_000 * 10**9, 10**8
PARTS, EACH = 12, 5


def write(path, storage, order):
    """Write a folder whose parts are listed in this order; the last has no messages."""
    path.mkdir()
    suffix = {"SQLITE3": ".db3", "MCAP": ".mcap"}[storage]
    for part in range(PARTS + 1):
        with Writer(path / "part", version=9, storage_plugin=StoragePlugin[storage]) as writer:
            connection = writer.add_connection("/speed", VECTOR, typestore=STORE)
            for number in range(part * EACH, part * EACH + EACH if part < PARTS else 0):
                data = STORE.serialize_cdr(STORE.types[VECTOR](float(number), 0.0, 0.0), VECTOR)
                writer.write(connection, START_NS + number * STEP_NS, data)
        (path / "part" / f"part{suffix}").rename(path / f"drive_{part}{suffix}")
        metadata = yaml.safe_load((path / "part/metadata.yaml").read_text())
        shutil.rmtree(path / "part")
    described = metadata["rosbag2_bagfile_information"]
    described["relative_file_paths"] = [f"drive_{part}{suffix}" for part in order]
    described["topics_with_message_count"][0]["message_count"] = PARTS * EACH
    (path / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    return path


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
@pytest.mark.parametrize(
    "order",
    [[*range(PARTS + 1)], sorted(range(PARTS + 1), key=str), [*range(PARTS, -1, -1)]],
    ids=["as written", "by name", "backwards"],
)
def test_messages_are_in_order_of_time(tmp_path, storage, order):
    path = write(tmp_path / "drive", storage, order)
    with open_recording(path) as recording:
        times = [message.log_time_ns for message in recording.messages(["/speed"])]
        assert recording.rewind() is None
    assert times == [START_NS + number * STEP_NS for number in range(PARTS * EACH)]


def test_a_part_that_does_not_say_when_it_begins_stays_behind_the_one_before(tmp_path, monkeypatch):
    path = write(tmp_path / "drive", "MCAP", range(PARTS + 1))
    monkeypatch.setattr(
        "bagassets.recordings.mcap_file.McapFile.span_ns",
        lambda self: None if "_3" in self.path.name else self._index.span_ns,
    )
    with open_recording(path) as recording:
        times = [message.log_time_ns for message in recording.messages(["/speed"])]
    assert times == [START_NS + number * STEP_NS for number in range(PARTS * EACH)]
