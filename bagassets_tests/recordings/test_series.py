"""Which files are the parts of one drive: the rule, case by case, and what discovery makes of it."""

import json
import os
import resource
import shutil
from contextlib import ExitStack
from types import SimpleNamespace

import pytest
from mcap.writer import CompressionType, Writer
from pydantic import TypeAdapter

from bagassets.assets.boxes.files.find import expand, find_labels
from bagassets.assets.inventory import make_inventory
from bagassets.assets.selection import choose_rig
from bagassets.base.errors import RecordingError
from bagassets.cli.main import main
from bagassets.engine.choose import choose_recordings
from bagassets.engine.splits import Ties, deal
from bagassets.recipe.model import Bags, Limits
from bagassets.recipe.model_annotations import AnnotationFiles
from bagassets.recipe.model_splits import Splits
from bagassets.recordings import join_parts
from bagassets.recordings import part_facts as seeing
from bagassets.recordings.digest import recording_digest
from bagassets.recordings.discover import bags_of_parts, discover, series_with
from bagassets.recordings.open import open_recording
from bagassets.recordings.part_facts import part_facts
from bagassets.recordings.salvage.open import open_salvaged
from bagassets.recordings.series import Part, PartFacts, candidates, judge
from bagassets.recordings.topic import ForeignBytes, RefusedBytes
from bagassets.sample.recorder import open_recorder
from bagassets.store.canonical import digest_bytes, digest_json
from bagassets_tests.file_clock import next_tick
from bagassets_tests.killed_recorder import leave_journal, leave_log
from bagassets_tests.pose_data import Written
from bagassets_tests.series import write_part, write_parts
from bagassets_tests.small_drive import START_NS, write_drive

pytestmark = pytest.mark.once

TOPICS = {"/odom": "nav_msgs/msg/Odometry", "/tf_static": "tf2_msgs/msg/TFMessage"}
OTHER = {**TOPICS, "/imu": "sensor_msgs/msg/Imu"}
LATER = {"/odom": "nav_msgs/msg/Odometry"}


def part(number, begin_s, end_s, topics=TOPICS, latched=("/tf_static",), period_s=0.1):
    facts = PartFacts(topics, latched, round(begin_s * 1e9), round(end_s * 1e9), round(period_s * 1e9))
    return Part(f"d_{number}.bag", number, facts)


def broken(number, why="it has no index"):
    return Part(f"d_{number}.bag", number, why)


