"""What a killed recorder leaves beside a database counts, and nothing is written where recordings are."""

import os
import shutil
from pathlib import Path

import pytest

from bagassets.base.errors import ChangedWhileReadError, RecordingError
from bagassets.recipe.model import Bags
from bagassets.recordings.digest import (
    assert_unchanged,
    recording_digest,
    recording_stat,
    stored_digest,
)
from bagassets.recordings.discover import discover, find_one
from bagassets.recordings.journals import journals_of
from bagassets.recordings.open import open_recording
from bagassets.store.canonical import digest_file
from bagassets_tests.killed_recorder import leave_journal, leave_log, write_clean
from bagassets_tests.whole.test_end_to_end import build_of, make_project

pytestmark = pytest.mark.once

LOGGED = 31


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    return write_clean(tmp_path_factory.mktemp("clean") / "b.db3", duration_s=1.0)


@pytest.fixture
def database(clean, tmp_path):
    (tmp_path / "bags").mkdir()
    return shutil.copy2(clean, tmp_path / "bags" / "b.db3")


def read(path):
    with open_recording(path) as recording:
        announced = sum(topic.count for topic in recording.topics.values())
        messages = [
            (m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages(list(recording.topics))
        ]
    assert len(messages) == announced
    return messages


def looks_of(folder):
    """Everything about a folder that a write would change, but for attributes."""
    facts = {
        entry.name: (
            entry.stat().st_ino,
            entry.stat().st_size,
            entry.stat().st_mtime_ns,
            digest_file(Path(entry.path)),
        )
        for entry in os.scandir(folder)
    }
    return facts, folder.stat().st_mtime_ns


@pytest.mark.parametrize(
    "leave", [lambda path: leave_log(path, LOGGED), leave_journal], ids=["log", "journal"]
)
def test_a_killed_recorder_loses_no_message_that_it_had_committed(clean, database, leave):
    leave(database)
    before = looks_of(database.parent)
    assert len(before[0]) == 2
    assert read(database) == read(clean)
    assert looks_of(database.parent) == before


def test_the_same_in_a_folder_whose_metadata_was_written_before(clean, database, tmp_path):
    folder = tmp_path / "folder"
    shutil.copytree(clean.parent, folder)
    with open_recording(clean) as recording:
        names = {name: (topic.msgtype, topic.count) for name, topic in recording.topics.items()}
    entries = "".join(
        f"    - {{topic_metadata: {{name: {name}, type: {msgtype}, serialization_format: cdr}}, message_count: {count}}}\n"
        for name, (msgtype, count) in names.items()
    )
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n  relative_file_paths: [b.db3]\n"
        f"  topics_with_message_count:\n{entries}"
    )
    clean_files, expected = find_one(folder).files, read(folder)
    leave_log(folder / "b.db3", LOGGED)
    assert {path.name for path in find_one(folder).files} == {path.name for path in clean_files} | {
        "b.db3-wal"
    }
    assert read(folder) == expected == read(clean)


def test_what_was_not_committed_does_not_count(clean, database):
    leave_log(database, LOGGED, uncommitted=7)
    assert read(database) == read(clean)[:-7]


def test_a_log_of_before_is_not_applied(clean, database):
    """Its frames have other salts than its header, as after a checkpoint."""
    leave_log(database, LOGGED)
    log = database.with_name("b.db3-wal")
    data = bytearray(log.read_bytes())
    data[16:24] = bytes(8)
    log.write_bytes(data)
    assert read(database) == read(clean)[:-LOGGED]


@pytest.mark.parametrize(("suffix", "size"), [("-wal", 0), ("-journal", 0), ("-shm", 32768), ("-wal", 32)])
def test_files_beside_a_database_that_hold_nothing_change_nothing(clean, database, suffix, size):
    before = recording_digest(find_one(database)).digest
    assert before == digest_file(database)
    database.with_name(f"b.db3{suffix}").write_bytes(bytes(size))
    recording = find_one(database)
    assert recording.files == (database,)
    assert recording_digest(recording, rehash=True).digest == before
    assert read(database) == read(clean)


