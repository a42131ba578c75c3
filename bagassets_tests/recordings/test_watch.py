"""The digest service: true digests for all finished recordings, whatever happens meanwhile."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from blake3 import blake3

from bagassets.base.errors import RecordingError
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Bags
from bagassets.recordings import digest
from bagassets.recordings import watch as module
from bagassets.recordings.digest import stored_digest
from bagassets.recordings.digest_record import ATTRIBUTE, DigestIndex
from bagassets.recordings.discover import find_one
from bagassets.recordings.watch import Watcher
from bagassets_tests import in_process
from bagassets_tests.recordings.test_digest import attributes_work, rewrite_in_place

pytestmark = pytest.mark.once


def hex_of(content):
    return blake3(content).hexdigest()


@pytest.fixture
def root(tmp_path):
    (tmp_path / "bags").mkdir()
    return tmp_path / "bags"


@pytest.fixture
def index(tmp_path):
    return DigestIndex(tmp_path / "state")


class Events(list):
    def __call__(self, event):
        self.append(event)

    def hashed(self):
        return [event.path.name for event in self if event.kind == "hashed"]

    def of(self, kind):
        return [event.message for event in self if event.kind == kind]


def refused(*args):
    raise OSError(30, "Read-only file system")


def eventually(holds, seconds=60.0):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it never came about"
        time.sleep(0.02)


def appear(path):
    """Put a whole recording there: one of which a busy machine writes half is hashed twice."""
    beside = path.parent.with_name(f".{path.name}")
    beside.write_bytes(b"content")
    beside.rename(path)


def catch_up(root, index, *, settle_s=0.0, **options):
    events = Events()
    Watcher(Bags(root=root, settle_s=settle_s), index, events).run(once=True, **options)
    return events


@contextmanager
def watching(root, index, *, settle_s=0.2, rescan_s=300.0, ready=True, **options):
    events = Events()
    watcher = Watcher(Bags(root=root, settle_s=settle_s), index, events, rescan_s=rescan_s)
    thread = threading.Thread(target=watcher.run, kwargs=options)
    thread.start()
    try:
        if ready:  # a first file is noticed, so notifications work
            appear(root / "first.bag")
            eventually(lambda: "first.bag" in events.hashed())
            events.clear()
        yield events
    finally:
        watcher.stop()
        thread.join(60)
        assert not thread.is_alive()


class TestCatchingUp:
    def test_what_has_no_digest_is_hashed_and_what_has_one_is_not_read(self, root, index):
        for name in ("a.bag", "b.mcap"):
            (root / name).write_bytes(name.encode())
        (root / "notes.txt").write_bytes(b"no recording")
        assert sorted(catch_up(root, index).hashed()) == ["a.bag", "b.mcap"]
        assert stored_digest(find_one(root / "a.bag"), index) == hex_of(b"a.bag")
        assert catch_up(root, index) == []
        (root / "a.bag").write_bytes(b"other content")
        assert catch_up(root, index).hashed() == ["a.bag"]
        assert stored_digest(find_one(root / "a.bag"), index) == hex_of(b"other content")

    def test_an_attribute_of_another_size_or_time_is_not_trusted(self, root):
        path = root / "a.bag"
        path.write_bytes(b"content")
        try:
            record = {"digest": "0" * 64, "size": 7, "mtime_ns": path.stat().st_mtime_ns - 1}
            os.setxattr(path, ATTRIBUTE, json.dumps(record).encode())
        except OSError:
            pytest.skip("this file system has no extended attributes")
        assert catch_up(root, None).hashed() == ["a.bag"]
        assert stored_digest(find_one(path)) == hex_of(b"content")

    def test_what_is_still_being_written_waits(self, root, index):
        (root / "a.bag").write_bytes(b"content")
        assert catch_up(root, index, settle_s=60.0) == []
        assert stored_digest(find_one(root / "a.bag"), index) is None

    def test_a_ros2_bag_is_finished_when_it_has_its_metadata(self, root, index):
        (root / "drive").mkdir()
        (root / "drive" / "d_0.mcap.active").write_bytes(b"d")
        assert catch_up(root, index).hashed() == []
        (root / "drive" / "d_0.mcap.active").rename(root / "drive" / "d_0.mcap")
        (root / "drive" / "metadata.yaml").write_bytes(b"m")
        assert catch_up(root, index).hashed() == ["d_0.mcap", "metadata.yaml"]
        assert stored_digest(find_one(root / "drive"), index) is not None

    def test_verify_reports_and_corrects_every_record_that_is_wrong(self, root, index, tmp_path):
        for name in ("a.bag", "b.bag", "c.bag"):
            (root / name).write_bytes(b"content")
        catch_up(root, index)
        for name in ("a.bag", "c.bag"):
            rewrite_in_place(root / name, b"CONTENT")
        fresh = DigestIndex(tmp_path / "other")  # nothing but attributes to go by
        for name in ("a.bag", "b.bag", "c.bag"):
            fresh.put(root / name, (root / name).stat(), hex_of(b"content"))
        found = catch_up(root, fresh, verify=True)
        assert sorted(found.hashed()) == ["a.bag", "b.bag", "c.bag"]
        reported = {event.path.name for event in found if event.kind == "wrong"}
        assert reported == {"a.bag", "c.bag"}
        assert catch_up(root, fresh, verify=True).of("wrong") == []

    def test_a_missing_folder_is_an_error_at_the_start(self, tmp_path):
        with pytest.raises(RecordingError, match="no such folder"):
            catch_up(tmp_path / "none", None)

    def test_one_unreadable_file_stops_no_other(self, root, index, monkeypatch):
        def refuse(path, stat, between):
            if path.name == "a.bag":
                raise RecordingError(f"{path}: cannot be read (Permission denied).")
            return "1" * 64

        monkeypatch.setattr(module, "hash_file", refuse)
        for name in ("a.bag", "b.bag"):
            (root / name).write_bytes(b"content")
        events = catch_up(root, index)
        assert events.hashed() == ["b.bag"]
        assert events.of("problem") == [f"{root}/a.bag: cannot be read (Permission denied)."]

    def test_one_unreadable_folder_stops_no_other(self, root, index, monkeypatch):
        scandir = os.scandir

        def refuse(path):
            if str(path).endswith("secret"):
                raise PermissionError(13, "Permission denied", str(path))
            return scandir(path)

        (root / "secret").mkdir()
        (root / "a.bag").write_bytes(b"content")
        monkeypatch.setattr(os, "scandir", refuse)
        events = catch_up(root, index)
        assert events.hashed() == ["a.bag"]
        assert "secret: cannot be read: permissions" in events.of("problem")[0]

    def test_it_says_if_digests_can_be_stored_nowhere(self, root, monkeypatch):
        def refuse(*args):
            raise OSError(30, "Read-only file system")

        monkeypatch.setattr(os, "setxattr", refuse)
        for name in ("a.bag", "b.bag"):
            (root / name).write_bytes(b"content")
        (problem,) = catch_up(root, None).of("problem")
        assert "digests cannot be stored" in problem

    def test_a_read_only_root_uses_the_index(self, root, index, monkeypatch):
        monkeypatch.setattr(os, "setxattr", refused)
        (root / "a.bag").write_bytes(b"content")
        assert catch_up(root, index).of("problem") == []
        assert index.get(root / "a.bag", (root / "a.bag").stat()) == hex_of(b"content")
        assert catch_up(root, index) == []


class TestFollowing:
    def test_a_recording_is_hashed_once_when_it_is_finished(self, root, index, monkeypatch):
        """By a clock of its own: on a busy machine, more time may pass between two writes than settling takes."""
        path, later_s, events = root / "a.bag", [0.0], Events()
        clock = SimpleNamespace(time=time.time, monotonic=lambda: time.monotonic() + later_s[0])
        monkeypatch.setattr(module, "time", clock)
        watcher = Watcher(Bags(root=root, settle_s=600.0), index, events)
        with path.open("wb") as stream:
            for _ in range(4):
                stream.write(b"x" * 1000)
                stream.flush()
                watcher.run(once=True)
                later_s[0] += 400.0
        watcher.run(once=True)
        assert events == []
        for _ in range(2):
            later_s[0] += 400.0
            watcher.run(once=True)
        assert events.hashed() == ["a.bag"]
        assert stored_digest(find_one(path), index) == hex_of(b"x" * 4000)

    def test_a_burst(self, root, index, tmp_path):
        (tmp_path / "upload").mkdir()
        for i in range(400):
            folder = tmp_path / "upload" / f"day{i % 20}"
            folder.mkdir(exist_ok=True)
            (folder / f"{i}.bag").write_bytes(str(i).encode())
        with watching(root, index) as events:
            # Whole ones, as `rsync` has them appear: one of which a busy machine writes half would be hashed twice.
            shutil.copytree(tmp_path / "upload", root / "new", copy_function=os.link)
            eventually(lambda: len(events.hashed()) == 400)
            time.sleep(1.0)
        assert sorted(events.hashed()) == sorted(f"{i}.bag" for i in range(400))
        assert events.of("problem") == []

    def test_a_recording_that_is_moved_in_with_an_old_time(self, root, index, tmp_path):
        (tmp_path / ".a.bag.Xy12").write_bytes(b"content")
        os.utime(tmp_path / ".a.bag.Xy12", ns=(0, 10**18))
        with watching(root, index) as events:
            (tmp_path / ".a.bag.Xy12").rename(root / "a.bag")
            eventually(lambda: events.hashed() == ["a.bag"])
        assert stored_digest(find_one(root / "a.bag"), index) == hex_of(b"content")

    @pytest.mark.parametrize("record", ["attribute", "index"])
    def test_an_edit_in_place_with_its_time_put_back(self, root, index, record):
        known = index if record == "index" else None
        bag = root / "a.bag"
        bag.write_bytes(b"content")
        if known is None and not attributes_work(bag):
            pytest.skip("this file system has no extended attributes")
        with watching(root, known) as events:
            eventually(lambda: stored_digest(find_one(bag), known) == hex_of(b"content"))
            rewrite_in_place(bag, b"CONTENT")
            eventually(lambda: stored_digest(find_one(bag), known) == hex_of(b"CONTENT"))
        if attributes_work(bag):
            assert events.of("wrong")

    @pytest.mark.parametrize("record", ["attribute", "index"])
    def test_an_edit_in_place_while_its_digest_is_recorded_is_seen(self, root, index, monkeypatch, record):
        bag = root / "a.bag"
        bag.write_bytes(b"content")
        if record == "index":
            monkeypatch.setattr(os, "setxattr", refused)
        elif not attributes_work(bag):
            pytest.skip("this file system has no extended attributes")
        events, put = Events(), module.put_on_record
        watcher = Watcher(Bags(root=root, settle_s=0.0), index, events)

        def put_and_edit(*args):
            monkeypatch.setattr(module, "put_on_record", put)
            done = put(*args)
            rewrite_in_place(bag, b"CONTENT")
            return done

        monkeypatch.setattr(module, "put_on_record", put_and_edit)
        watcher.run(once=True)
        watcher.run(once=True)
        assert [event.digest for event in events if event.kind == "hashed"] == [
            hex_of(b"content"),
            hex_of(b"CONTENT"),
        ]
        assert stored_digest(find_one(bag), index) == hex_of(b"CONTENT")

    def test_what_comes_before_the_first_notification_is_not_missed(self, root, index, monkeypatch):
        real, looked = module.Watcher._scan, []

        def look(self):
            found = real(self)
            looked.append(1)
            if len(looked) == 2:  # it looked, and nobody notifies yet
                appear(root / "a.bag")
            return found

        follow = module.Notifications.follow

        def late(self):
            if looked[1:]:
                follow(self)  # established only after the file is there
            else:
                threading.Timer(0.5, follow, [self]).start()

        monkeypatch.setattr(module.Watcher, "_scan", look)
        monkeypatch.setattr(module.Notifications, "follow", late)
        with watching(root, index, ready=False) as events:
            eventually(lambda: events.hashed() == ["a.bag"])

    def test_nobody_needs_to_notify(self, root, index, monkeypatch):
        monkeypatch.setattr(module.Notifications, "follow", lambda self: None)
        with watching(root, index, rescan_s=0.3, ready=False) as events:
            time.sleep(0.5)
            appear(root / "a.bag")
            eventually(lambda: events.hashed() == ["a.bag"])

    def test_it_says_if_there_are_no_notifications_and_goes_on(self, root, index, monkeypatch):
        import watchfiles

        def refuse(*args, **options):
            raise OSError(28, "OS file watch limit reached")

        monkeypatch.setattr(watchfiles, "watch", refuse)
        with watching(root, index, rescan_s=0.3, ready=False) as events:
            appear(root / "a.bag")
            eventually(lambda: events.hashed() == ["a.bag"])
        (note,) = events.of("note")
        assert "fs.inotify.max_user_watches" in note

    def test_the_folder_goes_and_comes_back(self, root, index, tmp_path):
        with watching(root, index, rescan_s=0.5) as events:
            root.rename(tmp_path / "away")
            eventually(lambda: any("no such folder" in text for text in events.of("problem")))
            root.mkdir()
            appear(root / "a.bag")
            eventually(lambda: events.hashed() == ["a.bag"])
            time.sleep(0.6)  # by now it follows the new folder
            appear(root / "b.bag")
            eventually(lambda: events.hashed() == ["a.bag", "b.bag"])

    def test_a_file_that_failed_is_tried_again(self, root, index, monkeypatch):
        real = module.hash_file
        broken = [True]

        def sometimes(path, stat, between):
            if broken[0] and path.name == "a.bag":
                raise RecordingError(f"{path}: cannot be read (Input/output error).")
            return real(path, stat, between)

        monkeypatch.setattr(module, "hash_file", sometimes)
        with watching(root, index, rescan_s=0.3) as events:
            appear(root / "a.bag")
            eventually(lambda: events.of("problem"))
            time.sleep(1.0)
            assert len(events.of("problem")) == 1
            broken[0] = False
            eventually(lambda: events.hashed() == ["a.bag"])


class TestService:
    def test_a_folder_that_is_not_there_is_named_without_a_recipe_that_nobody_gave(self, tmp_path):
        command = [sys.executable, "-m", "bagassets", "watch", str(tmp_path / "nope")]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr == f"error: {tmp_path}/nope: no such folder; name that of the recordings.\n"

    def start(self, root, state, *options):
        recipe = state / "recipe.yaml"
        state.mkdir(exist_ok=True)
        recipe.write_text(
            f"name: test\nbags: {{root: {root}, settle_s: 0.2}}\nrigs: [{{name: car, ego_pose: {{source: fixed}}, "
            "channels: {CAM_FRONT: {modality: camera, topic: /cam}}}]\n"
        )
        command = [sys.executable, "-m", "bagassets", "watch", "--recipe", str(recipe), "--json", *options]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    @pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
    def test_a_signal_stops_it_at_once_and_a_restart_catches_up(self, root, tmp_path, number):
        with (root / "sparse.bag").open("wb") as stream:
            stream.truncate(60 << 30)  # a minute's worth of hashing
        service = self.start(root, tmp_path / "state")
        assert json.loads(service.stdout.readline())["message"] == f"watching {root}"
        (root / "a.bag").write_bytes(b"content")
        time.sleep(0.5)
        service.send_signal(number)
        assert service.wait(120) == 0
        assert "sparse.bag" not in service.stdout.read()
        service.stdout.close()
        (root / "sparse.bag").unlink()
        (root / "while-down.bag").write_bytes(b"content")
        again = self.start(root, tmp_path / "state")
        again.stdout.readline()
        lines = {json.loads(again.stdout.readline())["path"] for _ in range(2)}
        again.terminate()
        assert again.wait(60) == 0
        again.stdout.close()
        assert lines == {str(root / "a.bag"), str(root / "while-down.bag")}

    def test_killed_at_any_moment_it_leaves_no_false_digest(self, root, tmp_path):
        contents = {f"{i}.bag": os.urandom(3_000_000) for i in range(20)}
        index = DigestIndex(tmp_path / "state" / ".bagassets")
        for delay_s in (0.5, 0.8):
            for name, content in contents.items():
                (root / name).write_bytes(content)
            service = self.start(root, tmp_path / "state")
            time.sleep(delay_s)
            service.kill()
            service.wait()
            service.stdout.close()
            for name, content in contents.items():
                assert stored_digest(find_one(root / name), index) in {None, hex_of(content)}
        done = self.start(root, tmp_path / "state", "--once", "--settle", "0")
        assert done.wait(120) == 0
        done.stdout.close()
        for name, content in contents.items():
            assert stored_digest(find_one(root / name), index) == hex_of(content)

    def test_once_with_verify_shows_by_its_status(self, root, tmp_path):
        (root / "a.bag").write_bytes(b"content")
        with self.start(root, tmp_path / "state", "--once", "--settle", "0") as service:
            assert service.wait(120) == 0
        rewrite_in_place(root / "a.bag", b"CONTENT")
        shutil.rmtree(tmp_path / "state" / ".bagassets")
        index = DigestIndex(tmp_path / "state" / ".bagassets")
        index.put(root / "a.bag", (root / "a.bag").stat(), hex_of(b"content"))
        service = self.start(root, tmp_path / "state", "--once", "--verify", "--settle", "0")
        lines = [json.loads(line) for line in service.stdout]
        assert service.wait(120) == 3
        service.stdout.close()
        assert [line["event"] for line in lines if line["event"] == "wrong"]
        assert lines[-1] == {**lines[-1], "event": "hashed", "digest": hex_of(b"CONTENT")}


def test_a_build_never_reads_a_recording_merely_to_hash_it(tmp_path, monkeypatch):
    recipe_file = in_process.make_project(tmp_path, drives=("a.bag",))
    recipe = load_recipe(recipe_file)
    if not attributes_work(recipe.bags.root / "a.bag"):
        pytest.skip("this file system has no extended attributes")
    assert catch_up(recipe.bags.root, None).hashed() == ["a.bag"]  # on the server, which has no project

    def refuse(path, stat, between=None):
        raise AssertionError(f"{path} was hashed")

    monkeypatch.setattr(digest, "hash_file", refuse)
    report, ran = in_process.build(recipe_file, monkeypatch)
    assert report.succeeded
    assert [key for key, _ in ran] == ["a.bag", None]
    # Touched on the server, where the service sees at once that the content is the same.
    monkeypatch.undo()
    os.utime(recipe.bags.root / "a.bag")
    assert catch_up(recipe.bags.root, None).hashed() == ["a.bag"]
    monkeypatch.setattr(digest, "hash_file", refuse)
    report, _ = in_process.build(recipe_file, monkeypatch)
    assert report.succeeded
    assert report.having("built") == {}


def test_a_signal_handler_that_stops_it_waits_for_no_lock_of_the_thread_that_it_interrupts(root):
    watcher = Watcher(Bags(root=root), None, Events())
    with watcher._wake._cond:
        stopping = threading.Thread(target=watcher.stop, daemon=True)
        stopping.start()
        stopping.join(10)
        assert not stopping.is_alive()
