"""Damaged recordings: what is saved is no less than other programs save, and what is lost is counted."""

import errno
import io
import os
import random
import shutil
from collections import Counter
from pathlib import Path

import pytest
from mcap.writer import CompressionType

from bagassets.base.errors import DiskError, RecordingError
from bagassets.recipe.model import Bags, Limits
from bagassets.recordings.discover import bags_of_parts, discover, find_one
from bagassets.recordings.open import open_recording
from bagassets.recordings.salvage.damage_map import END_UNKNOWN, MOST_HOLES, Damage, DamageMap, Hole
from bagassets.recordings.salvage.find_records import _MOST_TRIED
from bagassets.recordings.salvage.open import open_salvaged, read_as_far
from bagassets.store.canonical import digest_file
from bagassets_tests import damaged_files
from bagassets_tests.damaged_files import (
    DAMAGES,
    KIB,
    SERIES,
    SOUND,
    damaged,
    entries,
    halves,
    oracle,
    spoil,
    storage_of,
    truth,
)
from bagassets_tests.killed_recorder import leave_log
from bagassets_tests.recorded_bags import NOON_NS, text
from bagassets_tests.reindexed_bag import CHUNK, records
from bagassets_tests.tree_memory import run_measured

pytestmark = pytest.mark.once

TOTAL = truth("ros1").total()
# Nothing in these tells that a byte of a message was changed, so such a message counts as read.
UNCHECKED = {"ros1", "ros1 lz4", "ros1 series", "mcap unchunked", "mcap without indexes", "db3", "folder", "folder split",
             "folder mcap", "folder zstd", "folder zstd messages"}  # fmt: skip


class FailingFile(io.FileIO):
    """A file of which one read fails, counted over all files, as the disk would have it."""

    left = 0

    def readinto(self, buffer):
        FailingFile.left -= 1
        if FailingFile.left == 0:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return super().readinto(buffer)

    def readall(self):
        raise AssertionError("recordings are not read at once")


