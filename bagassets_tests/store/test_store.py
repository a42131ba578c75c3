"""The store: one value has one text, immutable artifacts by content, first writer wins, nothing half-made."""

import errno
import json
import math
import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
from blake3 import blake3
from hypothesis import given
from hypothesis import strategies as st

from bagassets.base import files
from bagassets.base.errors import BagAssetsError, DecodeError, StoreError
from bagassets.engine.freshness.artifacts import note_of
from bagassets.engine.run_action import run_action
from bagassets.store.action import Action, Step
from bagassets.store.canonical import canonical_json, digest_bytes, digest_file, digest_json
from bagassets.store.identity import id_of_store, identify
from bagassets.store.integrity import artifact_damage
from bagassets.store.lease import HOLDERS, action_lock, in_use
from bagassets.store.store import Store
from bagassets_tests.store_check import check_store

pytestmark = pytest.mark.once

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "store")


def write(name, data):
    def make(out):
        out.write(name, data)
        return {"bytes": len(data)}

    return make


def action_of(name="step", **params):
    return Step(name, 1).action(params, {"topic:/x": "0" * 64})


class TestCanonical:
    @given(JSON)
    def test_a_value_comes_back(self, value):
        assert json.loads(canonical_json(value)) == value

    @given(st.dictionaries(st.text(), JSON, min_size=2))
    def test_order_makes_no_difference(self, value):
        turned = dict(reversed(list(value.items())))
        assert canonical_json(turned) == canonical_json(value)
        assert digest_json(turned) == digest_json(value)

    @given(JSON, JSON)
    def test_different_values_have_different_texts(self, one, other):
        if canonical_json(one) == canonical_json(other):
            assert one == other

    @pytest.mark.parametrize("value", [math.nan, math.inf, {"a": [-math.inf]}])
    def test_numbers_are_finite(self, value):
        with pytest.raises(ValueError, match="not JSON compliant"):
            canonical_json(value)

    @given(st.binary(max_size=10_000))
    def test_a_file_has_the_digest_of_its_bytes(self, data):
        path = Path(os.environ.get("TMPDIR", "/tmp")) / f"bagassets-test-{os.getpid()}"
        path.write_bytes(data)
        try:
            assert digest_file(path) == digest_bytes(data)
        finally:
            path.unlink()


class TestActions:
    def test_everything_about_an_action_is_in_its_digest(self):
        base = Action("a", 1, {"cv2": "4"}, {"q": 90}, {"bag": "x"})
        others = [
            Action("b", 1, {"cv2": "4"}, {"q": 90}, {"bag": "x"}),
            Action("a", 2, {"cv2": "4"}, {"q": 90}, {"bag": "x"}),
            Action("a", 1, {"cv2": "5"}, {"q": 90}, {"bag": "x"}),
            Action("a", 1, {"cv2": "4"}, {"q": 91}, {"bag": "x"}),
            Action("a", 1, {"cv2": "4"}, {"q": 90}, {"bag": "y"}),
            Action("a", 1, {"cv2": "4"}, {"q": 90}, {"gab": "x"}),
        ]
        assert len({action.digest for action in (base, *others)}) == 7
        assert Action("a", 1, {"cv2": "4"}, {"q": 90}, {"bag": "x"}).digest == base.digest

    def test_the_form_of_an_action_never_changes(self):
        """With another form every artifact of every store would be made again."""
        action = Action("frames", 3, {"cv2": "4.10"}, {"q": 90}, {"topic:/x": "00"})
        text = b'{"inputs":{"topic:/x":"00"},"libraries":{"cv2":"4.10"},"params":{"q":90},"step":"frames","version":3}'
        assert canonical_json(action.as_json()) == text
        assert action.digest == blake3(text).hexdigest()

    def test_a_step_names_the_versions_of_its_libraries(self):
        assert Step("a", 1, ("numpy",)).action({}, {}).libraries["numpy"].count(".") >= 1


