"""`bagassets doctor`: its page, its exit status, and copies that other programs read without complaint."""

import gzip
import json
import random
import re
import shutil
from collections import Counter
from pathlib import Path

import pytest
import zstandard
from click.testing import CliRunner
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from bagassets.base.errors import RecordingError
from bagassets.cli.main import root
from bagassets.recordings.open import open_recording
from bagassets.store.canonical import digest_file
from bagassets_tests.damaged_files import SOUND, damaged, storage_of, truth
from bagassets_tests.recorded_bags import NOON_NS, text, write_mcap, write_ros1, write_ros2

pytestmark = pytest.mark.once
SUFFIX = {"ros1": ".bag", "mcap": ".mcap"}


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return {kind: make(tmp_path_factory.mktemp(kind.replace(" ", "_"))) for kind, make in SOUND.items()}


def doctor(*arguments):
    result = CliRunner().invoke(root, ["doctor", *map(str, arguments)], catch_exceptions=False)
    return result.exit_code, result.output


def messages_of(path):
    with open_recording(path) as recording:
        return Counter(
            (m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages(list(recording.topics))
        )


def read_by_rosbags(path, kind):
    store = get_typestore(Stores.ROS1_NOETIC if kind.startswith("ros1") else Stores.ROS2_HUMBLE)
    found = Counter()
    with AnyReader([path], default_typestore=store) as reader:
        for connection, time_ns, data in reader.messages():
            if kind != "folder zstd":  # what is unpacked after noise is anything
                reader.deserialize(data, connection.msgtype)
            found[connection.topic, time_ns, bytes(data)] += 1
        assert reader.message_count == found.total()
    return found


def read_by_mcap(path):
    found = Counter()
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for _, channel, message in reader.iter_messages():
            found[channel.topic, message.log_time, bytes(message.data)] += 1
            assert message.publish_time == message.log_time + 7
        assert reader.get_summary().statistics.message_count == found.total()
    return found


@pytest.mark.parametrize("damage", ["cut at 90 %", "30 KB of noise"])
@pytest.mark.parametrize("kind", SOUND)
def test_a_copy_is_read_without_complaint_and_has_the_same_messages(tmp_path, sound, kind, damage):
    path = damaged(tmp_path, kind, damage, sound[kind])
    copy = tmp_path / f"copy{SUFFIX.get(kind.split()[0], '')}"
    status, output = doctor(path, "--json")
    found = json.loads(output)
    assert (status, found["verdict"]) == (3, "mendable"), output
    assert doctor(path, "--write", copy)[0] == 3
    read = messages_of(copy)
    assert sum(one["messages"] for one in found["topics"].values()) == read.total() > 30
    assert read_by_rosbags(copy, kind) == read
    if kind.startswith("mcap"):
        assert read_by_mcap(copy) == read
    if kind != "folder zstd":
        assert (read - truth(kind)).total() <= 2
    assert doctor(copy)[0] == 0
    assert sorted(one.name for one in tmp_path.iterdir()) == sorted([path.name, copy.name])


@pytest.mark.parametrize(
    ("messages", "said"),
    [
        ([], "Sound, but empty: it holds no message."),
        ([text(NOON_NS)], "Sound: its only message can be read."),
    ],
)
def test_a_recording_of_no_message_is_said_to_be_empty(tmp_path, messages, said):
    paths = write_mcap(tmp_path / "a.mcap", messages), write_ros2(tmp_path / "b", messages)
    for path in (*paths, write_ros1(tmp_path / "c.bag", messages)):
        assert doctor(path) == (0, f"{path}\n\n{said}\n")


@pytest.mark.parametrize("kind", SOUND)
def test_a_sound_recording_is_said_to_be_that(sound, kind):
    status, output = doctor(sound[kind])
    assert status == 0
    assert output == f"{sound[kind]}\n\nSound: all {truth(kind).total()} messages can be read.\n"
    found = json.loads(doctor(sound[kind], "--json")[1])
    assert found["damage"] is None


@pytest.mark.parametrize("behind", ["noise", "zeros", "the same recording", "another recording"])
@pytest.mark.parametrize(
    "kind", ["ros1", "ros1 lz4", "mcap zstd", "mcap unchunked", "db3", "folder", "folder mcap"]
)
def test_with_bytes_behind_its_end_a_recording_is_mendable_in_every_format(tmp_path, sound, kind, behind):
    path = tmp_path / sound[kind].name
    (shutil.copytree if path.name == "a" else shutil.copy)(sound[kind], path)
    file = storage_of(path)
    data = file.read_bytes()
    other = "mcap lz4" if file.suffix == ".mcap" else "ros1 bz2"
    more = {
        "noise": random.Random(kind).randbytes(1000),
        "zeros": bytes(4096),
        "the same recording": data,
        "another recording": sound[other].read_bytes(),
    }[behind]
    file.write_bytes(data + more)
    assert messages_of(path) == truth(kind)  # as builds that refuse damaged ones read it
    status, output = doctor(path)
    said = f"{file.name}: behind the end of the recording are {len(more)} more bytes, which are not read"
    assert f"Where\n  {said}\n\n" in output
    assert "All of it can be read, but more bytes follow" in output
    assert "Builds use it as it is, whatever `recover` in the recipe says." in output
    found = json.loads(doctor(path, "--json")[1])
    assert (status, found["verdict"], found["damage"]["complete"]) == (3, "mendable", True)
    assert found["damage"]["findings"] == [said]
    assert sum(one["messages"] for one in found["topics"].values()) == truth(kind).total()
    copy = tmp_path / f"copy{SUFFIX.get(kind.split()[0], '')}"
    assert doctor(path, "--write", copy)[0] == 3
    assert messages_of(copy) == truth(kind)
    assert doctor(copy)[0] == 0


def test_the_page_says_what_where_what_can_be_saved_and_what_to_do(tmp_path, sound):
    path = damaged(tmp_path, "ros1 lz4", "cut at 50 %", sound["ros1 lz4"])
    before = digest_file(path)
    status, output = doctor(path)
    assert status == 3
    sections = [line for line in output.splitlines() if line and not line.startswith(" ")]
    assert sections == [str(path), "What is wrong", "Where", "What can be saved", "What to do next"]
    assert "a.bag, bytes" in output
    assert f"to {path.stat().st_size}" in output
    assert "the chunk is damaged: it is cut off" in output
    assert re.search(
        r", bytes \d+ to \d+, after 20\S+ \(\d+\)(?: and before 20\S+ \(\d+\))?: the chunk", output
    )
    assert "messages can be read; how many there were is not known." in output
    assert "`recover: all` in bags of the recipe" in output
    assert len(output.splitlines()) < 30
    assert digest_file(path) == before


def test_what_was_written_stands_last(tmp_path, sound):
    total = truth("ros1").total()
    copy = tmp_path / "b.bag"
    status, output = doctor(sound["ros1"], "--write", copy)
    page = f"{sound['ros1']}\n\nSound: all {total} messages can be read.\n\n"
    assert (status, output) == (0, page + f"{copy}: {total} messages written.\n")
    path = damaged(tmp_path, "ros1", "cut at 90 %", sound["ros1"])
    status, output = doctor(path, "--write", tmp_path / "c.bag")
    *_, advice, _, written = output.splitlines()
    assert (status, advice) == (
        3,
        "  Or have builds use what can be read: `recover: all` in bags of the recipe.",
    )
    assert written == f"{tmp_path / 'c.bag'}: {messages_of(tmp_path / 'c.bag').total()} messages written."


def test_one_that_is_complete_needs_nothing(tmp_path, sound):
    path = damaged(tmp_path, "mcap zstd", "without its index", sound["mcap zstd"])
    status, output = doctor(path)
    assert status == 3
    assert f"{truth('mcap').total()} messages can be read" in output
    assert "Builds use it as it is, unless the recipe says `recover: refuse`." in output


def test_what_is_no_recording_is_lost(tmp_path):
    path = tmp_path / "a.bag"
    path.write_text("no bag " * 100)
    status, output = doctor(path, "--write", tmp_path / "b.bag")
    assert status == 1
    assert "it does not begin" in output
    assert "reindex" not in output
    assert "If it is no recording, remove it, or name it in bags.exclude of the recipe." in output
    assert "copy it again from where it was recorded; nothing in this file can be read." in output
    assert not (tmp_path / "b.bag").exists()


def test_one_with_the_name_of_another_kind_is_to_be_renamed(tmp_path, sound):
    path = tmp_path / "a.bag"
    path.write_bytes(sound["mcap zstd"].read_bytes())
    status, output = doctor(path)
    assert status == 1
    assert (
        "its content is that of an MCAP file, whatever its name says; have its name end in .mcap." in output
    )
    assert "Rename it, and ask again." in output
    assert "nothing in this file" not in output


def test_a_bag_cut_off_before_its_index_is_said_to_be_that_once(tmp_path, sound):
    path = damaged(tmp_path, "ros1", "cut at 90 %", sound["ros1"])
    _, output = doctor(path)
    assert "What is wrong\n  it cannot be read (it was cut off before its index).\n" in output
    assert output.count("index") == 1
    active = damaged(tmp_path, "ros1", "without its index", sound["ros1"])
    _, output = doctor(active)  # never had one
    assert "cut off" not in output
    assert "it has no index, as if the recorder had been stopped" in output


def test_unfinished_files_are_examined_by_their_names(tmp_path, sound):
    bag = damaged(tmp_path, "ros1", "without its index", sound["ros1"])
    active = bag.rename(tmp_path / "x.bag.active")
    assert doctor(active, "--write", tmp_path / "x.bag")[0] == 3
    assert messages_of(tmp_path / "x.bag") == truth("ros1")
    packed = next(sound["folder zstd"].glob("*.zstd"))
    cut = tmp_path / "a_0.db3.zstd"
    cut.write_bytes(packed.read_bytes()[:-2000])
    status, output = doctor(cut, "--write", tmp_path / "copy")
    assert status == 3, output
    assert "it is compressed with zstd" in output
    assert "it is cut off: of " in output
    assert (
        "What to do next\n  Builds take no such file; `--write COPY` makes a ROS 2 bag folder of what can be read, which"
        in output
    )
    assert "recover" not in output
    assert 100 < messages_of(tmp_path / "copy").total() < truth("folder").total()


@pytest.mark.parametrize(
    ("kind", "suffix", "made"), [("ros1", ".bag", "a .bag"), ("mcap zstd", ".mcap", "an .mcap")]
)
def test_the_copy_of_a_packed_file_is_said_to_be_what_it_is(tmp_path, sound, kind, suffix, made):
    packed = tmp_path / f"a{suffix}.zstd"
    packed.write_bytes(zstandard.ZstdCompressor().compress(sound[kind].read_bytes()))
    _, output = doctor(packed, "--write", tmp_path / f"copy{suffix}")
    assert f"`--write COPY` makes {made} file of what can be read" in output
    assert messages_of(tmp_path / f"copy{suffix}") == truth(kind)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["a.bag"], "but holds some: a.bag; name one of them"),
        (["b.db3", "a.db3"], "but holds some: a.db3, b.db3; name one of them"),
        (
            ["run_0.mcap", "run_1.mcap", "walk_0.mcap"],
            "but holds some: run_0.mcap, run_1.mcap, walk_0.mcap; name",
        ),
        (["a_0.db3", "x.bag.active"], "but holds some: a_0.db3, x.bag.active; name one of them"),
        (["notes.txt"], "and holds none"),
        (["b/metadata.yaml"], "but holds some: b; name one of them"),
    ],
)
def test_a_folder_of_recordings_is_not_said_to_be_a_lost_one(tmp_path, sound, names, said):
    sources = {".bag": sound["ros1"], ".db3": storage_of(sound["folder"]), ".mcap": sound["mcap zstd"]}
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(sources.get(Path(name).suffix, sound["ros1"]), tmp_path / name)
    result = CliRunner().invoke(root, ["doctor", str(tmp_path), "--write", str(tmp_path / "copy")])
    assert result.exit_code == 1
    assert f"{tmp_path}: this folder is no recording, {said}" in str(result.exception)
    assert not (tmp_path / "copy").exists(), (
        "recordings that have nothing to do with each other are not joined"
    )