@pytest.mark.parametrize("opener", [open_recording, open_salvaged])
@pytest.mark.parametrize("damage", [None, "cut at 90 %", "without its index", "30 KB of noise"])
@pytest.mark.parametrize("kind", ["ros1", "ros1 lz4", "mcap zstd", "mcap unchunked", "db3"])
def test_a_disk_that_fails_is_no_damage(tmp_path, sound, kind, damage, opener, monkeypatch):
    path = sound[kind] if damage is None else damaged(tmp_path, kind, damage, sound[kind])

    def all_of_it():
        with opener(path) as opened:
            return sum(1 for _ in opened.messages(list(opened.topics))), opened.damage and str(
                opened.damage.map({}, 0)
            )

    def outcome():
        try:
            return all_of_it()
        except RecordingError as err:
            return type(err), str(err)

    def failing_pread(*arguments):
        FailingFile.left -= 1
        if FailingFile.left == 0:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return pread(*arguments)

    pread, expected = os.pread, outcome()
    monkeypatch.setattr(os, "pread", failing_pread)
    monkeypatch.setattr(io, "open", lambda file, *_, **__: io.BufferedReader(FailingFile(file), 4096))
    FailingFile.left = 0
    assert outcome() == expected
    reads = -FailingFile.left
    assert reads > 0 or (kind == "db3" and opener is open_recording), "SQLite reads by itself"
    for number in {*range(1, min(reads, 12) + 1), *range(1, reads + 1, 1 + reads // 12)}:
        FailingFile.left = number
        with pytest.raises(
            DiskError, match=r"Input/output error.*; check its disk or file server, and try again"
        ):
            all_of_it()


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Kind -> a sound recording."""
    made = {}
    for kind, make in CORPUS.items():
        folder = tmp_path_factory.mktemp(kind.replace(" ", "_"))
        made[kind] = make(folder)
    return made


def saved(recording, **options):
    """Return the messages that can be read: how often each; and the damage map."""
    with open_salvaged(recording, **options) as opened:
        messages = list(opened.messages(list(opened.topics)))
        found = Counter((m.topic, m.log_time_ns, bytes(m.data)) for m in messages)
        read = Counter(m.topic for m in messages)
        lost = {
            name: topic.count - opened.repeated[name] - read[name] for name, topic in opened.topics.items()
        }
        return found, opened.damage.map(lost, len(messages))


def ordinary(path):
    with open_recording(path) as opened:
        return Counter((m.topic, m.log_time_ns, bytes(m.data)) for m in opened.messages(list(opened.topics)))


def files_of(path):
    return sorted(path.rglob("*")) if path.is_dir() else [path]


def check(tmp_path, kind, damage, sound):
    """Damage a recording, and compare what is saved of it with what was in it, and with what others save."""
    path = tmp_path / sound.name
    (shutil.copytree if sound.is_dir() else shutil.copy)(sound, path)
    recording = path
    if kind in SERIES:
        (recording,) = discover(bags_of_parts(sorted(path.iterdir()))).recordings.values()
    spoil(storage_of(path), kind, damage)
    before = [(file, digest_file(file)) for file in files_of(path)]
    best = (oracle(kind, path, sound) & truth(kind)).total()
    try:
        found, damage_map = saved(recording)
    except RecordingError:
        assert best == 0
        return
    assert [(file, digest_file(file)) for file in files_of(path)] == before
    right = (found & truth(kind)).total()
    assert right >= best
    wrong = (found - truth(kind)).total()
    assert wrong <= (TOTAL // 10 if kind in UNCHECKED else 0)
    assert damage_map.read == found.total()
    lost = sum(damage_map.lost.values())
    if damage_map.is_total_known:
        assert damage_map.read + lost == TOTAL
    else:
        assert damage_map.read + lost <= TOTAL
    if damage_map.is_complete:
        assert found.total() == TOTAL
    assert DamageMap.from_json(damage_map.as_json()) == damage_map
    sentences = list(damage_map.sentences())
    assert all(one.endswith(".") for one in sentences)


CORPUS = SOUND | SERIES
SAMPLE = random.Random(45).sample([(kind, damage) for kind in CORPUS for damage in DAMAGES], 60)


def test_the_corpus_is_as_large_as_it_should_be():
    assert len(CORPUS) * len(DAMAGES) >= 200


@pytest.mark.parametrize(("kind", "damage"), SAMPLE)
def test_a_sample_of_damaged_files(tmp_path, sound, kind, damage):
    check(tmp_path, kind, damage, sound[kind])


@pytest.mark.long
@pytest.mark.parametrize("kind", CORPUS)
def test_all_damaged_files(tmp_path, sound, kind):
    for number, damage in enumerate(DAMAGES):
        folder = tmp_path / str(number)
        folder.mkdir()
        check(folder, kind, damage, sound[kind])


@pytest.mark.parametrize("kind", SOUND)
def test_of_a_sound_recording_everything_is_read_in_the_same_order_and_nothing_is_found(sound, kind):
    with open_salvaged(sound[kind]) as one, open_recording(sound[kind]) as other:
        messages = [list(opened.messages(list(opened.topics))) for opened in (one, other)]
        assert messages[0] == messages[1]
        assert {n: t.count for n, t in one.topics.items()} == {n: t.count for n, t in other.topics.items()}
        assert {n: t.definition for n, t in one.topics.items()} == {
            n: t.definition for n, t in other.topics.items()
        }
        assert one.span_ns() == other.span_ns()
        damage = one.damage.map({}, len(messages[0]))
    assert (damage.findings, damage.holes, damage.is_total_known) == ((), (), True)


@pytest.mark.parametrize("kind", ["ros1", "ros1 lz4", "mcap", "mcap unchunked", "mcap zstd"])
def test_without_its_index_a_recording_is_complete(tmp_path, sound, kind):
    path = damaged(tmp_path, kind, "without its index", sound[kind])
    found, damage = saved(path)
    assert found == truth(kind)
    assert damage.is_complete
    if kind.startswith("ros1"):
        assert [finding.split(": ")[1] for finding in damage.findings] == [
            "it has no index, as if its recorder had been stopped", "nothing says where it ended",
        ]  # fmt: skip


@pytest.mark.parametrize("damage", ["4 KB of noise in the middle", "30 KB of noise"])
@pytest.mark.parametrize("kind", [kind for kind in SOUND if kind.startswith(("ros1", "mcap"))])
def test_what_follows_a_hole_is_found(tmp_path, sound, kind, damage):
    path = damaged(tmp_path, kind, damage, sound[kind])
    found, _ = saved(path)
    assert found.total() > 0.55 * TOTAL
    last_ns = max(time_ns for _, time_ns, _ in truth(kind))
    assert last_ns == max(time_ns for _, time_ns, _ in found)


def test_a_chain_of_pages_that_goes_on_costs_its_message(tmp_path, sound):
    data = bytearray(sound["db3"].read_bytes())
    pages = range(4096, len(data), 4096)
    ends = [at for at in pages if data[at : at + 4] == bytes(4) and any(data[at + 4 : at + 4096])]
    for at in ends:
        data[at : at + 4] = (2).to_bytes(4, "big")
    (tmp_path / "a.db3").write_bytes(data)
    found, damage = saved(tmp_path / "a.db3")
    assert damage.lost == {"/camera": len(ends)}
    assert found.total() + len(ends) == TOTAL


def test_a_hole_says_where_when_and_what(tmp_path, sound):
    path = damaged(tmp_path, "mcap", "a bit at 70 %", sound["mcap"])
    found, damage = saved(path)
    (hole,) = damage.holes
    gone = truth("mcap") - found
    assert (hole.file, hole.reason) == (
        "a.mcap",
        "the chunk is damaged: its content does not match its checksum",
    )
    assert hole.begin < 0.7 * path.stat().st_size < hole.end
    times = [time_ns for _, time_ns, _ in gone]
    assert (hole.start_ns, hole.end_ns) == (min(times), max(times))
    assert hole.lost == dict(damage.lost) == dict(Counter(topic for topic, _, _ in gone.elements()))


ZEROED = ["ros1", "mcap unchunked", "mcap no checksums"]


@pytest.mark.parametrize("to_end", [True, False])
@pytest.mark.parametrize("kind", ZEROED)
def test_a_message_that_reaches_into_zeros_is_lost_and_counted(tmp_path, sound, kind, to_end):
    path = tmp_path / sound[kind.partition(" no ")[0]].name
    if kind == "mcap no checksums":
        damaged_files.write_mcap(path, CompressionType.NONE, entries(), enable_crcs=False)
    else:
        shutil.copy(sound[kind], path)
    data = path.read_bytes()
    cut = [one for one in truth(kind) if one[0] == "/camera"][-4]
    begin = data.index(cut[2])
    middle = begin + len(cut[2]) // 2
    data = (
        data[:middle]
        + bytes(len(data) - middle if to_end else 2 * len(cut[2]))
        + (b"" if to_end else data[middle + 2 * len(cut[2]) :])
    )
    path.write_bytes(data)
    found, damage = saved(path)
    assert found - truth(kind) == Counter()
    assert found.total() > 0.6 * TOTAL
    assert not damage.is_complete
    if not to_end:  # what the end announces is still there
        assert damage.is_total_known
        assert damage.lost == dict(Counter(topic for topic, _, _ in (truth(kind) - found).elements()))
        assert damage.read + sum(damage.lost.values()) == TOTAL


@pytest.mark.parametrize("kind", ["ros1", "mcap unchunked"])
def test_a_message_of_zeros_is_kept_where_more_follows(tmp_path, kind):
    some = [text(NOON_NS + i, "\0" * 200) for i in range(50)]
    path = tmp_path / ("a.bag" if kind == "ros1" else "a.mcap")
    if kind == "ros1":
        damaged_files.write_bag(path, None, some)
    else:
        damaged_files.write_mcap(path, CompressionType.NONE, some, use_chunking=False)
    path.write_bytes(damaged_files.without_index(path.read_bytes(), None))
    found, damage = saved(path)
    assert found.total() == 50
    assert damage.is_complete


def clear_pages_with(data, text):
    while (place := data.find(text)) >= 0:
        page = place // 4096 * 4096
        data[page : page + 4096] = bytes(4096)


@pytest.mark.parametrize("size", [64, 20 * KIB])
@pytest.mark.parametrize("kind", ["ros1", "ros1 lz4", "mcap", "mcap zstd"])
def test_of_one_without_its_head_the_index_at_the_end_tells_what_is_lost(tmp_path, sound, kind, size):
    path = Path(shutil.copy(sound[kind], tmp_path))
    data = path.read_bytes()
    path.write_bytes(bytes(size) + data[size:])
    found, damage = saved(path)
    assert damage.is_total_known
    assert not found - truth(kind)
    gone = Counter(topic for topic, _, _ in (truth(kind) - found).elements())
    assert damage.lost == gone
    assert 0 < found.total() <= TOTAL
    assert not any("no index" in finding or END_UNKNOWN in finding for finding in damage.findings)


def test_a_database_without_its_first_pages_has_its_topics_from_the_metadata(tmp_path, sound):
    path = tmp_path / "a"
    shutil.copytree(sound["folder"], path)
    (file,) = path.glob("*.db3")
    data = bytearray(file.read_bytes())
    data[:4096] = bytes(4096)
    clear_pages_with(data, b"/camera")
    file.write_bytes(data)
    found, damage = saved(path)
    assert found == truth("folder")
    assert not damage.lost


def test_without_names_of_its_topics_nothing_of_a_database_is_guessed(tmp_path, sound):
    data = bytearray(sound["db3"].read_bytes())
    clear_pages_with(data, b"/camera")
    (tmp_path / "a.db3").write_bytes(data)
    found, damage = saved(tmp_path / "a.db3")
    assert not found
    assert damage.lost == {"": TOTAL}


def test_a_folder_without_a_file_of_its_metadata_loses_just_that(tmp_path, sound):
    path = tmp_path / "a"
    shutil.copytree(sound["folder split"], path)
    (path / "a_0.db3").unlink()
    found, damage = saved(path)
    assert found.total() == len(halves(entries())[1])
    assert sum(damage.lost.values()) == len(halves(entries())[0])
    assert damage.is_total_known
    assert damage.holes[0].reason == "the file is missing"


@pytest.mark.parametrize(
    "text", ["", "rosbag2_bagfile_information: [", "rosbag2_bagfile_information: {version: 5}\n"]
)
def test_without_its_metadata_a_folder_is_read_by_its_files(tmp_path, sound, text):
    path = tmp_path / "a"
    shutil.copytree(sound["folder split"], path)
    (path / "metadata.yaml").write_text(text)
    found, damage = saved(path)
    assert found == truth("folder split")
    assert damage.is_complete
    assert not damage.is_total_known


def as_left_by_a_recorder(bag, cut=0):
    """Return a bag whose recorder was killed: without index, and the last chunk, whose length is not filled in, has `cut` bytes less."""
    data = bag.read_bytes()
    at = data.index(b"index_pos=") + 10
    end = int.from_bytes(data[at : at + 8], "little")
    found = list(records(data[:end], len(b"#ROSBAG V2.0\n")))
    _, body, begin, _ = next(one for one in reversed(found) if one[0]["op"][0] == CHUNK)
    head = bytearray(data[begin : data.index(body, begin)])
    head[-4:] = bytes(4)
    size = head.index(b"size=") + 5
    head[size : size + 4] = bytes(4)
    return data[:at] + bytes(8) + data[at + 8 : begin] + head + body[: len(body) - cut]


@pytest.mark.parametrize("kind", ["ros1", "ros1 lz4"])
def test_the_chunk_that_a_killed_recorder_was_writing_is_read(tmp_path, sound, kind):
    path = tmp_path / "a.bag.active"
    path.write_bytes(as_left_by_a_recorder(sound[kind]))
    found, damage = saved(path)
    assert found == truth(kind)
    assert "a.bag.active: its last chunk was being written" in damage.findings
    assert damage.is_complete == (kind == "ros1")  # packed, nothing tells whether more was to come
    path.write_bytes(as_left_by_a_recorder(sound[kind], cut=30))
    found, damage = saved(path)
    assert truth(kind) - found
    assert not damage.is_complete


class TestSeries:
    @pytest.fixture
    def parts(self, tmp_path):
        paths = []
        for number, half in enumerate(halves(entries())):
            paths.append(damaged_files.write_bag(tmp_path / f"drive_{number}.bag", "LZ4", half))
        return paths

    def one(self, paths):
        (recording,) = discover(bags_of_parts(paths)).recordings.values()
        assert recording.parts
        return recording

    def test_a_damaged_part_costs_its_own_part(self, parts):
        recording = self.one(parts)
        data = parts[1].read_bytes()
        parts[1].write_bytes(data[: len(data) // 2])
        found, damage = saved(recording)
        first = Counter(
            {
                one: n
                for one, n in truth("ros1").items()
                if one[1] < entries()[len(entries()) // 2].log_time_ns
            }
        )
        assert first - found == Counter()
        assert found - truth("ros1") == Counter()
        assert found.total() > first.total() + 50
        assert {hole.file for hole in damage.holes} == {"drive_1.bag"}

    def test_a_part_of_which_nothing_can_be_read_is_a_hole(self, parts):
        recording = self.one(parts)
        parts[0].write_bytes(b"no bag" * 1000)
        found, damage = saved(recording)
        assert found.total() == len(halves(entries())[1])
        (hole,) = damage.holes
        assert (hole.file, hole.begin, hole.end) == ("drive_0.bag", 0, recording.parts[0].size)
        # It is in inventories, whose bytes do not change.
        assert hole.reason == (
            "it cannot be read (it does not begin as such a file does); expected a finished ROS 1 bag; try "
            "`rosbag reindex` on a copy, or copy it again from where it was recorded"
        )
        assert not damage.is_total_known

    def test_where_no_part_can_be_read_that_is_said(self, parts):
        recording = self.one(parts)
        for part in parts:
            part.write_bytes(b"no bag" * 1000)
        with pytest.raises(RecordingError, match="none of its parts can be read"):
            open_salvaged(recording)


class TestBounds:
    @pytest.mark.parametrize("suffix", ["bag", "mcap", "db3"])
    def test_a_file_that_is_no_recording_is_said_to_be_that(self, tmp_path, suffix):
        path = tmp_path / f"a.{suffix}"
        for data in (b"this is no recording\n" * 2000, bytes(100_000), random.Random(1).randbytes(300_000)):
            path.write_bytes(data)
            with pytest.raises(RecordingError, match=r"does not begin|no SQLite database"):
                open_salvaged(path)

    def test_chunks_obey_limits(self, tmp_path):
        path = damaged_files.write_mcap(tmp_path / "a.mcap", CompressionType.ZSTD, entries())
        data = bytearray(path.read_bytes())
        at = data.index(b"zstd") - 4 - 4 - 8
        data[at : at + 8] = (2**40).to_bytes(8, "little")
        path.write_bytes(data)
        found, damage = saved(path)
        assert TOTAL - 60 < found.total() < TOTAL
        assert damage.read + sum(damage.lost.values()) == TOTAL
        other = damaged_files.write_bag(tmp_path / "a.bag", "LZ4", entries())
        other.write_bytes(other.read_bytes()[:-300])
        with pytest.raises(RecordingError, match=r"limits\.connections"):
            open_salvaged(other, limits=Limits(connections=2))

    def test_noise_that_looks_like_records_takes_bounded_time(self, tmp_path):
        sound_ = damaged_files.write_bag(tmp_path / "a.bag", None, entries(20))
        data = sound_.read_bytes()
        like = b"\x29\0\0\0\x10\0\0\0compression=" * (_MOST_TRIED + 1000)
        at = data.index(b"index_pos=") + 10
        sound_.write_bytes(data[:at] + bytes(8) + data[at + 8 : -200] + like)
        found, damage = saved(sound_)
        assert found
        assert not damage.is_complete

    def test_of_many_holes_the_last_ones_are_counted_together(self):
        damage = Damage()
        for number in range(1000):
            damage.hole(Hole("a.bag", number * 10, number * 10 + 5, "no record can be read"))
        holes = damage.map({}, 1).holes
        assert len(holes) == MOST_HOLES
        assert holes[-1].end == 9995
        assert "more places than are listed" in holes[-1].reason

    def test_a_large_damaged_file_takes_little_memory(self, tmp_path):
        import sys

        path = damaged_files.write_bag(tmp_path / "a.bag", "LZ4", entries(20_000))
        path.write_bytes(path.read_bytes()[:-100_000])
        code = (
            "import sys; from pathlib import Path\n"
            "from bagassets.recordings.salvage.open import open_salvaged\n"
            "with open_salvaged(Path(sys.argv[1])) as one: print(sum(1 for _ in one.messages(list(one.topics))))\n"
        )
        measured = run_measured([sys.executable, "-c", code, path], cwd=tmp_path, timeout_s=300)
        assert measured.returncode == 0, measured.output
        assert int(measured.output) > 25_000
        assert measured.peak_bytes < 400_000_000


def test_read_as_far_goes_on_where_the_ordinary_readers_stop(tmp_path, sound):
    def count(opened):
        return opened.damage is not None, sum(1 for _ in opened.messages(list(opened.topics)))

    assert read_as_far(find_one(sound["mcap"]), count) == (False, TOTAL)
    path = damaged(tmp_path, "mcap", "cut at 90 %", sound["mcap"])
    is_damaged, number = read_as_far(find_one(path), count)
    assert is_damaged
    assert 0.8 * TOTAL < number < TOTAL
    path.write_bytes(b"hello" * 100)
    with pytest.raises(RecordingError, match="does not begin"):
        read_as_far(find_one(path), count)


def test_a_bag_whose_index_contradicts_its_records_gives_all_of_them(tmp_path, sound):
    data = bytearray(sound["ros1"].read_bytes())
    at = data.index(b"\x0a\0\0\0count=") + 4 + 6 + 4 + 4  # of the first index, its times and offsets follow
    assert data[at + 8 : at + 12] != bytes(4)
    data[at + 8 + 12] ^= 0x01  # the offset of its second message
    (tmp_path / "a.bag").write_bytes(data)
    with pytest.raises(RecordingError):
        ordinary(tmp_path / "a.bag")
    found, damage = saved(tmp_path / "a.bag")
    assert found == truth("ros1")
    assert damage.is_complete


def test_bags_of_the_recipe_decide(tmp_path):
    assert Bags(root=tmp_path).recover == "complete"


class TestLogs:
    """What a killed recorder left beside a database is applied first, as for a sound one."""

    def test_a_log_beside_a_damaged_database(self, tmp_path, sound):
        path = shutil.copy2(sound["db3"], tmp_path / "a.db3")
        leave_log(path, 20)
        with path.open("r+b") as file:
            file.seek(3)
            file.write(b"\0")
        before = sorted((one.name, digest_file(one)) for one in tmp_path.iterdir())
        with open_salvaged(path) as opened:
            number = sum(1 for _ in opened.messages(list(opened.topics)))
        assert number >= TOTAL - 20
        assert sorted((one.name, digest_file(one)) for one in tmp_path.iterdir()) == before
