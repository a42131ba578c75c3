import json
import os
import random
import sqlite3
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing

import pytest
from blake3 import blake3
from hypothesis import given
from hypothesis import strategies as st

from bagassets.base.errors import ChangedWhileReadError, RecordingError, StoreError
from bagassets.recordings import digest as module
from bagassets.recordings import digest_record
from bagassets.recordings.digest import (
    HashedAlong,
    RecordingStat,
    assert_unchanged,
    hash_file,
    recording_digest,
    recording_stat,
    stored_digest,
)
from bagassets.recordings.digest_record import ATTRIBUTE, DigestIndex, is_unchanged, put_on_record
from bagassets.recordings.discover import find_one
from bagassets.store import canonical
from bagassets.store.canonical import digest_bytes, digest_file, digest_json
from bagassets_tests.file_clock import next_tick


@pytest.fixture
def bag(tmp_path):
    path = tmp_path / "bags" / "a.bag"
    path.parent.mkdir()
    path.write_bytes(b"content")
    return find_one(path)


@pytest.fixture
def no_attributes(monkeypatch):
    def refuse(*args):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(os, "setxattr", refuse)
    monkeypatch.setattr(os, "getxattr", refuse)


def attributes_work(path):
    try:
        os.setxattr(path, "user.bagassets.test", b"1")
    except OSError:
        return False
    return True


@pytest.fixture
def attributes(monkeypatch):
    """Extended attributes in memory: not every file system of a test run has them."""
    kept = {}

    def get(path, name):
        try:
            return kept[str(path), name]
        except KeyError:
            raise OSError(61, "No data available") from None

    def put(path, name, value):
        kept[str(path), name] = value
        stat = os.stat(path)
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))  # changes ctime, as a real one does

    monkeypatch.setattr(os, "getxattr", get)
    monkeypatch.setattr(os, "setxattr", put)
    return kept


def rewrite_in_place(path, content):
    """Write other content of the same length and put the modification time back."""
    stat = path.stat()
    next_tick()
    path.write_bytes(content)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def test_digest_of_a_file_is_blake3_of_its_content(bag, attributes):
    result = recording_digest(bag)
    assert result.digest == blake3(b"content").hexdigest()
    assert (result.size, result.hashed_bytes, result.files) == (7, 7, {"a.bag": result.digest})


def test_digest_of_a_folder_does_not_hang_on_its_place(tmp_path, attributes):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "metadata.yaml").write_bytes(b"m")
        (tmp_path / name / "d_0.db3").write_bytes(b"d")
    one, two = (recording_digest(find_one(tmp_path / name)) for name in ("one", "two"))
    files = {"d_0.db3": blake3(b"d").hexdigest(), "metadata.yaml": blake3(b"m").hexdigest()}
    assert one.digest == two.digest == digest_json(sorted([list(pair) for pair in files.items()]))
    assert one.files == files


def test_the_attribute_is_trusted_while_size_and_time_match(bag, attributes):
    assert stored_digest(bag) is None
    digest = recording_digest(bag).digest
    record = json.loads(attributes[str(bag.path), ATTRIBUTE])
    before, written = record.pop("ctime_ns"), record.pop("written_ns")
    assert record == {"digest": digest, "size": 7, "mtime_ns": bag.mtime_ns}
    assert 0 <= written - before < 60e9
    assert stored_digest(bag) == digest
    assert recording_digest(bag).hashed_bytes == 0
    bag.path.write_bytes(b"CONTENT")
    os.utime(bag.path, ns=(0, bag.mtime_ns + 1))
    assert stored_digest(bag) is None
    assert recording_digest(bag).digest == blake3(b"CONTENT").hexdigest()


@pytest.mark.parametrize(
    "record", [b"", b"\xff", b"[]", b"7", b"{}", b'{"digest": "abc", "size": 7}', b'{"digest": 5, "size": 7}']
)
def test_a_strange_attribute_is_no_digest(bag, attributes, record):
    try:
        value = json.loads(record) | {"mtime_ns": bag.mtime_ns}
        attributes[str(bag.path), ATTRIBUTE] = json.dumps(value).encode()
    except (ValueError, TypeError):
        attributes[str(bag.path), ATTRIBUTE] = record
    assert stored_digest(bag) is None
    assert recording_digest(bag).digest == blake3(b"content").hexdigest()