HOUR_S = 3600.0
CASES = {
    "follow each other": ([part(0, 0, 10), part(1, 10.02, 20), part(2, 20.02, 30)], "one", ""),
    "a pause of 1 s": ([part(0, 0, 10), part(1, 11, 20)], "one", ""),
    "a pause of 2 s": ([part(0, 0, 10), part(1, 12, 20)], "one", ""),
    "a pause of 10 s": ([part(0, 0, 10), part(1, 20, 30)], "asked", "d_1.bag begins 10.0 s after d_0.bag ends"),
    "slow topics": ([part(0, 0, 10, period_s=4), part(1, 20, 30)], "one", ""),
    "overlap by 0.5 s": ([part(0, 0, 10), part(1, 9.5, 20)], "one", ""),
    "overlap by 5 s": ([part(0, 0, 10), part(1, 5, 20)], "asked", "d_1.bag begins 5.0 s before d_0.bag ends"),
    "the same second": ([part(0, 0, 0.9), part(1, 0, 0.9)], "asked", "d_1.bag begins 0.9 s before d_0.bag ends"),
    "an hour apart": ([part(n, n * HOUR_S, n * HOUR_S + 20) for n in range(1, 7)], "apart", ""),
    "wrong order": ([part(0, 20, 30), part(1, 10, 20), part(2, 0, 10)], "asked", "d_1.bag begins 20.0 s before d_0.bag ends"),
    "wrong order, an hour apart": ([part(0, HOUR_S, HOUR_S + 10), part(1, 0, 10)], "apart", ""),
    "a topic begins in part 2": ([part(0, 0, 10), part(1, 10, 20, OTHER)], "asked", "d_0.bag and d_1.bag differ in topic /imu"),
    "another type": ([part(0, 0, 10), part(1, 10, 20, {**TOPICS, "/odom": "x/msg/Y"})], "asked", "d_0.bag and d_1.bag differ in topic /odom"),
    "other topics, an hour apart": ([part(0, 0, 10), part(1, HOUR_S, HOUR_S + 10, OTHER)], "apart", ""),
    "latched in the first part only": ([part(0, 0, 10), part(1, 10, 20, LATER, ())], "one", ""),
    "numbers from 3": ([part(3, 0, 10), part(4, 10, 20)], "one", ""),
    "a part is missing": ([part(0, 0, 10), part(1, 10, 20), part(3, 30, 40)], "asked", "number 2 is missing"),
    "a number is there twice": ([part(0, 0, 10), part(1, 10, 20), part(1, 10, 20)], "asked", "number 1 is there twice"),
    "a number is there twice, an hour apart": ([part(1, 0, 10), part(1, HOUR_S, HOUR_S + 10)], "apart", ""),
    "a short part is missing": ([part(0, 0, 10), part(2, 11, 20)], "asked", "number 1 is missing"),
    "the last is in the making": ([part(0, 0, 10), part(1, 10, 20), broken(2)], "one", ""),
    "the last of two is in the making": ([part(0, 0, 10), broken(1)], "apart", ""),
    "one in the middle is damaged": ([part(0, 0, 10), broken(1), part(2, 11, 20)], "asked", "d_1.bag cannot be read (it has no index)"),
    "the first is damaged": ([broken(0), part(1, 10, 20), part(2, 20, 30)], "asked", "d_0.bag cannot be read (it has no index)"),
    "all are damaged": ([broken(0), broken(1)], "apart", ""),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_rule(case):
    parts, kind, why = CASES[case]
    verdict = judge(parts)
    assert ("one" if verdict.parts else "asked" if verdict.why else "apart", verdict.why) == (kind, why)
    if kind == "one":
        assert verdict.parts == tuple(one.name for one in parts if isinstance(one.facts, PartFacts))
    if kind == "asked":
        readable = [one.name for one in parts if isinstance(one.facts, PartFacts)]
        assert [name for group in verdict.near for name in group] == readable


def test_of_two_drives_in_one_row_of_numbers_each_stays_in_one_split():
    verdict = judge(
        [part(0, 0, 10), part(1, 10, 20), part(2, HOUR_S, HOUR_S + 9), part(3, HOUR_S + 9, HOUR_S + 18)]
    )
    assert verdict.why
    assert verdict.near == (("d_0.bag", "d_1.bag"), ("d_2.bag", "d_3.bag"))


def test_files_around_another_drive_stay_in_one_split():
    """A part that was replaced by another drive: those before and after it are near, though their numbers are not."""
    verdict = judge([part(0, 0, 10), part(1, HOUR_S, HOUR_S + 9), part(2, 20, 30)])
    assert verdict.why == "d_1.bag begins 3590.0 s after d_0.bag ends"
    assert verdict.near == (("d_0.bag", "d_2.bag"),)
    assert judge([part(0, 0, 100), part(1, 5, 6), part(2, 140, 150)]).near == (
        ("d_0.bag", "d_1.bag", "d_2.bag"),
    )


DATED = [f"car_2024-01-0{day}-10-0{minute}-00_{minute}.bag" for day in (1, 2) for minute in (0, 1, 2)]


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["a_0.bag", "a_1.bag", "a_2.bag"], {"a.bag": [0, 1, 2]}),
        (["a_9.bag", "a_10.bag", "a_8.bag"], {"a.bag": [8, 9, 10]}),
        (["a_0.bag", "a_1.mcap"], {}),
        (["x/a_0.bag", "y/a_1.bag"], {}),
        (["x/a_0.db3", "x/a_1.db3", "a_0.db3"], {"x/a.db3": [0, 1]}),
        (["a_0.bag", "b_1.bag", "a0.bag", "a1.bag", "a-0.bag"], {}),
        (["a_0.bag", "a_1.bag.active"], {}),
        (["a_0_1.bag", "a_0_2.bag"], {"a_0.bag": [1, 2]}),
        (["a_1.bag", "a_01.bag", "a_2.bag"], {"a.bag": [1, 1, 2]}),
        (["r_10_05.mcap", "r_10_25.mcap", "r_10_45.mcap"], {}),
        (DATED, {"car_2024-01-01-10-00-00.bag": [0, 1, 2], "car_2024-01-02-10-00-00.bag": [0, 1, 2]}),
        ([name.removeprefix("car_") for name in DATED[:3]], {"2024-01-01-10-00-00.bag": [0, 1, 2]}),
    ],
)  # fmt: skip
def test_names_that_fit(names, found):
    assert {one.whole: list(one.numbers.values()) for one in candidates(names)} == found


# --- files -------------------------------------------------------------------------------

SUFFIXES = (".bag", ".mcap", ".db3")
CUTS_S = (0.7, 1.33)


def bags(folder, **options):
    return Bags(root=folder, **options)


@pytest.fixture(scope="module", params=SUFFIXES)
def drives(request, tmp_path_factory):
    """A drive in one file and in three, with their folders."""
    folder = tmp_path_factory.mktemp("drives")
    whole = write_part(folder / "whole" / f"drive{request.param}", duration_s=2.0)
    parts = write_parts(folder / "cut" / f"drive{request.param}", CUTS_S, 2.0)
    return whole, parts


def test_topics_and_times_are_those_that_a_reader_finds(drives):
    whole, parts = drives
    for path in (whole, *parts):
        facts = part_facts(path)
        with open_recording(path) as opened:
            times = [message.log_time_ns for message in opened.messages(list(opened.topics))]
            types = {name: topic.msgtype for name, topic in opened.topics.items()}
        assert facts.topics == types
        assert (facts.start_ns, facts.end_ns) == (times[0], times[-1])
        assert facts.latched == sorted({"/tf_static"} & types.keys())


def content(recording):
    with open_recording(recording) as opened:
        return [
            (message.topic, message.msgtype, message.log_time_ns, bytes(message.data))
            for message in opened.messages(list(opened.topics))
        ], {name: (topic.count, topic.msgtype, topic.definition) for name, topic in opened.topics.items()}