def test_a_log_belongs_to_the_recording_and_its_digest(database):
    alone = recording_digest(find_one(database))
    leave_log(database, LOGGED)
    log = database.with_name("b.db3-wal")
    (recording,) = discover(Bags(root=database.parent)).recordings.values()
    assert recording.files == (database, log)
    assert recording.size == database.stat().st_size + log.stat().st_size
    whole = recording_digest(recording)
    assert set(whole.files) == {"b.db3", "b.db3-wal"}
    assert whole.digest not in {alone.digest, whole.files["b.db3"]}
    assert stored_digest(recording) == whole.digest
    with log.open("r+b") as file:
        file.truncate(log.stat().st_size - 5000)
    assert stored_digest(recording) is None


def test_a_log_that_appears_or_grows_is_a_change(database, tmp_path):
    log = database.with_name("b.db3-wal")
    recording = find_one(database)
    leave_log(shutil.copy2(database, tmp_path / "b.db3"), LOGGED)
    before = recording_stat(recording)
    log.write_bytes((tmp_path / "b.db3-wal").read_bytes())
    with pytest.raises(ChangedWhileReadError):
        assert_unchanged(recording, before)
    assert recording_digest(recording).digest == recording_digest(find_one(database)).digest
    recording, before = find_one(database), recording_stat(find_one(database))
    with log.open("ab") as file:
        file.write(bytes(4096))
    with pytest.raises(ChangedWhileReadError):
        assert_unchanged(recording, before)
    log.unlink()
    with pytest.raises(ChangedWhileReadError):
        recording_stat(recording)


def test_the_private_copy_leaves_nothing_behind(database, tmp_path, monkeypatch):
    leave_log(database, LOGGED)
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    with open_recording(database) as recording:
        assert list(scratch.iterdir()) == []  # a kill from now on leaves nothing, either
        assert len(list(recording.messages(["/odom"]))) == 51


def test_a_copy_that_does_not_fit_is_said_before_it_is_made(database, monkeypatch):
    leave_log(database, LOGGED)
    usage = shutil.disk_usage(database.parent)._replace(free=100)
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage)
    with pytest.raises(RecordingError, match=r"b\.db3: .* TMPDIR") as caught:
        open_recording(database)
    assert caught.value.transient


def test_a_link_to_a_database_whose_log_is_elsewhere_is_refused(clean, database, tmp_path):
    leave_log(database, LOGGED)
    links = tmp_path / "links"
    links.mkdir()
    (links / "b.db3").symlink_to(database)
    with pytest.raises(RecordingError, match=r"b\.db3-wal"):
        open_recording(links / "b.db3")
    (links / "b.db3-wal").symlink_to(database.with_name("b.db3-wal"))
    assert read(links / "b.db3") == read(clean)


def test_a_journal_of_several_databases_is_refused(database):
    leave_journal(database)
    with database.with_name("b.db3-journal").open("ab") as file:
        file.write(bytes(12) + bytes.fromhex("d9d505f920a163d7"))  # the mark alone: it names nothing
    with pytest.raises(RecordingError, match=r"b\.db3: .*b\.db3-journal belongs to several databases"):
        open_recording(database)


def test_only_files_are_taken_for_journals(database):
    database.with_name("b.db3-wal").mkdir()
    os.mkfifo(database.with_name("b.db3-journal"))
    assert journals_of([database]) == {}
    assert len(find_one(database).files) == 1


def test_a_killed_drive_gives_the_same_dataset(clean, tmp_path):
    made = {}
    for name in ("clean", "killed"):
        recipe = make_project(tmp_path / name)
        (tmp_path / name / "bags").mkdir()
        database = shutil.copy2(clean, tmp_path / name / "bags" / "b.db3")
        if name == "killed":
            leave_log(database, LOGGED)
        made[name] = {
            a.asset: a.artifact.digest for a in build_of(recipe, "b.db3").build() if hasattr(a, "artifact")
        }
    different = {asset for asset in made["clean"] if made["clean"][asset] != made["killed"][asset]}
    assert len(made["clean"]) > 5
    assert different <= {"inventory"}  # it names the size of the files