def test_a_real_attribute(bag):
    if not attributes_work(bag.path):
        pytest.skip("this file system has no extended attributes")
    digest = recording_digest(bag).digest
    assert stored_digest(bag) == digest
    assert bag.path.stat().st_mtime_ns == bag.mtime_ns


def test_the_index_stands_in(bag, tmp_path, no_attributes):
    index = DigestIndex(tmp_path / "store")
    assert stored_digest(bag, index) is None
    assert not (tmp_path / "store").exists()
    digest = recording_digest(bag, index).digest
    assert stored_digest(bag, index) == digest
    assert stored_digest(bag) is None
    assert recording_digest(bag, DigestIndex(tmp_path / "store")).hashed_bytes == 0


def test_a_recipe_may_keep_builds_from_writing_to_recordings(bag, tmp_path, attributes):
    index = DigestIndex(tmp_path / "store", writes_attributes=False)
    made = recording_digest(bag, index)
    assert made.kept == {"a.bag": "index"}
    assert stored_digest(bag) is None
    assert stored_digest(bag, index) == made.digest


def test_an_attribute_of_others_counts_where_none_is_written(bag, tmp_path, attributes):
    recording_digest(bag)
    index = DigestIndex(tmp_path / "store", writes_attributes=False)
    assert recording_digest(bag, index).hashed_bytes == 0


def test_the_index_sees_what_size_and_time_do_not_show(bag, tmp_path, no_attributes):
    index = DigestIndex(tmp_path / "store")
    recording_digest(bag, index)
    rewrite_in_place(bag.path, b"CONTENT")
    assert bag.path.stat().st_mtime_ns == bag.mtime_ns
    assert stored_digest(bag, index) is None
    assert recording_digest(bag, index).digest == blake3(b"CONTENT").hexdigest()


@pytest.mark.parametrize("number", [7, 2**64 - 1])
def test_a_file_whose_inode_has_another_number_is_known(bag, tmp_path, no_attributes, number):
    """As on file systems in user space, whose numbers change whenever the kernel has forgotten a file, or have 64 bits."""
    index, now = DigestIndex(tmp_path / "store"), bag.path.stat()
    fields = list(now)
    fields[1] = number
    other = os.stat_result(fields, {name: getattr(now, name) for name in ("st_mtime_ns", "st_ctime_ns")})
    digest = recording_digest(bag).digest
    put_on_record(bag.path, other, digest, index)
    assert (stored_digest(bag, index), index.suspects_edit(bag.path, now)) == (digest, False)
    assert is_unchanged(bag.path, other, now)


def test_an_index_of_before_with_inodes_goes_on(bag, tmp_path, no_attributes):
    folder, now = tmp_path / "store", bag.path.stat()
    folder.mkdir()
    with closing(sqlite3.connect(folder / "digests.sqlite")) as connection, connection:
        columns = "size INTEGER, mtime_ns INTEGER, inode INTEGER, ctime_ns INTEGER, digest TEXT"
        connection.execute(f"CREATE TABLE digests (path TEXT PRIMARY KEY, {columns})")
        row = str(bag.path), now.st_size, now.st_mtime_ns, now.st_ino, now.st_ctime_ns, "0" * 64
        connection.execute("INSERT INTO digests VALUES (?, ?, ?, ?, ?, ?)", row)
    assert stored_digest(bag, DigestIndex(folder)) == "0" * 64
    DigestIndex(folder).put(bag.path, now, "1" * 64)
    assert stored_digest(bag, DigestIndex(folder)) == "1" * 64


def test_an_edit_in_place_is_seen_although_the_attribute_seems_to_hold(bag, tmp_path, attributes):
    index = DigestIndex(tmp_path / "store")
    recording_digest(bag, index)
    rewrite_in_place(bag.path, b"CONTENT")
    assert stored_digest(bag) == blake3(b"content").hexdigest()  # who sees it for the first time cannot know
    assert stored_digest(bag, index) is None
    assert recording_digest(bag, index).digest == blake3(b"CONTENT").hexdigest()
    assert stored_digest(bag) == stored_digest(bag, index) == blake3(b"CONTENT").hexdigest()