def test_a_cut_drive_is_one_recording_with_key_and_messages_of_the_whole(drives):
    whole, parts = drives
    (one,) = discover(bags(whole.parent)).recordings.values()
    (cut,) = discover(bags(parts[0].parent)).recordings.values()
    assert (cut.key, cut.relative, cut.format) == (one.key, one.relative, one.format)
    assert cut.files == tuple(parts)
    assert cut.size == sum(path.stat().st_size for path in parts)
    assert content(cut) == content(one)


def test_its_parts_are_opened_as_it_is(drives):
    """With its limits, and telling how far reading has come, of whole parts and of damaged ones."""
    _, parts = drives
    [one] = discover(bags(parts[0].parent)).recordings.values()
    for opener in (open_recording, open_salvaged):
        read = set()
        limits = Limits.model_construct(message_bytes=1)
        with opener(one, limits=limits, on_read=lambda path, *_, read=read: read.add(path)) as opened:
            assert opened.format == one.format
            assert all(isinstance(message.data, RefusedBytes) for message in opened.messages(opened.topics))
        assert read == set(parts)


def test_its_digest_is_one_of_its_parts_in_order(drives):
    _, parts = drives
    (cut,) = discover(bags(parts[0].parent)).recordings.values()
    digests = [digest_bytes(path.read_bytes()) for path in parts]
    assert recording_digest(cut).digest == digest_json(["series", *digests])


def test_parts_that_overlap_are_merged_by_time(tmp_path):
    late = {"/points"}  # a topic whose messages another thread hands over half a second later

    def first(topic, stamp_ns):
        return stamp_ns < START_NS + (1.5e9 if topic in late else 1e9)

    write_part(tmp_path / "cut" / "drive_0.bag", duration_s=2.0, keep=first)
    write_part(tmp_path / "cut" / "drive_1.bag", duration_s=2.0, keep=lambda *of: not first(*of))
    whole = write_part(tmp_path / "drive.bag", duration_s=2.0)
    (cut,) = discover(bags(tmp_path / "cut")).recordings.values()
    assert cut.key == "drive.bag"
    assert content(cut)[0] == content(whole)[0]