def test_a_folder_whose_metadata_are_lost_is_one_recording_with_all_its_parts(tmp_path, sound):
    path = tmp_path / "a"
    shutil.copytree(sound["folder split"], path)
    (path / "metadata.yaml").unlink()
    status, output = doctor(path, "--json")
    assert status == 3
    found = json.loads(output)
    assert found["verdict"] == "mendable"
    assert sum(one["messages"] for one in found["topics"].values()) == truth("folder split").total()


@pytest.mark.parametrize("names", [["tuesday.mcap"], ["tuesday_0.mcap", "tuesday_1.mcap"]])
def test_a_folder_that_lacks_its_metadata_is_said_to(tmp_path, sound, names):
    folder = tmp_path / "tuesday"
    folder.mkdir()
    for name in names:
        shutil.copy(sound["mcap"], folder / name)
    status, output = doctor(folder)
    assert status == 3
    assert "What is wrong\n  its metadata.yaml is missing.\n" in output
    assert f"{len(names) * truth('mcap').total()} messages can be read" in output


def test_a_file_that_metadata_name_otherwise_is_to_be_renamed(tmp_path, sound):
    folder = shutil.copytree(sound["folder"], tmp_path / "tuesday")
    (file,) = folder.glob("*.db3")
    file.rename(folder / "other.db3")
    status, output = doctor(folder)
    assert status == 1
    renamed = f"{file.name} of its metadata.yaml is missing; copy the whole folder again, or rename other.db3 so, if that is it."
    assert renamed in output
    assert "nothing in this file can be read" not in output
    (folder / "other.db3").rename(file)
    assert doctor(folder)[0] == 0