def test_an_attribute_of_the_server_is_noted_in_the_index_on_first_use(bag, tmp_path, attributes):
    server = recording_digest(bag).digest
    index = DigestIndex(tmp_path / "store")
    assert stored_digest(bag, index) == server
    assert recording_digest(bag, index).hashed_bytes == 0
    bag.path.chmod(0o600)
    assert stored_digest(bag, index) is None
    assert recording_digest(bag, index).hashed_bytes == 7
    assert stored_digest(bag, index) == server


@pytest.fixture
def known(bag, tmp_path):
    """An index that knows a file without an attribute, on a file system that has attributes."""
    index = DigestIndex(tmp_path / "store", writes_attributes=False)
    recording_digest(bag, index)
    if recording_digest(bag).kept == {"a.bag": "nowhere"}:
        pytest.skip("this file system has no extended attributes")
    return index


def test_an_attribute_that_others_write_later_raises_no_doubt(bag, known):
    assert bag.path.stat().st_ctime_ns != known.row(bag.path).ctime_ns
    assert not known.suspects_edit(bag.path, bag.path.stat())
    assert recording_digest(bag, known).hashed_bytes == 0


def test_an_edit_after_such_an_attribute_is_seen(bag, known):
    time.sleep(0.1)
    rewrite_in_place(bag.path, b"CONTENT")
    assert known.suspects_edit(bag.path, bag.path.stat())
    assert stored_digest(bag, known) is None


def test_an_edit_before_such_an_attribute_is_seen(bag, known):
    os.removexattr(bag.path, digest_record.ATTRIBUTE)
    known.put(bag.path, bag.path.stat(), recording_digest(bag).digest)
    os.removexattr(bag.path, digest_record.ATTRIBUTE)
    time.sleep(0.1)
    rewrite_in_place(bag.path, b"CONTENT")
    assert recording_digest(bag).kept == {"a.bag": "attribute"}
    assert stored_digest(bag, known) is None
    assert recording_digest(bag, known).digest == blake3(b"CONTENT").hexdigest()


@pytest.mark.parametrize("clock_s", [-5.0, 5.0, None])
def test_an_attribute_written_by_another_clock_explains_nothing(bag, known, clock_s):
    record = json.loads(os.getxattr(bag.path, digest_record.ATTRIBUTE))
    written_ns = record.pop("written_ns")
    record |= {} if clock_s is None else {"written_ns": written_ns + int(clock_s * 1e9)}
    os.setxattr(bag.path, digest_record.ATTRIBUTE, json.dumps(record).encode())
    assert stored_digest(bag, known) is None


def test_an_edit_in_place_while_a_file_is_hashed_is_seen(bag, tmp_path, attributes):
    index = DigestIndex(tmp_path / "store")
    with pytest.raises(ChangedWhileReadError, match=r"a\.bag: the file changed while it was hashed"):
        recording_digest(bag, index, between=lambda _: rewrite_in_place(bag.path, b"CONTENT"))
    assert stored_digest(bag, index) is None
    assert recording_digest(bag, index).digest == blake3(b"CONTENT").hexdigest()


def test_an_attribute_that_another_writes_while_a_file_is_hashed_is_no_change(bag, tmp_path, attributes):
    index = DigestIndex(tmp_path / "store")
    digest = recording_digest(bag, index, between=lambda _: recording_digest(bag)).digest
    assert digest == blake3(b"content").hexdigest()
    assert stored_digest(bag, index) == digest


def test_an_edit_in_place_before_its_digest_is_recorded_is_seen_later(bag, tmp_path, attributes):
    index, stat = DigestIndex(tmp_path / "store"), bag.path.stat()
    digest = hash_file(bag.path, stat)
    rewrite_in_place(bag.path, b"CONTENT")
    assert digest_record.put_on_record(bag.path, stat, digest, index)[0] == "index"
    assert (stored_digest(bag, index), stored_digest(bag)) == (None, None)


