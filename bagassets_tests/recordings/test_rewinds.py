"""Where log times go back as they were written: a simulation that was reset, a clock that was set back; and what is neither."""

import json

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer

from bagassets.recordings.open import open_recording
from bagassets.recordings.rewinds import Rewind, find_rewind
from bagassets_tests.damaged_files import write_bag
from bagassets_tests.damaged_files import write_mcap as write_small_chunks
from bagassets_tests.in_process import run_command
from bagassets_tests.recorded_bags import (
    NOON_NS,
    ROS1,
    SECOND,
    image,
    point,
    text,
    write_mcap,
    write_ros1,
    write_ros2,
)
from bagassets_tests.small_drive import LATENCY_NS, RECIPE, STORE2, messages, write_messages

PERIOD_NS = SECOND // 20


def run_of(begin_s, seconds=10.0, size=8):
    """Messages of one run, the first after `begin_s` of simulated time."""
    times_ns = [NOON_NS + int(begin_s * SECOND) + k * PERIOD_NS for k in range(int(seconds * 20))]
    return [one for at in times_ns for one in (point(at), image(at + 1000, size))]


def write_folder_of_mcap(path, some):
    return write_ros2(path, some, storage="MCAP")


WRITERS = {
    "ros1": (write_ros1, "a.bag"),
    "ros1 in many chunks": (lambda path, some: write_bag(path, "LZ4", some), "a.bag"),
    "db3": (write_ros2, "folder"),
    "folder with an MCAP": (write_folder_of_mcap, "folder"),
    "mcap": (write_mcap, "a.mcap"),
    "mcap in many chunks": (lambda path, some: write_small_chunks(path, 1, some), "a.mcap"),
}


@pytest.fixture(params=WRITERS.values(), ids=WRITERS)
def rewind_of(request, tmp_path):
    write, name = request.param

    def rewind(some):
        with open_recording(write(tmp_path / name, some)) as recording:
            return recording.rewind()

    return rewind


def near(found, from_s, to_s, times=1):
    """Tell whether a rewind is this one; the index of chunks and samples of a database tell it to a second."""
    apart_s = [
        (found.from_ns - NOON_NS) / SECOND - from_s,
        (found.to_ns - NOON_NS) / SECOND - to_s,
    ]
    return found.times == times and max(map(abs, apart_s)) < 1.0


def test_a_simulation_that_was_reset(rewind_of):
    found = rewind_of(run_of(0, size=8000) + run_of(0, 6, size=8000))
    assert near(found, 10, 0), found


def test_a_clock_that_was_set_back_by_a_few_seconds(rewind_of):
    found = rewind_of(run_of(0, size=8000) + run_of(7, size=8000))
    assert near(found, 10, 7), found


def test_each_reset_counts(rewind_of):
    found = rewind_of(run_of(0, size=8000) + run_of(0, 6, size=8000) + run_of(0, 8, size=8000))
    assert near(found, 10, 0, times=2), found


def test_time_that_goes_on_is_none(rewind_of):
    assert rewind_of(run_of(0) + run_of(10)) is None


def test_messages_that_are_late_by_less_than_a_second_are_none(rewind_of):
    some = run_of(0)
    shuffled = [one for begin in range(0, len(some), 20) for one in reversed(some[begin : begin + 20])]
    assert rewind_of(shuffled) is None


def test_pieces_of_a_drive_in_another_order_are_none(rewind_of):
    assert rewind_of(run_of(10, 5) + run_of(0, 5) + run_of(20, 5)) is None


def test_topics_that_were_written_one_after_the_other_are_none(rewind_of):
    some = run_of(0)
    assert rewind_of(some[::2] + some[1::2]) is None


def test_a_topic_that_another_program_has_added_to_is_none(rewind_of):
    again = [text(one.log_time_ns) for one in run_of(0, 3)]
    more = [text(one.log_time_ns + 5) for one in run_of(0, 3)]
    assert rewind_of(again + run_of(0) + more) is None


def test_a_message_with_a_wrong_time_is_none(rewind_of):
    some = run_of(0)
    some[150:150] = [point(NOON_NS + 100), image(NOON_NS + 100)]
    assert rewind_of(some) is None


def test_two_publishers_of_a_topic_are_none(tmp_path):
    with Rosbag1Writer(tmp_path / "a.bag") as writer:
        for caller in ("/first", "/second"):
            connection = writer.add_connection(
                "/point", "geometry_msgs/msg/PointStamped", typestore=ROS1, callerid=caller
            )
            for one in run_of(0)[::2]:
                writer.write(connection, one.log_time_ns, ROS1.serialize_ros1(one.make(ROS1), one.msgtype))
    with open_recording(tmp_path / "a.bag") as recording:
        assert recording.rewind() is None


def test_in_a_later_file_of_a_folder(tmp_path):
    folder = write_ros2(tmp_path / "folder", run_of(0))
    other = write_ros2(tmp_path / "other", run_of(0, 6))
    (folder / "folder_1.db3").write_bytes((other / "other.db3").read_bytes())
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- folder.db3", "- folder.db3\n  - folder_1.db3", 1))
    with open_recording(folder) as recording:
        assert near(recording.rewind(), 10, 0)


def test_a_clock_that_jitters_without_end():
    times_ns = np.random.default_rng(1).integers(0, 10**12, 20_000)
    assert isinstance(find_rewind({"/a": times_ns}), Rewind)


def test_a_build_warns_and_says_what_to_do(tmp_path):
    drives = [messages(STORE2, seconds) for seconds in (4.0, 3.0)]
    written = [(*one[:3], one[2] + LATENCY_NS, one[3]) for drive in drives for one in drive]
    write_messages(tmp_path / "a.mcap", "mcap", STORE2, written)
    (tmp_path / "recipe.yaml").write_text(RECIPE.format(name="reset", root="."))
    done = run_command("build", "--recipe", tmp_path / "recipe.yaml")
    assert "Log times go back once from 2023-11-14T22:13:24" in done.stdout + done.stderr
    shown = json.loads(run_command("inspect", "--json", tmp_path / "a.mcap").stdout)
    assert any("record each run by itself" in note for note in shown["notes"])