def write_strings(path, messages, *, qos=""):
    """Write an MCAP of (topic, log time, text)."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start("ros2", "test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channels = {}
        for topic, time_ns, text in messages:
            if topic not in channels:
                metadata = {"offered_qos_profiles": qos if topic == "/latched" else ""}
                channels[topic] = writer.register_channel(topic, "cdr", schema, metadata)
            data = b"\0\1\0\0" + (len(text) + 1).to_bytes(4, "little") + text.encode() + b"\0"
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()


def test_a_thousand_parts_are_one_recording_of_which_few_files_are_open(tmp_path):
    for number in range(1000):
        times_ns = [(number * 3 + i) * 100_000_000 for i in range(3)]
        write_strings(tmp_path / f"drive_{number}.mcap", [("/a", time_ns, "text") for time_ns in times_ns])
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (100, before[1]))
    try:
        (cut,) = discover(bags(tmp_path)).recordings.values()
        with open_recording(cut) as opened:
            times_ns = [message.log_time_ns for message in opened.messages(["/a"])]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
    assert times_ns == [i * 100_000_000 for i in range(3_000)]


TRANSIENT_LOCAL = ("- history: 3\n  durability: 1\n", "- history: keep_last\n  durability: transient_local\n")


@pytest.mark.parametrize("qos", TRANSIENT_LOCAL)
def test_latched_messages_that_recorders_repeat_at_splits_count_once(tmp_path, qos):
    def usual(second):
        return [("/a", second * 10**9 + i * 10**8, f"{second}") for i in range(1, 10)]

    first = [("/latched", 5, "map"), ("/latched", 6, "robot"), *usual(0)]
    # With stamps of the split; a new one, and the same again but later, are no repetitions.
    second = [("/latched", 10**9, "map"), ("/latched", 10**9 + 1, "robot"), ("/latched", 10**9 + 2, "new")]
    third = [("/latched", 2 * 10**9, "new"), *usual(2), *usual(3), ("/latched", 4 * 10**9, "map")]
    for number, messages in enumerate((first, [*second, *usual(1)], third)):
        write_strings(tmp_path / f"drive_{number}.mcap", messages, qos=qos)
    (cut,) = discover(bags(tmp_path)).recordings.values()
    with open_recording(cut) as opened:
        for _ in range(2):
            found = [(m.log_time_ns, bytes(m.data)[8:-1]) for m in opened.messages(["/latched"])]
            assert found == [(5, b"map"), (6, b"robot"), (10**9 + 2, b"new"), (4 * 10**9, b"map")]
            assert opened.repeated == {"/latched": 3}
    with open_recording(cut) as opened:
        made = Written(tmp_path / "out", lambda out: make_inventory(opened, out, size=1))
    inventory = made.artifact.read_json("inventory.json")
    assert {topic["name"]: topic["count"] for topic in inventory["topics"]} == {"/a": 36, "/latched": 4}
    assert inventory["notes"] == [
        "/latched: 3 messages that the recorder repeated in later parts count once."
    ]


def test_the_note_about_one_repeated_message_is_in_the_singular(tmp_path):
    for number in range(2):
        usual = [("/a", number * 10**9 + i * 10**8, "") for i in range(1, 10)]
        messages = [("/latched", number * 10**9, "map"), *usual]
        write_strings(tmp_path / f"drive_{number}.mcap", messages, qos=TRANSIENT_LOCAL[0])
    (cut,) = discover(bags(tmp_path)).recordings.values()
    with open_recording(cut) as opened:
        made = Written(tmp_path / "out", lambda out: make_inventory(opened, out, size=1))
    assert made.artifact.read_json("inventory.json")["notes"] == [
        "/latched: 1 message that the recorder repeated in later parts counts once."
    ]


def test_the_same_text_at_the_beginning_of_a_part_counts_if_its_topic_is_not_latched(tmp_path):
    for number in range(2):
        messages = [
            (topic, number * 10**9 + i * 10**8, "same") for i in range(9) for topic in ("/a", "/latched")
        ]
        write_strings(tmp_path / f"drive_{number}.mcap", messages)
    (cut,) = discover(bags(tmp_path)).recordings.values()
    with open_recording(cut) as opened:
        assert len(list(opened.messages(["/latched"]))) == 18
        assert not opened.repeated


def test_an_order_that_was_given_wrong_does_not_matter_to_readers(drives):
    whole, parts = drives
    names = tuple(path.name for path in reversed(parts))
    (cut,) = discover(bags(parts[0].parent, series={"drive": names})).recordings.values()
    assert content(cut) == content(whole)


def test_messages_of_another_type_than_most_are_lost_as_they_are_in_one_file(tmp_path):
    for number, (msgtype, messages) in enumerate((("std_msgs/msg/String", 3), ("std_msgs/msg/Bool", 1))):
        with ExitStack() as stack:
            recorder = open_recorder(tmp_path / f"drive_{number}.mcap", "mcap", "none", stack)
            for i in range(messages):
                recorder.write_raw("/a", msgtype, number * 10**9 + i * 10**8, b"\0\1\0\0\x01\0\0\0\0")
    (cut,) = discover(bags(tmp_path, series={"drive": True})).recordings.values()
    with open_recording(cut) as opened:
        found = list(opened.messages(["/a"]))
    assert {message.msgtype for message in found} == {"std_msgs/msg/String"}
    assert [isinstance(message.data, ForeignBytes) for message in found] == [False, False, False, True]


# --- discovery ---------------------------------------------------------------------------


@pytest.fixture
def cut(tmp_path):
    """A folder with a drive in three parts."""
    write_parts(tmp_path / "drive.bag", CUTS_S, 2.0)
    return tmp_path


def keys(folder, **options):
    return list(discover(bags(folder, **options)).recordings)


def test_a_number_that_is_missing_is_asked_about_and_keeps_what_is_there_in_one_split(cut):
    (cut / "drive_1.bag").unlink()
    discovery = discover(bags(cut))
    assert list(discovery.recordings) == ["drive_0.bag", "drive_2.bag"]
    (question,) = discovery.asked.values()
    assert question == (
        "drive_0.bag and drive_2.bag: parts of one drive, or drives of their own? number 1 is missing. Say `drive.bag: true` "
        "(one) or `false` in bags.series; until then they are apart, in one split."
    )
    assert discovery.near == {"drive_0.bag": "drive.bag", "drive_2.bag": "drive.bag"}


def test_the_drive_of_a_file_is_told_where_its_other_parts_lie_beside_it(cut):
    assert series_with(cut / "drive_1.bag") == "drive.bag"
    shutil.copy(cut / "drive_0.bag", cut / "other_0.bag")
    shutil.copy(cut / "drive_0.bag", cut / "other_1.bag")  # no drive: it begins when the other does
    assert {series_with(cut / name) for name in ("other_0.bag", "other_1.bag")} == {""}
    (cut / "drive_1.bag").unlink()
    assert series_with(cut / "drive_0.bag") == "", "not sure"


@pytest.mark.parametrize("name", ["drive", "drive.bag"])
def test_the_answers(cut, name):
    (cut / "drive_1.bag").unlink()
    assert keys(cut, series={name: True}) == ["drive.bag"]
    apart = discover(bags(cut, series={name: False}))
    assert list(apart.recordings) == ["drive_0.bag", "drive_2.bag"]
    assert not apart.asked
    assert not apart.near
    assert keys(cut, series={name: ("drive_0.bag", "drive_2.bag")}) == ["drive.bag"]


def test_an_answer_about_files_that_are_not_there_is_named(cut):
    discovery = discover(bags(cut, series={"drvie": True, "drive": True, "gone": False}))
    assert list(discovery.recordings) == ["drive.bag"]
    assert dict(discovery.excluded) == {
        "drvie": "bags.series says that it is one drive, but there are not two numbered files of it; correct its name there"
    }


def test_a_part_named_twice_counts_once(cut):
    names = ("drive_0.bag", "drive_0.bag", "drive_1.bag", "drive_2.bag")
    (one,) = discover(bags(cut, series={"drive": names})).recordings.values()
    assert len(one.parts) == 3


def write_numbered(folder, *names):
    """Write files of a second each, one after the other, with number and name where they have none."""
    folder.mkdir(exist_ok=True)
    for number, name in enumerate(names):
        messages = [("/a", number * 10**9 + i * 10**8, f"{number}") for i in range(10)]
        write_strings(folder / f"{name}.mcap", messages)
    return folder


@pytest.mark.parametrize("name", ["d", "d.mcap"])
def test_files_that_a_list_does_not_name_do_not_take_its_place(tmp_path, name):
    write_numbered(tmp_path, *(f"d_{number}" for number in range(5)))
    discovery = discover(bags(tmp_path, series={name: ("d_0.mcap", "d_1.mcap")}))
    assert list(discovery.recordings) == ["d.mcap", "d_2.mcap", "d_3.mcap", "d_4.mcap"]
    assert discovery.former_keys == {"d.mcap": ("d_0.mcap", "d_1.mcap")}
    assert dict(discovery.asked) == {
        "d.mcap": "d_2.mcap to d_4.mcap (3 files): parts of one drive, or drives of their own? the list of d.mcap is "
        "without them. List them with d.mcap or as another drive in bags.series; until then they are apart, in one split."
    }
    assert discovery.near.keys() == discovery.recordings.keys()


def test_files_beside_a_list_that_lacks_one_do_not_take_its_place(tmp_path):
    write_numbered(tmp_path, *(f"d_{number}" for number in range(4)))
    discovery = discover(bags(tmp_path, series={"d": ("d_0.mcap", "d_1.mcap", "gone.mcap")}))
    assert list(discovery.recordings) == ["d_2.mcap", "d_3.mcap"]
    assert discovery.removed(["d.mcap"]) == ()
    assert "gone.mcap" in dict(discovery.excluded)["d.mcap"]


def test_a_list_may_name_the_file_of_its_own_name(tmp_path):
    write_numbered(tmp_path, "d", "d_0", "d_1", "d_2")
    discovery = discover(bags(tmp_path, series={"d.mcap": ("d.mcap", "d_0.mcap")}))
    assert list(discovery.recordings) == ["d.mcap", "d_1.mcap", "d_2.mcap"]
    assert discovery.former_keys == {"d.mcap": ("d.mcap", "d_0.mcap")}


@pytest.mark.parametrize("answer", [True, ("d_0.mcap", "d_1.mcap")])
def test_a_file_whose_name_a_drive_takes_is_named(tmp_path, answer):
    write_numbered(tmp_path, "d", "d_0", "d_1")
    discovery = discover(bags(tmp_path, series={"d": answer}))
    assert discovery.former_keys == {"d.mcap": ("d_0.mcap", "d_1.mcap")}
    assert dict(discovery.excluded) == {
        "d.mcap": "bags.series has a drive of this name, of which this file is no part; rename the file or the drive, or list the file "
        "there as a part"
    }


def test_two_files_of_one_number_are_asked_about(tmp_path):
    write_numbered(tmp_path, "d_0", "d_1", "d_2")
    shutil.copy(tmp_path / "d_1.mcap", tmp_path / "d_01.mcap")
    discovery = discover(bags(tmp_path))
    assert len(discovery.recordings) == 4
    assert discovery.near.keys() == discovery.recordings.keys()
    (question,) = discovery.asked.values()
    assert "number 1 is there twice. Say `d.mcap: true`" in question


def test_a_drive_that_is_one_because_the_recipe_says_so_is_told_what_its_numbers_lack(tmp_path):
    write_numbered(tmp_path, "d_0", "d_1", "d_3")
    discovery = discover(bags(tmp_path, series={"d": True}))
    assert list(discovery.recordings) == ["d.mcap"]
    assert dict(discovery.asked) == {
        "d.mcap": "d_0.mcap to d_3.mcap (3 files): one drive, as bags.series says, but number 2 is missing; correct that, or list the files "
        "there if they are all."
    }
    names = ("d_0.mcap", "d_1.mcap", "d_3.mcap")
    assert not discover(bags(tmp_path, series={"d": names})).asked


@pytest.mark.parametrize("command", ["inspect", "digest", "convert"])
def test_the_path_of_a_whole_drive_leads_to_its_parts(tmp_path, capsys, command):
    write_numbered(tmp_path, "d_0", "d_1", "e_0")
    out = [str(tmp_path / "out")] if command == "convert" else []
    for name, more in (
        ("d", ", but a drive in 2 files: d_0.mcap, d_1.mcap; name these"),
        ("e", ""),
        ("no/d", ""),
    ):
        path = tmp_path / f"{name}.mcap"
        assert main([command, str(path), *out]) == 1
        assert f"{path}: no such file or folder{more}.\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("names", "odd"), [("013", "number 2 is missing"), (("1", "01"), "number 1 is there twice"), ("12", "")]
)
def test_convert_says_which_part_is_missing(tmp_path, capsys, names, odd):
    write_numbered(tmp_path, *(f"d_{name}" for name in names))
    assert main(["convert", *map(str, sorted(tmp_path.iterdir())), str(tmp_path / "out")]) == 1
    errors = capsys.readouterr().err
    assert ("warning: " in errors) == bool(odd)
    assert f"warning: {tmp_path / 'd.mcap'}: {odd}; the drive is converted as it is.\n" in errors or not odd


def test_inspect_shows_a_drive_in_parts_as_the_drive_in_one_file(cut, tmp_path, capsys, monkeypatch):
    whole = tmp_path / "whole" / "drive.bag"
    write_drive(whole, "ros1", 2.0)
    monkeypatch.chdir(cut)
    shown = {}
    for name, files in {
        "whole": [str(whole)],
        "parts": [f"drive_{number}.bag" for number in range(3)],
    }.items():
        assert main(["inspect", "--json", *files]) == 0
        shown[name] = json.loads(capsys.readouterr().out)
    for key in ("start_ns", "end_ns", "duration_s", "daylight", "gnss", "notes"):
        assert shown["parts"][key] == shown["whole"][key]
    counts = {name: {one["name"]: one["count"] for one in made["topics"]} for name, made in shown.items()}
    assert counts["parts"] == counts["whole"]
    assert main(["inspect", "drive_0.bag", str(whole)]) == 1, "drive_0.bag is in it"
    assert "inspect them one by one" in capsys.readouterr().err


def test_a_rig_may_match_a_part():
    rigs = [
        SimpleNamespace(match=("x*",)),
        SimpleNamespace(match=("drive_0*",)),
        SimpleNamespace(match=("**",)),
    ]
    recipe = SimpleNamespace(rigs=rigs)
    assert choose_rig(recipe, "drive.bag", "drive_0.bag", "drive_1.bag") is rigs[1]
    assert choose_rig(recipe, "drive.bag") is rigs[2]


def test_a_series_over_folders(cut):
    (cut / "one").mkdir()
    (cut / "two").mkdir()
    for number, folder in enumerate(("one", "two", "two")):
        (cut / f"drive_{number}.bag").rename(
            cut / folder / f"part_{number // 2}{'' if number < 2 else 'b'}.bag"
        )
    parts = ("one/part_0.bag", "two/part_0.bag", "two/part_1b.bag")
    assert len(keys(cut)) == 3
    (one,) = discover(bags(cut, series={"day/drive": parts})).recordings.values()
    assert (one.key, one.names) == ("day__drive.bag", ("day/drive.bag", *parts))
    made = recording_digest(one)
    assert list(made.files) == ["../one/part_0.bag", "../two/part_0.bag", "../two/part_1b.bag"]
    assert bags_of_parts([cut / part for part in parts]).series == {parts[0]: parts}


def test_a_part_that_is_named_and_missing_leaves_the_others_out_and_keeps_the_partition(cut):
    discovery = discover(bags(cut, series={"drive": ("drive_0.bag", "gone.bag", "drive_2.bag")}))
    assert list(discovery.recordings) == ["drive_1.bag"]
    left_out = dict(discovery.excluded)
    assert (
        left_out["drive.bag"]
        == "gone.bag of bags.series cannot be found; copy it there, or correct bags.series"
    )
    assert left_out["drive_0.bag"] == "part of drive.bag, of which gone.bag of bags.series cannot be found"
    assert discovery.removed(["drive.bag", "drive_0.bag"]) == ("drive_0.bag",)


def test_while_a_part_is_being_replaced_the_drive_does_not_fall_apart(cut):
    part = cut / "drive_1.bag"
    for path in cut.iterdir():
        os.utime(path, (1e9, 1e9))
    part.write_bytes(part.read_bytes()[:5000])
    discovery = discover(bags(cut))
    assert not discovery.recordings
    assert not discovery.asked
    assert discovery.removed(["drive.bag"]) == ()
    left_out = dict(discovery.excluded)
    for_now = "drive_1.bag cannot be read for now (its index is damaged)"
    assert left_out["drive.bag"] == f"{for_now}; look again later"
    assert left_out["drive_0.bag"] == f"part of drive.bag, of which {for_now}"
    assert list(discover(bags(cut, settle_s=0)).asked) == ["drive.bag"]
    os.utime(part, (1e9 + 1, 1e9 + 1))
    discovery = discover(bags(cut))
    assert "drive_1.bag cannot be read" in discovery.asked["drive.bag"]
    assert discovery.removed(["drive.bag"]) == ("drive.bag",)


def test_a_whole_drive_beside_its_parts_is_asked_about(cut):
    write_part(cut / "drive.bag", duration_s=2.0)
    discovery = discover(bags(cut))
    assert len(discovery.recordings) == 4
    assert "drive.bag lies beside them" in discovery.asked["drive.bag"]
    assert set(discovery.near.values()) == {"drive.bag"}
    assert len(discovery.near) == 4


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"include": ("drive_*.bag",)}, ["drive.bag"]),
        ({"include": ("drive.bag",)}, ["drive.bag"]),
        ({"exclude": ("drive.bag",)}, []),
        ({"exclude": ("drive_[012].bag",)}, []),
        ({"exclude": ("drive_2.bag",)}, ["drive.bag"]),
        ({"include": ("drive_1.bag",)}, ["drive_1.bag"]),
    ],
)
def test_globs_may_be_about_parts_or_the_whole(cut, options, found):
    assert keys(cut, **options) == found


def test_what_was_seen_of_parts_is_remembered_by_process_and_project(cut, tmp_path, monkeypatch):
    state = tmp_path / ".state"
    state.mkdir()
    looked = []
    monkeypatch.setattr(seeing, "part_facts", lambda path: looked.append(path.name) or part_facts(path))
    of_project = bags(cut).with_state(state)
    assert list(discover(of_project).recordings) == ["drive.bag"]
    assert len(looked) == 3
    discover(of_project)
    monkeypatch.setattr(join_parts, "_judged", {})  # as in another process
    assert list(discover(of_project).recordings) == ["drive.bag"]
    assert len(looked) == 3
    next_tick()
    os.utime(cut / "drive_1.bag")
    assert list(discover(of_project).recordings) == ["drive.bag"]
    assert looked[3:] == ["drive_1.bag"]


def test_files_whose_names_fit_no_series_are_not_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(seeing, "part_facts", lambda path: pytest.fail(f"{path} was opened"))
    for name in ("a_0.bag", "b_1.bag", "c.bag", "x_0.mcap"):
        (tmp_path / name).write_bytes(b"")
    assert len(keys(tmp_path)) == 4


# --- splits ------------------------------------------------------------------------------


def splits(**options):
    return Splits.model_validate_json(json.dumps(options))


KEYS = [f"r{number}" for number in range(40)]


def test_what_is_near_lies_in_one_split_and_nothing_else_moves():
    alone = deal(KEYS, splits())
    near = Ties(near={"r1": "x", "r2": "x", "r7": "y", "r8": "y"})
    dealt = deal(KEYS, splits(), near)
    assert dealt["r1"] == dealt["r2"]
    assert dealt["r7"] == dealt["r8"]
    assert deal(KEYS, splits(), Ties()) == alone
    assert sum(dealt[key] != alone[key] for key in KEYS) <= 4


def test_pins_of_parts_hold_for_their_series_and_for_what_is_near():
    ties = Ties(near={"r1": "x", "r2": "x"}, former={"r5": ("p0", "p1")})
    for split in ("train", "val"):
        dealt = deal(KEYS, splits(pinned={"r2": split, "p1": split}), ties)
        assert (dealt["r1"], dealt["r2"], dealt["r5"]) == (split, split, split)
    assert deal(KEYS, splits(pinned={"r1": "train", "r2": "val"}), ties)["r1"] == "train"


def test_pins_of_parts_that_contradict_each_other_are_told():
    ties = Ties(former={"r5": ("p0", "p1", "p2")})
    given = splits(pinned={"p0": "train", "p2": "val"})
    assert ties.disputed(given) == {
        "r5": "r5: splits.pinned gives its parts to several splits (p0 to train, p2 to val), but they are one recording now. "
        "Pin r5; until then it is in train."
    }
    for pinned in ({"p0": "val", "p1": "val"}, {"p0": "val", "p2": "train", "r5": "val"}, {"other": "val"}):
        assert not ties.disputed(splits(pinned=pinned))


# --- what names a part ---------------------------------------------------------------------


def label_sources(*entries):
    kinds = TypeAdapter(list[AnnotationFiles])
    return kinds.validate_json(json.dumps(entries), strict=True)


def test_label_files_named_after_parts_are_those_of_the_drive_unless_it_has_its_own(cut):
    (recording,) = discover(bags(cut)).recordings.values()
    (entry,) = label_sources({"format": "boxes", "path": "{stem}.json"})
    for number in (0, 2):
        (cut / f"drive_{number}.json").write_text(f"[{number}]")
    found = find_labels([entry], recording)["{stem}.json"]
    assert [(one.part, [file.path.name for file in one.files]) for one in found.parts] == [
        ("drive_0.bag", ["drive_0.json"]),
        ("drive_1.bag", []),
        ("drive_2.bag", ["drive_2.json"]),
    ]
    assert list(found.inputs) == ["labels:{stem}.json/drive_0.bag", "labels:{stem}.json/drive_2.bag"]
    assert expand("{stem} {name} {key}", recording) == "drive drive.bag drive.bag"
    (cut / "drive.json").write_text("[]")
    (file,) = find_labels([entry], recording)["{stem}.json"].files
    assert (file.name, file.path.name) == ("{stem}.json", "drive.json")


def test_frames_of_parts_count_on_in_order_of_time(cut):
    """However the recipe lists the parts; as files of 7, 7 and 5 clouds, of which the middle one has no labels."""
    names = ("drive_2.bag", "drive_0.bag", "drive_1.bag")
    (recording,) = discover(bags(cut, series={"drive": names})).recordings.values()
    times = {"by": "topic", "topic": "/points"}
    (entry,) = label_sources(
        {"format": "kitti_labels", "path": "{stem}.txt", "frame": "lidar", "times": times}
    )
    for number in (0, 2):
        (cut / f"drive_{number}.txt").write_text("")
    found = find_labels([entry], recording)["{stem}.txt"].parts
    assert {one.part: one.frames for one in found} == {
        "drive_0.bag": (0, 7),
        "drive_1.bag": (7, 7),
        "drive_2.bag": (14, 5),
    }


@pytest.mark.parametrize("name", ["drive.bag", "drive_1.bag", "drive_*.bag", "drive*"])
def test_a_recording_is_chosen_by_the_names_of_its_parts(cut, name):
    recordings = discover(bags(cut)).recordings
    assert choose_recordings(recordings, [name]) == {"drive.bag"}
    assert choose_recordings(recordings, [str(cut / "drive_2.bag")]) == {"drive.bag"}
    assert choose_recordings(recordings, [f"{cut}/x/../drive_2.bag"]) == {"drive.bag"}


def test_a_part_that_is_damaged_or_gone_is_named(cut):
    (recording,) = discover(bags(cut)).recordings.values()
    path = cut / "drive_1.bag"
    path.write_bytes(path.read_bytes()[:-3000])
    with pytest.raises(RecordingError, match=r"drive_1\.bag: it cannot be read"):
        content(recording)
    path.unlink()
    with pytest.raises(RecordingError, match=r"drive_1\.bag: no such file; it was removed or renamed"):
        content(recording)


def test_a_part_that_nobody_may_read_is_looked_into_again(cut, monkeypatch):
    def refused(path):
        raise PermissionError(13, "Permission denied", str(path))

    with monkeypatch.context() as patched:
        patched.setattr(seeing, "refuse_pointer", refused)
        assert len(keys(cut)) == 3
    assert keys(cut) == ["drive.bag"]


# --- periods -----------------------------------------------------------------------------


def write_slow_parts(folder, suffix, pause_s, parts=2):
    """Write parts: topics of 1 and 2 s, one of which was silent for half a minute, a latched and a rare one."""
    times_s = {
        "/fast": range(12),
        "/slow": [*range(0, 20, 2), 50, 52],
        "/rare": range(0, 36, 9),
        "/tf_static": range(0, 50, 5),
    }
    text = b"\x05\0\0\0text\0" if suffix == ".bag" else b"\0\1\0\0\x05\0\0\0text\0"
    for number in range(parts):
        path = folder / f"drive_{number}{suffix}"
        writing = folder / "writing" if suffix == ".db3" else path
        with ExitStack() as stack:
            formats = {".bag": "ros1", ".mcap": "mcap", ".db3": "ros2"}
            recorder = open_recorder(writing, formats[suffix], "none", stack)
            for time_s, topic in sorted(
                (time_s, topic) for topic, times in times_s.items() for time_s in times
            ):
                begin_s = number * (52 + pause_s)
                recorder.write_raw(topic, "std_msgs/msg/String", START_NS + (begin_s + time_s) * 10**9, text)
        if suffix == ".db3":
            shutil.move(next(writing.glob("*.db3")), path)
            shutil.rmtree(writing)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_pause_may_take_three_median_periods_of_the_slowest_topic_that_is_regular(tmp_path, suffix):
    for pause_s, found in ((6, [f"drive{suffix}"]), (7, [f"drive_0{suffix}", f"drive_1{suffix}"])):
        folder = tmp_path / str(pause_s)
        folder.mkdir()
        write_slow_parts(folder, suffix, pause_s)
        discovery = discover(bags(folder))
        assert list(discovery.recordings) == found
        assert len(discovery.asked) == len(found) - 1


def test_periods_are_read_once_and_only_where_they_decide(tmp_path, monkeypatch):
    (state := tmp_path / ".state").mkdir()
    looked, look = [], seeing._with_period
    monkeypatch.setattr(
        seeing, "_with_period", lambda facts, path: looked.append(path.name) or look(facts, path)
    )
    for name, pause_s in (("soon", 2), ("pause", 6), ("hour", 3600)):
        (tmp_path / name).mkdir()
        write_slow_parts(tmp_path / name, ".mcap", pause_s, parts=3)
    for _ in range(2):
        monkeypatch.setattr(join_parts, "_judged", {})  # as in another process
        found = list(discover(bags(tmp_path).with_state(state)).recordings)
        alone = [f"hour__drive_{number}.mcap" for number in range(3)]
        assert found == [*alone, "pause__drive.mcap", "soon__drive.mcap"]
        assert looked == [f"drive_{number}.mcap" for number in range(3)]


# --- killed recorders --------------------------------------------------------------------


@pytest.mark.parametrize("leave", [lambda path: leave_log(path, 5), leave_journal])
def test_a_part_whose_recorder_was_killed_is_joined_with_what_is_in_its_log(tmp_path, leave):
    whole = write_part(tmp_path / "whole" / "drive.db3", duration_s=2.0)
    last = write_parts(tmp_path / "cut" / "drive.db3", CUTS_S, 2.0)[-1]
    before = part_facts(last)
    leave(last)
    left = sorted(tmp_path.glob("cut/*"))
    assert len(left) == 4
    assert part_facts(last) == before
    (cut,) = discover(bags(tmp_path / "cut", settle_s=0)).recordings.values()
    assert cut.files == tuple(left)
    assert content(cut)[0] == content(whole)[0]
    assert sorted(tmp_path.glob("cut/*")) == left


def test_a_part_whose_recorder_is_at_work_is_not_copied_at_each_look(tmp_path, monkeypatch):
    parts = write_parts(tmp_path / "drive.db3", CUTS_S, 2.0)
    leave_log(parts[-1], 5)
    with monkeypatch.context() as patched:
        patched.setattr(shutil, "copyfile", lambda *of: pytest.fail(f"{of} was copied"))
        assert keys(tmp_path, settle_s=60) == ["drive.db3", "drive_2.db3"]
    for path in tmp_path.iterdir():
        os.utime(path, (1_700_000_000, 1_700_000_000))
    assert keys(tmp_path, settle_s=60) == ["drive.db3"]