def test_an_attribute_that_holds_for_the_size_and_time_only_does_not_enter_the_index(
    bag, tmp_path, attributes
):
    stat = bag.path.stat()
    digest = recording_digest(bag).digest
    time.sleep(0.1)
    rewrite_in_place(bag.path, b"CONTENT")
    index = DigestIndex(tmp_path / "store")
    assert digest_record.put_on_record(bag.path, stat, digest, index)[0] == "attribute"
    assert index.row(bag.path) is None


def test_an_edit_in_place_while_a_recording_is_read_is_seen(bag, tmp_path, attributes):
    digest = recording_digest(bag, DigestIndex(tmp_path / "store"))
    stat = recording_stat(bag).as_of(digest)
    assert_unchanged(bag, stat)
    rewrite_in_place(bag.path, b"CONTENT")
    with pytest.raises(ChangedWhileReadError, match="changed while it was read"):
        assert_unchanged(bag, stat)
    assert_unchanged(bag, RecordingStat.from_json(stat.as_json()))  # which knows no more than sizes and times


def test_recording_a_digest_while_a_recording_is_read_is_no_change(bag, tmp_path, attributes):
    stat = recording_stat(bag)
    recording_digest(bag, DigestIndex(tmp_path / "store"))
    assert_unchanged(bag, stat)


def test_where_two_builds_record_a_digest_at_nearly_one_moment_the_content_decides(
    bag, tmp_path, attributes, monkeypatch
):
    stat = recording_stat(bag).as_of(recording_digest(bag, DigestIndex(tmp_path / "store")))
    hashed = []
    monkeypatch.setattr(
        module, "digest_file", lambda path, _between: hashed.append(path) or digest_file(path)
    )
    for _ in range(2):
        next_tick()
        os.setxattr(bag.path, ATTRIBUTE, b"that of a build whose clock is not that of the file server")
        assert_unchanged(bag, stat)
        assert_unchanged(bag, stat)
    assert hashed == [bag.path] * 2  # once for each change
    rewrite_in_place(bag.path, b"CONTENT")
    with pytest.raises(ChangedWhileReadError, match="changed while it was read"):
        assert_unchanged(bag, stat)


def test_a_digest_that_another_build_records_while_a_file_is_hashed_is_no_change(
    bag, attributes, monkeypatch
):
    def hash_beside_another(path, between):
        if not hashed:
            next_tick()
            os.setxattr(path, ATTRIBUTE, b"that of a build whose clock is not that of the file server")
        hashed.append(path)
        return digest_file(path)

    hashed = []
    monkeypatch.setattr(module, "digest_file", hash_beside_another)
    assert recording_digest(bag).digest == digest_bytes(b"content")
    assert hashed == [bag.path] * 2


def test_where_digests_are_kept(bag, tmp_path, attributes, monkeypatch):
    index = DigestIndex(tmp_path / "store")
    assert recording_digest(bag).kept == {"a.bag": "attribute"}
    attributes.clear()

    def refuse(*args):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "setxattr", refuse)
    assert recording_digest(bag).kept == {"a.bag": "nowhere"}
    assert recording_digest(bag, index).kept == {"a.bag": "index"}
    assert recording_digest(bag, index).kept == {"a.bag": "index"}


def test_rehashing_finds_what_no_record_shows(bag, attributes):
    recording_digest(bag)
    rewrite_in_place(bag.path, b"CONTENT")
    assert recording_digest(bag).digest == blake3(b"content").hexdigest()
    assert recording_digest(bag, rehash=True).digest == blake3(b"CONTENT").hexdigest()
    assert recording_digest(bag).digest == blake3(b"CONTENT").hexdigest()


def test_hashing_waits_until_a_later_write_shows(bag):
    stat = bag.path.stat()
    os.utime(bag.path, ns=(0, time.time_ns()))
    stat = bag.path.stat()
    hash_file(bag.path, stat)
    assert time.time_ns() - stat.st_mtime_ns >= 20_000_000