class TestArtifacts:
    def test_making_the_same_again_does_not_change_an_artifact(self, store):
        (made, before), (same, after) = (
            (
                one.artifact,
                note_of(str(store.root / "artifacts"), [one.artifact.digest]),
            )
            for one in (run_action(store, action_of(q=number), write("a", b"data")) for number in (1, 2))
        )
        assert made == same
        assert after == before

    def test_the_same_files_are_the_same_artifact_whatever_made_them(self, store):
        one = run_action(store, action_of(q=1), write("a/b.txt", b"data"))
        other = run_action(store, action_of(q=2), write("a/b.txt", b"data"))
        assert one.artifact == other.artifact
        assert one.action_digest != other.action_digest
        assert (one.cached, other.cached) == (False, False)
        assert artifact_damage(one.artifact) == []

    def test_name_content_and_summary_are_in_the_digest(self, store):
        made = {
            run_action(store, action_of(q=number), make).artifact.digest
            for number, make in enumerate(
                [write("a", b"x"), write("b", b"x"), write("a", b"y"), lambda out: {}]
            )
        }
        assert len(made) == 4

    def test_order_of_writing_makes_no_difference(self, store):
        def in_order(names):
            def make(out):
                for name in names:
                    out.write(name, name.encode())
                return {}

            return make

        one = run_action(store, action_of(q=1), in_order("abc"))
        assert run_action(store, action_of(q=2), in_order("cab")).artifact == one.artifact

    def test_what_was_written_can_be_read(self, store):
        table = pa.table({"stamp_ns": [1, 2], "file": ["a", "b"]})

        def make(out):
            out.write_table("t.parquet", table)
            out.write_json("j.json", {"b": 1, "a": [0.5, None]})
            return {"rows": 2}

        artifact = run_action(store, action_of(), make).artifact
        assert artifact.read_table("t.parquet").equals(table)
        assert artifact.read_table("t.parquet", ["file"]).column_names == ["file"]
        assert artifact.read_json("j.json") == {"a": [0.5, None], "b": 1}
        assert artifact.summary() == {"rows": 2}
        assert [entry.path for entry in artifact.entries()] == ["j.json", "t.parquet"]

    def test_its_files_are_read_only_and_its_folders_can_be_walked(self, store):
        artifact = run_action(store, action_of(), write("a/b.txt", b"data")).artifact
        assert artifact.path("a/b.txt").stat().st_mode & 0o777 == 0o444
        assert artifact.folder.stat().st_mode & 0o777 == 0o755
        assert artifact.files.stat().st_mode & 0o777 == 0o755

    def test_json_is_sorted_and_ends_with_a_line(self, store):
        def make(out):
            out.write_json("j.json", {"b": "ü", "a": [1]})
            out.write_json("flat.json", {"b": 1, "a": [1]}, indent=None)
            with pytest.raises(ValueError, match="not JSON compliant"):
                out.write_json("nan.json", math.nan)
            return {}

        artifact = run_action(store, action_of(), make).artifact
        assert artifact.path("j.json").read_text("utf-8") == '{\n "a": [\n  1\n ],\n "b": "ü"\n}\n'
        assert artifact.path("flat.json").read_text() == '{"a": [1], "b": 1}\n'

    def test_the_manifest_names_each_file_with_size_and_digest(self, store):
        artifact = run_action(store, action_of(), write("a", b"data")).artifact
        assert artifact.manifest() == {
            "files": [{"path": "a", "size": 4, "digest": digest_bytes(b"data")}], "summary": {"bytes": 4},
        }  # fmt: skip
        assert artifact.digest == digest_bytes((artifact.folder / "manifest.json").read_bytes())

    def test_a_name_is_written_once(self, store):
        def make(out):
            out.write("a", b"1")
            out.write("a", b"2")

        with pytest.raises(StoreError, match="written twice"):
            run_action(store, action_of(), make)

    @pytest.mark.parametrize("read", ["read_json", "read_table"])
    def test_a_damaged_file_is_reported_with_what_to_do(self, store, read):
        artifact = run_action(store, action_of(), write("file", b"{")).artifact
        with pytest.raises(
            StoreError, match=r"file: this file of the store is gone or damaged .*bagassets verify"
        ):
            getattr(artifact, read)("file")
        with pytest.raises(StoreError, match="gone or damaged"):
            getattr(artifact, read)("none")

    @pytest.mark.parametrize("read", ["read_json", "manifest"])
    def test_a_disk_that_fails_is_not_said_to_have_damaged_a_file(self, store, monkeypatch, read):
        artifact = run_action(store, action_of(), write("file", b"{}")).artifact

        def failing(_path):
            raise OSError(errno.EIO, "Input/output error")

        monkeypatch.setattr(Path, "read_bytes", failing)
        with pytest.raises(
            StoreError, match=r"cannot be read \(.*; check the disk or file server, and try again\.$"
        ):
            getattr(artifact, read)(*["file"] * (read == "read_json"))

    def test_many_threads_may_write(self, store):
        def make(out):
            threads = [
                threading.Thread(target=lambda i=i: [out.write(f"{i}/{j}", b"x" * j) for j in range(50)])
                for i in range(8)
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            return {}

        artifact = run_action(store, action_of(), make).artifact
        assert len(artifact.entries()) == 400
        assert artifact_damage(artifact) == []

    def test_one_that_is_not_there_is_reported(self, store):
        with pytest.raises(StoreError, match="materialize the asset that makes it again"):
            store.artifact("0" * 64)


class TestRuns:
    def test_what_is_on_record_of_an_action(self, store):
        outcome = run_action(store, action_of(q=90), write("a", b"x"))
        (path,) = (store.root / "actions").glob("*/*.json")
        assert path == store.root / "actions" / outcome.action_digest[:2] / f"{outcome.action_digest}.json"
        record = json.loads(path.read_text())
        assert record.pop("seconds") == pytest.approx(outcome.seconds, abs=0.001)
        assert record == {
            "action": action_of(q=90).as_json(), "artifact": outcome.artifact.digest, "host": socket.gethostname(),
        }  # fmt: skip
        assert store.action(outcome.action_digest) == action_of(q=90).as_json()
        store.forget(outcome.action_digest)
        assert store.action(outcome.action_digest) is None
        assert store.lookup(action_of(q=90)) is None

    def test_one_that_is_used_is_marked(self, store):
        outcome = run_action(store, action_of(), write("a", b"x"))
        (path,) = (store.root / "actions").glob("*/*.json")
        os.utime(path, (1000, 1000))
        assert store.lookup(action_of()) == replace(outcome, cached=True, seconds=round(outcome.seconds, 3))
        assert path.stat().st_mtime == 1000
        assert store.use(action_of()).cached
        assert path.stat().st_mtime > time.time() - 60

    def test_one_that_a_collector_removes_meanwhile_is_unknown(self, store, monkeypatch):
        run_action(store, action_of(), write("a", b"x"))
        known = store.lookup(action_of())
        store.forget(action_of().digest)
        monkeypatch.setattr(store, "lookup", lambda _action: known)
        assert store.use(action_of()) is None

    @pytest.mark.parametrize(
        ("error", "reported"),
        [
            ("/bags/a.bag: cut off", "/other/b.bag: cut off"),
            ("/bags/a.bag.json: cut off", "/bags/a.bag.json: cut off"),
            ("/bags/a.bag-2: cut off", "/bags/a.bag-2: cut off"),
            ("/bags/a.bag.", "/other/b.bag."),
            ("it is /bags/a.bag, or /bags/a.bag", "it is /other/b.bag, or /other/b.bag"),
        ],
    )
    def test_an_error_is_reported_for_the_recording_that_asks(self, store, error, reported):
        store.record_failure(action_of(), error, Path("/bags/a.bag"))
        assert store.failure(action_of().digest, Path("/bags/a.bag")) == error
        assert store.failure(action_of().digest, Path("/other/b.bag")) == reported

    def test_the_newest_error_is_kept(self, store):
        for error in ("one", "two"):
            store.record_failure(action_of(), error)
        assert store.failure(action_of().digest) == "two"

    def test_what_is_known_does_not_run(self, store):
        first = run_action(store, action_of(), write("a", b"x"))
        again = run_action(store, action_of(), lambda out: pytest.fail("it ran"))
        assert again.cached
        assert again.artifact == first.artifact
        assert again.seconds == pytest.approx(first.seconds, abs=0.001)

    def test_an_error_is_on_record_until_it_succeeds(self, store):
        def fail(out):
            out.write("half", b"half")
            raise DecodeError("topic /x: bad")

        with pytest.raises(DecodeError):
            run_action(store, action_of(), fail)
        assert store.failure(action_of().digest) == "topic /x: bad"
        assert store.action(action_of().digest) == action_of().as_json()
        assert list((store.root / "tmp").iterdir()) == []
        run_action(store, action_of(), write("a", b"x"))
        assert store.failure(action_of().digest) is None

    @pytest.mark.parametrize("err", [StoreError("disk full"), KeyboardInterrupt(), ValueError("bug")])
    def test_what_says_nothing_about_the_action_is_not_on_record(self, store, err):
        def fail(out):
            raise err

        with pytest.raises(type(err)):
            run_action(store, action_of(), fail)
        assert store.failure(action_of().digest) is None
        assert list((store.root / "tmp").iterdir()) == []

    def test_other_bytes_from_a_second_writer_are_reported(self, store):
        pending = store.begin(action_of())
        run_action(store, action_of(), write("a", b"first"))
        pending.out.write("a", b"second")
        with pytest.raises(StoreError, match="step step is not deterministic"):
            pending.commit({"bytes": 6})
        assert store.lookup(action_of()).artifact.path("a").read_bytes() == b"first"

    def test_the_same_bytes_from_a_second_writer_are_fine(self, store):
        pending = store.begin(action_of())
        first = run_action(store, action_of(), write("a", b"data"))
        pending.out.write("a", b"data")
        assert pending.commit({"bytes": 4}).artifact == first.artifact
        assert list((store.root / "tmp").iterdir()) == []
        assert list(check_store(store)) == []

    def test_a_record_whose_artifact_is_gone_is_worth_nothing(self, store):
        first = run_action(store, action_of(), write("a", b"first"))
        store.remove(first.artifact.digest)
        assert store.lookup(action_of()) is None
        second = run_action(store, action_of(), write("a", b"second"))
        assert store.lookup(action_of()).artifact == second.artifact

    @pytest.mark.parametrize("torn", [b"", b"{", b"{}"])
    def test_a_torn_record_is_worth_nothing(self, store, torn):
        run_action(store, action_of(), write("a", b"x"))
        next((store.root / "actions").glob("*/*.json")).write_bytes(torn)
        assert store.lookup(action_of()) is None
        assert not run_action(store, action_of(), write("a", b"x")).cached
        assert run_action(store, action_of(), write("a", b"x")).cached

    def test_many_at_once_agree(self, store):
        outcomes = []

        def run():
            outcomes.append(run_action(store, action_of(), write("a", b"data")).artifact.digest)

        threads = [threading.Thread(target=run) for _ in range(16)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(outcomes) == 16
        assert len(set(outcomes)) == 1
        assert list(check_store(store)) == []
        assert list((store.root / "tmp").iterdir()) == []


class TestFileSystems:
    def test_one_that_is_damaged_again_and_again_is_not_fought_over_for_ever(self, store, monkeypatch):
        """Another process, or a disk, spoils what is put in place each time."""
        pending = store.begin(action_of())
        pending.out.write("a", b"data")
        digest = pending.out.finish({})
        store.artifact_folder(digest).mkdir(parents=True)
        (store.artifact_folder(digest) / "rubbish").write_bytes(b"")
        removed = []
        monkeypatch.setattr(store, "remove", removed.append)
        with pytest.raises(
            StoreError, match=r"cannot be put in place \(other processes keep writing a damaged one"
        ):
            store.adopt(pending.out._folder, digest)
        assert removed == [digest] * 5

    def test_a_damaged_one_gives_way(self, store):
        outcome = run_action(store, action_of(), write("a", b"data"))
        path = outcome.artifact.path("a")
        path.unlink()
        path.write_bytes(b"dat")
        store.forget(action_of().digest)
        assert run_action(store, action_of(), write("a", b"data")).artifact == outcome.artifact
        assert path.read_bytes() == b"data"

    def test_one_that_is_whole_stays_and_is_marked_as_used(self, store):
        outcome = run_action(store, action_of(), write("a", b"data"))
        folder = outcome.artifact.folder
        os.utime(folder, (1000, 1000))
        os.utime(outcome.artifact.path("a"), (1000, 1000))
        run_action(store, action_of(q=2), write("a", b"data"))
        assert outcome.artifact.path("a").stat().st_mtime == 1000, "its file is the first one"
        assert folder.stat().st_mtime > time.time() - 60

    def test_a_folder_that_cannot_be_made_is_named(self, tmp_path):
        (tmp_path / "store").mkdir()
        (tmp_path / "store" / "tmp").write_bytes(b"a file")
        with pytest.raises(
            StoreError, match=r"store/tmp/.*: the store cannot be written \(Not a directory\)"
        ):
            Store(tmp_path / "store").make_temporary_folder()

    def test_a_manifest_that_cannot_be_read_is_named_with_a_way_out(self, store):
        artifact = run_action(store, action_of(), write("a", b"x")).artifact
        (artifact.folder / "manifest.json").write_bytes(b"{")
        with pytest.raises(
            StoreError, match=r"the manifest of this artifact cannot be read .*build again to heal"
        ):
            artifact.manifest()
        assert not store.is_complete(artifact.digest)

    @pytest.mark.parametrize("content", [b"[]", b"{}", b'{"files": [{}]}', b'{"files": 3}'])
    def test_a_manifest_that_says_something_else_is_damage(self, store, content):
        artifact = run_action(store, action_of(), write("a", b"x")).artifact
        (artifact.folder / "manifest.json").write_bytes(content)
        assert not store.is_complete(artifact.digest)

    def test_an_error_that_is_none_of_hard_links_is_reported(self, store, monkeypatch):
        def refuse(*_args):
            raise OSError(5, "Input/output error")

        monkeypatch.setattr(os, "link", refuse)
        with pytest.raises(StoreError, match="Input/output error"):
            run_action(store, action_of(), write("a", b"x"))

    @pytest.mark.parametrize("number", [1, 13, 31, 38, 95])
    def test_whatever_a_file_system_says_that_has_no_hard_links(self, store, monkeypatch, number):
        """EPERM, EACCES, EMLINK, ENOSYS and EOPNOTSUPP."""

        def refuse(*_args):
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(os, "link", refuse)
        assert not run_action(store, action_of(), write("a", b"x")).cached
        assert run_action(store, action_of(), write("a", b"x")).cached

    def test_without_hard_links(self, store, monkeypatch):
        def refuse(*args):
            raise OSError(1, "Operation not permitted")

        monkeypatch.setattr(os, "link", refuse)
        first = run_action(store, action_of(), write("a", b"x"))
        assert run_action(store, action_of(), write("a", b"x")).cached
        store.record(action_of(), first.artifact, 0.1)
        with pytest.raises(StoreError, match="not deterministic"):
            store.record(action_of(), run_action(store, action_of("other"), write("b", b"y")).artifact, 0.1)
        assert list(check_store(store)) == []

    def test_a_store_that_cannot_be_written(self, tmp_path):
        (tmp_path / "store").write_bytes(b"a file")
        with pytest.raises(StoreError, match=r"the store cannot be read .*check the disk"):
            run_action(Store(tmp_path / "store"), action_of(), write("a", b"x"))

    @pytest.mark.parametrize(("method", "place"), [("write", "actions"), ("write", "tmp"), ("move", "tmp")])
    def test_a_disk_that_fails_late_leaves_nothing(self, store, monkeypatch, method, place):
        real = getattr(files, method)
        refused = []

        def full(path, *args, **options):
            if place in Path(path).parts:
                refused.append(path)
                raise OSError(28, "No space left on device")
            return real(path, *args, **options)

        monkeypatch.setattr(files, method, full)
        with pytest.raises(StoreError, match=r"No space left on device.*free disk space"):
            run_action(store, action_of(), write("a", b"x"))
        assert refused
        monkeypatch.setattr(files, method, real)
        assert list((store.root / "tmp").iterdir()) == []
        assert list(store.root.rglob(".*")) == []
        assert list(check_store(store)) == []
        assert not run_action(store, action_of(), write("a", b"x")).cached

    def test_a_failure_that_cannot_be_recorded_hides_none(self, store, monkeypatch):
        def fail(out):
            monkeypatch.setattr(files, "write", full)
            raise DecodeError("topic /x: bad")

        def full(*args, **options):
            raise OSError(28, "No space left on device")

        with pytest.raises(BagAssetsError, match="topic /x: bad"):
            run_action(store, action_of(), fail)


@pytest.mark.parametrize("torn", [b"", bytes(33), b"0123456789abcdef"])
def test_an_id_that_a_power_loss_tore_is_given_anew_once(tmp_path, torn):
    before = identify(tmp_path)
    (tmp_path / "store.id").write_bytes(torn)
    assert id_of_store(tmp_path) is None
    after = identify(tmp_path)
    assert after not in (None, before)
    assert identify(tmp_path) == id_of_store(tmp_path) == after


@pytest.mark.parametrize("torn", [b"", b"{", b"{}"])
def test_a_record_that_turns_out_to_be_torn_is_replaced(store, torn):
    """Another process was interrupted by a power loss after this one had looked for the record."""
    artifact = run_action(store, action_of("a"), write("a", b"1")).artifact
    next((store.root / "actions").glob("*/*.json")).write_bytes(torn)
    store.record(action_of("a"), artifact, 0.1)
    assert store.lookup(action_of("a")).artifact == artifact


def test_the_first_writer_wins_between_look_and_link(store, monkeypatch):
    """Two processes record the same action at the same time."""
    artifact = run_action(store, action_of("a"), write("a", b"1")).artifact
    real, calls = os.link, []

    def late(temporary, path):
        if not calls:
            calls.append(1)
            path.write_bytes(temporary.read_bytes())
        return real(temporary, path)

    monkeypatch.setattr(os, "link", late)
    store.record(action_of("b"), artifact, 0.1)
    assert calls
    assert store.lookup(action_of("b")).artifact == artifact


# --- an action that another process makes -------------------------------------------------------


def test_who_comes_while_an_action_is_made_waits_for_it(store):
    begun, made = threading.Event(), []

    def make(out):
        made.append(threading.get_ident())
        begun.set()
        assert not waiter.is_set()
        out.write("a", b"1")
        return {}

    waiter, outcomes = threading.Event(), []

    def second():
        begun.wait(30)
        outcomes.append(run_action(store, action_of(), make))
        waiter.set()

    other = threading.Thread(target=second)
    other.start()
    outcomes.append(run_action(store, action_of(), lambda out: (begun.set(), time.sleep(0.3), make(out))[2]))
    other.join(30)
    assert sorted(outcome.cached for outcome in outcomes) == [False, True]
    assert len(made) == 1
    assert list((store.root / "underway").iterdir()) == []


def test_an_action_whose_maker_died_is_made(store):
    script = (
        "import os, sys; from pathlib import Path\n"
        "from bagassets.store.lease import action_lock\n"
        "with action_lock(Path(sys.argv[1]), sys.argv[2]):\n"
        "    os._exit(0)\n"
    )
    command = [sys.executable, "-c", script, str(store.root), action_of().digest]
    subprocess.run(command, check=True)
    assert (store.root / "underway" / f"{action_of().digest}.lock").exists()
    assert not run_action(store, action_of(), write("a", b"1")).cached


def test_locks_are_names_of_the_one_lease_of_a_process(store):
    with in_use(store.root), action_lock(store.root, "a"), action_lock(store.root, "b"), in_use(store.root):
        (lease,) = (store.root / "leases").iterdir()
        locks = list((store.root / "underway").iterdir())
        assert {lock.name for lock in locks} == {"a.lock", "b.lock"}
        assert all(lock.samefile(lease) for lock in locks)
    assert not any([*(store.root / "leases").iterdir(), *(store.root / "underway").iterdir()])


@contextmanager
def holder_of_a_lock(store, script):
    """Run a script in a process of its own, which says when it holds a lock; it gets the store, and goes on by lines."""
    command = [sys.executable, "-c", script, str(store.root)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        yield other


def test_nobody_waits_for_a_process_that_is_done_with_an_action_and_goes_on(store):
    script = (
        "import sys; from pathlib import Path\n"
        "from bagassets.store.lease import action_lock, in_use\n"
        "with in_use(Path(sys.argv[1])):\n"
        "    with action_lock(Path(sys.argv[1]), 'a'):\n"
        "        print('held', flush=True); sys.stdin.readline()\n"
        "    print('left', flush=True); sys.stdin.readline()\n"
    )
    with holder_of_a_lock(store, script) as other:
        got = []

        def wait():
            with action_lock(store.root, "a"):
                got.append((store.root / "underway" / "a.lock").stat().st_ino)

        waiting = threading.Thread(target=wait)
        waiting.start()
        waiting.join(0.2)
        assert got == []
        (lease,) = {one.stat().st_ino for one in (store.root / "underway").iterdir()}
        print(file=other.stdin, flush=True)
        assert other.stdout.readline() == "left\n"
        waiting.join(30)
        assert got not in ([], [lease])
        other.communicate("\n")


def test_nobody_waits_for_a_process_whose_run_was_given_up(store, monkeypatch):
    script = (
        "import sys; from pathlib import Path\n"
        "from bagassets.store.lease import HOLDERS, action_lock\n"
        "HOLDERS.name = 'a run'\n"
        "with action_lock(Path(sys.argv[1]), 'a'):\n"
        "    print('held', flush=True); sys.stdin.readline()\n"
    )
    with holder_of_a_lock(store, script) as other:
        asked = []
        monkeypatch.setattr("bagassets.store.lease._LOOK_S", 0.0)
        monkeypatch.setattr(HOLDERS, "has_ended", lambda name: asked.append(name) or len(asked) > 1)
        with action_lock(store.root, "a"):
            assert asked == ["a run", "a run"]
            assert (store.root / "underway" / "a.lock").exists(), "it is the other one's still"
        other.communicate("\n")
    assert list((store.root / "underway").iterdir()) == []


def test_a_failure_is_not_waited_for_twice(store):
    def fail(_out):
        raise DecodeError("no such luck")

    for _ in range(2):
        with pytest.raises(DecodeError):
            run_action(store, action_of(), fail)
    assert list((store.root / "underway").iterdir()) == []