@pytest.mark.parametrize("suffix", ["", ".zstd"])
def test_files_that_somebody_has_unpacked_are_read_whatever_the_metadata_say(tmp_path, sound, suffix):
    folder = shutil.copytree(sound["folder"], tmp_path / "tuesday")
    metadata = (folder / "metadata.yaml").read_text()
    for old, new in (
        ("compression_format: ''", "compression_format: zstd"),
        ("compression_mode: ''", "compression_mode: FILE"),
        (".db3\n", f".db3{suffix}\n"),
    ):
        assert old in metadata
        metadata = metadata.replace(old, new)
    (folder / "metadata.yaml").write_text(metadata)
    assert doctor(folder)[0] == 0


def test_names_that_cannot_be_written_are_refused(tmp_path, sound):
    path = damaged(tmp_path, "ros1", "cut at 90 %", sound["ros1"])
    for name, said in (
        ("a.bag", "there is something already"),
        ("b.mcap", "ends in .bag"),
        ("no/b.bag", "cannot be written"),
    ):
        result = CliRunner().invoke(root, ["doctor", str(path), "--write", str(tmp_path / name)])
        assert said in str(result.exception)
    assert "no such file" in str(CliRunner().invoke(root, ["doctor", str(tmp_path / "none")]).exception)
    folder = damaged(tmp_path, "folder", "cut at 90 %", sound["folder"])
    result = CliRunner().invoke(root, ["doctor", str(folder), "--write", str(tmp_path / "c.bag")])
    assert "a folder, a ROS 2 bag" in str(result.exception)
    shutil.rmtree(folder)


@pytest.mark.parametrize("command", [["doctor"], ["inspect"], ["convert"]])
def test_of_a_bag_that_somebody_has_packed_is_said_to_unpack_it(tmp_path, sound, command):
    """Its bytes were said to contradict each other: copy it again."""
    path = tmp_path / "a.bag.gz"
    path.write_bytes(gzip.compress(sound["ros1"].read_bytes()))
    more = [str(tmp_path / "out")] if command == ["convert"] else []
    with pytest.raises(RecordingError, match=r"compressed as a whole; decompress it to a\.bag"):
        CliRunner().invoke(root, [*command, str(path), *more], catch_exceptions=False)