def test_hashing_can_be_stopped(tmp_path):
    path = tmp_path / "a.bag"
    path.write_bytes(b"x" * (9 << 20))
    calls = []

    def stop(read):
        calls.append(read)
        if len(calls) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        hash_file(path, path.stat(), stop)
    assert calls == [1 << 20, 1 << 20]


def test_a_truncated_file_does_not_kill_the_process(tmp_path):
    path = tmp_path / "a.bag"
    path.write_bytes(b"x" * (9 << 20))
    stat = path.stat()
    with pytest.raises(ChangedWhileReadError):
        hash_file(path, stat, lambda _read: os.truncate(path, 0))


def test_the_index_is_read_once_and_again_when_another_process_wrote(bag, tmp_path, no_attributes):
    ours, theirs = DigestIndex(tmp_path / "store"), DigestIndex(tmp_path / "store")
    assert ours.row(bag.path) is None
    theirs.put(bag.path, bag.path.stat(), "1" * 64)
    assert ours.get(bag.path, bag.path.stat()) == "1" * 64
    next_tick()
    theirs.put(bag.path, bag.path.stat(), "2" * 64)
    assert ours.get(bag.path, bag.path.stat()) == "2" * 64
    (tmp_path / "store" / "digests.sqlite").unlink()
    assert ours.row(bag.path) is None
    ours.put(bag.path, bag.path.stat(), "3" * 64)
    assert theirs.get(bag.path, bag.path.stat()) == "3" * 64


def test_the_index_holds_for_the_file_that_was_hashed(bag, tmp_path, no_attributes, monkeypatch):
    index = DigestIndex(tmp_path / "store")
    monkeypatch.setattr(
        digest_record, "_write_attribute", lambda path, *args: path.write_bytes(b"longer content") == 0
    )
    recording_digest(bag, index)
    assert stored_digest(bag, index) is None


def test_a_damaged_index(bag, tmp_path, no_attributes):
    (tmp_path / "digests.sqlite").write_bytes(
        b"this is no database, and long enough to be mistaken for one" * 20
    )
    assert stored_digest(bag, DigestIndex(tmp_path)) is None
    digest = recording_digest(bag, DigestIndex(tmp_path)).digest
    assert stored_digest(bag, DigestIndex(tmp_path)) == digest


@pytest.mark.parametrize("how", ["of a later SQLite", "with other columns", "with a name that is no text"])
def test_a_database_that_cannot_be_the_index_is_replaced(bag, tmp_path, no_attributes, how):
    index = tmp_path / "digests.sqlite"
    with sqlite3.connect(index) as connection:
        connection.execute("CREATE TABLE digests (path TEXT, other TEXT)")
    if how == "of a later SQLite":
        data = index.read_bytes()
        index.write_bytes(data[:18] + b"\x09\x09" + data[20:])
    elif how == "with a name that is no text":
        data = index.read_bytes().replace(b"CREATE TABLE", b"CREATE TALBE").replace(b"digests", b"dige\x91ts")
        index.write_bytes(data)
        with pytest.raises(UnicodeDecodeError), sqlite3.connect(index) as connection:
            connection.execute("SELECT * FROM digests")
    digest = recording_digest(bag, DigestIndex(tmp_path)).digest
    assert stored_digest(bag, DigestIndex(tmp_path)) == digest


def test_an_index_that_cannot_be_written(bag, tmp_path, no_attributes):
    (tmp_path / "state").write_text("a file where the folder should be")
    with pytest.raises(StoreError, match="index of digests cannot be written"):
        recording_digest(bag, DigestIndex(tmp_path / "state"))


def test_an_index_without_table_yet(bag, tmp_path, no_attributes):
    sqlite3.connect(tmp_path / "digests.sqlite").close()
    (tmp_path / "digests.sqlite").touch()
    assert stored_digest(bag, DigestIndex(tmp_path)) is None


def fill(folder, names):
    for name in names:
        DigestIndex(folder).put(folder / name, (folder / name).stat(), "0" * 64)


def test_the_index_is_safe_for_several_processes(tmp_path):
    names = [f"{i}.bag" for i in range(40)]
    for name in names:
        (tmp_path / name).touch()
    with ProcessPoolExecutor(4) as pool:
        list(pool.map(fill, [tmp_path] * 4, [names[i::4] for i in range(4)]))
    index = DigestIndex(tmp_path)
    assert all(index.get(tmp_path / name, (tmp_path / name).stat()) == "0" * 64 for name in names)


@pytest.mark.parametrize("change", ["grow", "replace"])
def test_a_file_that_changes_while_it_is_hashed(bag, attributes, monkeypatch, change):
    def hash_and_change(path, between):
        next_tick()
        if change == "grow":
            path.write_bytes(b"content and more")
        else:
            other = path.with_name("other")
            other.write_bytes(b"CONTENT")
            os.utime(other, ns=(0, bag.mtime_ns))
            other.replace(path)
        return "0" * 64

    monkeypatch.setattr(module, "digest_file", hash_and_change)
    with pytest.raises(ChangedWhileReadError, match="changed while it was hashed"):
        recording_digest(bag)
    assert attributes == {}


def test_stat(bag):
    stat = recording_stat(bag)
    assert stat.files == (("a.bag", 7, bag.mtime_ns),)
    assert RecordingStat.from_json(json.loads(json.dumps(stat.as_json()))) == stat
    assert_unchanged(bag, stat)
    bag.path.write_bytes(b"longer content")
    with pytest.raises(ChangedWhileReadError, match="changed while it was read"):
        assert_unchanged(bag, stat)


def test_a_file_that_is_gone(bag):
    bag.path.unlink()
    for read in (recording_stat, recording_digest, stored_digest):
        with pytest.raises(RecordingError, match="was it removed"):
            read(bag)


def test_an_empty_file_has_a_digest(tmp_path, attributes):
    (tmp_path / "a.bag").touch()
    assert recording_digest(find_one(tmp_path / "a.bag")).digest == blake3(b"").hexdigest()


@given(st.integers(0, 3000), st.lists(st.tuples(st.booleans(), st.integers(0, 3500), st.integers(0, 900))))
def test_a_file_is_hashed_in_whichever_order_it_is_followed(tmp_path_factory, size, told):
    path = tmp_path_factory.mktemp("followed") / "a.bag"
    path.write_bytes(content := random.Random(size).randbytes(size))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(canonical, "_READ_BYTES", 100)
        hasher = canonical.FileHasher(path)
    with closing(hasher):
        for at_hand, begin, length in told:
            if at_hand:
                data = content[begin : begin + length]
                hasher.follow(begin + len(data), data)
            else:
                hasher.follow(begin)
        assert hasher.position <= size
        assert hasher.finish() == digest_bytes(content)


def test_a_reader_is_not_far_ahead_even_of_a_thread_that_has_hashed_nothing_yet(
    bag, no_attributes, monkeypatch
):
    """A busy machine may start the thread late; the bound held from its first block on only."""
    monkeypatch.setattr(module, "_MOST_BEHIND_BYTES", 3)
    may_start, submitted = threading.Event(), ThreadPoolExecutor.submit

    def submit(self, hash_, *args):
        submitted(self, may_start.wait, 30)
        return submitted(self, hash_, *args)

    monkeypatch.setattr(ThreadPoolExecutor, "submit", submit)
    monkeypatch.setattr(module, "_FOLLOW_BYTES", 1)
    with HashedAlong(bag) as hashed:
        hashed.follow(bag.path, 3, b"")
        threading.Timer(0.2, may_start.set).start()
        hashed.follow(bag.path, 4, b"")
        assert may_start.is_set()
        assert hashed.finish().digest == recording_digest(bag).digest


def test_bytes_that_are_handed_over_are_not_read_again(tmp_path):
    path = tmp_path / "a.bag"
    path.write_bytes(bytes(1 << 20))
    with closing(canonical.FileHasher(path)) as hasher:
        hasher.follow(1000 + (1 << 19), b"x" * (1 << 19))
        assert hasher.finish() == digest_bytes(bytes(1000) + b"x" * (1 << 19) + bytes((1 << 19) - 1000))
