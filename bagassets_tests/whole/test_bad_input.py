"""Bad input and bad luck: one clear sentence each, others go on, nothing finished is lost, nothing half-made seen."""

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest

from bagassets.assets import calibration
from bagassets.base.errors import (
    BagAssetsError,
    ChangedWhileReadError,
    RecordingError,
    StoreError,
    UnexpectedError,
)
from bagassets.base.unexpected import explained_error
from bagassets.defs.builds.pending_work import open_project
from bagassets.engine import execute
from bagassets.engine.execute import BuildFailure
from bagassets.formats.assembly import assemble
from bagassets.formats.dataset_lock import read_lock
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.recipe import load_recipe
from bagassets.recordings import digest
from bagassets.recordings.damage import unreadable
from bagassets.recordings.digest import recording_digest, stored_digest
from bagassets.recordings.digest_record import DigestIndex
from bagassets.recordings.discover import discover, find_one
from bagassets.recordings.open import open_recording
from bagassets.recordings.recording import Recording
from bagassets.store.store import Store
from bagassets_tests import in_process
from bagassets_tests.build_process import make_dataset
from bagassets_tests.nuscenes_checks import check_dataset
from bagassets_tests.small_drive import RECIPE, write_drive
from bagassets_tests.store_check import check_store
from bagassets_tests.tiny_mcap import write_tiny
from bagassets_tests.whole.test_end_to_end import build_all, build_of, make_project

pytestmark = pytest.mark.once

VERSION = "v1.0-test"
TEXT = RECIPE + "preview: {{enabled: false}}\n"


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """One good recording of each kind."""
    folder = tmp_path_factory.mktemp("drives")
    names = {"ros1": "good.bag", "ros2": "good", "mcap": "good.mcap"}
    return {kind: write_drive(folder / name, kind, 1.5) for kind, name in names.items()}


@pytest.fixture
def project(tmp_path, drives):
    """A project with one good recording; a test adds bad ones."""
    recipe = make_project(tmp_path, text=TEXT)
    recipe.bags.root.mkdir()
    shutil.copy(drives["mcap"], recipe.bags.root / "good.mcap")
    return recipe


def sentence(recipe, key):
    """Build a recording that must fail, and return what users read; nothing may be recorded as made."""
    with pytest.raises(BagAssetsError) as caught:
        list(build_of(recipe, key).build())
    assert list(check_store(Store(recipe.store_path))) == []
    return str(caught.value)


def made_actions(recipe):
    return [p for p in (recipe.store_path / "actions").rglob("*.json") if not p.name.endswith(".failed.json")]


def failed_actions(recipe):
    return list((recipe.store_path / "actions").rglob("*.failed.json"))


def errors_of(recipe):
    """Build the good recording; return asset -> error, and the assets that were made all the same."""
    made, build = [], build_of(recipe, "good.mcap").build()
    with pytest.raises(BuildFailure) as caught:
        made.extend(iter(lambda: next(build).asset, None))
    return caught.value.errors, made


class TestFiles:
    """The recording itself is no good: file, expectation and advice in one sentence; others go on."""

    def bad_files(self, root, drives):
        bag, mcap = drives["ros1"].read_bytes(), drives["mcap"].read_bytes()
        database = next(drives["ros2"].glob("*.db3")).read_bytes()
        for suffix, data in (("bag", bag), ("mcap", mcap), ("db3", database)):
            (root / f"empty.{suffix}").touch()
            (root / f"text.{suffix}").write_text("this is no recording\n" * 200)
            for percent in (1, 50, 99):
                (root / f"cut{percent}.{suffix}").write_bytes(data[: len(data) * percent // 100])
        for name in ("badmeta", "nodata"):
            shutil.copytree(drives["ros2"], root / name)
        (root / "badmeta" / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
        next((root / "nodata").glob("*.db3")).write_bytes(b"")

    def outcomes(self, project):
        outcomes = {}
        for key in discover(project.bags).recordings:
            try:
                outcomes[key] = [made.asset for made in build_of(project, key).build()][-1]
            except BagAssetsError as err:
                outcomes[key] = str(err)
        assert list(check_store(Store(project.store_path))) == []
        return outcomes

    def test_each_fails_with_a_sentence_and_the_good_ones_are_built(self, project, drives):
        root = project.bags.root
        self.bad_files(root, drives)
        project = project.model_copy(update={"bags": project.bags.model_copy(update={"recover": "refuse"})})
        outcomes = self.outcomes(project)
        assert outcomes.pop("good.mcap") == "nuscenes_tables"
        assert len(outcomes) == 17
        for key, reported in outcomes.items():
            assert reported.startswith(f"{root / key}: "), reported
            is_advised = any(
                word in reported for word in ("rosbag reindex", "mcap recover", "sqlite3", "ros2 bag reindex")
            )
            assert ("it is no recording" in reported) == key.startswith("text."), reported
            assert ("; expected a" in reported) == is_advised == (not key.startswith(("text.", "empty."))), (
                reported
            )
            assert "recover: all" not in reported
            assert "\n" not in reported
        assert "the file is empty; a copy or a recorder stopped" in outcomes["empty.bag"]

    def test_by_default_those_whose_messages_are_all_whole_are_built_and_others_say_what_can_be_saved(
        self, project, drives
    ):
        root = project.bags.root
        self.bad_files(root, drives)
        outcomes = self.outcomes(project)
        whole = {"good.mcap", "cut99.bag", "cut99.mcap", "badmeta"}  # what was cut off these is their index
        assert {key for key, made in outcomes.items() if made == "nuscenes_tables"} == whole
        for key in outcomes.keys() - whole:
            reported = outcomes[key]
            assert reported.startswith(f"{root / key}: "), reported
            said = {"text": "it is no recording", "empty": "the file is empty; a copy or a recorder stopped"}
            assert said.get(key.partition(".")[0], "expected a") in reported, reported
            assert ("recover: all" in reported) == (
                key in {"cut50.bag", "cut50.mcap", "cut50.db3", "cut99.db3"}
            ), reported
            assert "\n" not in reported

    @pytest.mark.parametrize(
        ("kind", "name", "content"),
        [
            ("mcap", "misnamed.bag", "an MCAP file, whatever its name says; have its name end in .mcap"),
            ("ros1", "misnamed.mcap", "a ROS 1 bag, whatever its name says; have its name end in .bag"),
        ],
    )
    def test_a_sound_file_under_a_wrong_name_is_recognized(self, project, drives, kind, name, content):
        path = project.bags.root / name
        shutil.copy(drives[kind], path)
        assert sentence(project, name) == f"{path}: its content is that of {content}."

    def test_a_short_text_is_no_contradiction(self, project):
        (project.bags.root / "text.mcap").write_text("hello\n")
        assert "it does not begin as such a file does" in sentence(project, "text.mcap")

    def test_the_failure_is_on_record_and_not_tried_again(self, project):
        path = project.bags.root / "text.bag"
        path.write_text("no bag " * 1000)
        reported = sentence(project, "text.bag")
        records = failed_actions(project)
        assert len(records) == 2  # of the ordinary readers, and of those of damaged recordings
        errors = {json.loads(record.read_bytes())["error"] for record in records}
        assert errors == {reported.replace(str(path), "<recording>")}

    def test_a_ros2_bag_that_lacks_a_file_says_which(self, project, drives):
        folder = project.bags.root / "split"
        shutil.copytree(drives["ros2"], folder)
        (file,) = folder.glob("*.db3")
        shutil.copy(file, folder / "other.db3")
        file.unlink()
        reported = sentence(project, "split")
        assert str(folder) in reported
        assert file.name in reported

    def test_a_ros2_folder_without_any_data_is_not_passed_over(self, project, drives):
        shutil.copytree(drives["ros2"], project.bags.root / "half")
        next((project.bags.root / "half").glob("*.db3")).unlink()
        (project.bags.root / "other").mkdir()
        (project.bags.root / "other" / "metadata.yaml").write_text("author: somebody\n")
        ((name, reason),) = discover(project.bags).excluded
        assert name == "half"
        assert "no .db3 or .mcap file" in reason
        with pytest.raises(RecordingError, match=r"half: there is no \.db3 or \.mcap file beside"):
            find_one(project.bags.root / "half")

    def test_a_file_that_the_disk_cannot_read(self, project):
        if not Path("/proc/self/mem").exists():
            pytest.skip("needs a file that gives an error when it is read")
        (project.bags.root / "bad.bag").symlink_to("/proc/self/mem")
        with pytest.raises(
            RecordingError, match=r"bad\.bag: cannot be read \(Input/output error\).*permissions"
        ):
            recording_digest(discover(project.bags).recordings["bad.bag"])

    def test_a_file_without_permission(self, project, monkeypatch):
        path = project.bags.root / "good.mcap"
        real = Path.open

        def refuse(self, *args, **options):
            if self == path:
                raise PermissionError(13, "Permission denied", str(path))
            return real(self, *args, **options)

        monkeypatch.setattr(Path, "open", refuse)
        with pytest.raises(
            RecordingError, match=r"good\.mcap: cannot be read \(Permission denied\).*permissions"
        ):
            recording_digest(find_one(path), rehash=True)

    @pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3", "a"])
    def test_what_may_not_be_read_need_not_be_repaired(self, tmp_path, name):
        why = str(unreadable(tmp_path / name, PermissionError(13, "Permission denied")))
        assert why == f"{tmp_path / name}: it cannot be read (Permission denied); correct its permissions."

    def test_missing_messages_are_not_passed_over(self, project, monkeypatch):
        real = Recording.messages

        def skip_some(self, topics):
            for number, message in enumerate(real(self, topics)):
                if message.topic != "/points" or number % 3:
                    yield message

        monkeypatch.setattr(Recording, "messages", skip_some)
        reported = sentence(project, "good.mcap")
        assert "topic /points: " in reported
        assert "of the 14 messages that" in reported
        assert "mcap recover" in reported

    @pytest.mark.parametrize("seed", range(40))
    def test_whatever_bytes_are_damaged_it_is_reported_in_a_sentence(self, tmp_path, drives, seed):
        dice = random.Random(seed)
        recipe = make_project(tmp_path, text=TEXT)
        recipe.bags.root.mkdir()
        source = dice.choice(sorted(drives.values()))
        target = recipe.bags.root / source.name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, target)
        file = dice.choice(sorted(target.iterdir())) if target.is_dir() else target
        data = bytearray(file.read_bytes())
        for _ in range(dice.choice([1, 5, 40, 400])):
            data[dice.randrange(len(data))] = dice.randrange(256)
        file.write_bytes(data)
        with suppress(BagAssetsError):
            list(build_of(recipe, source.name).build())
        assert list(check_store(Store(recipe.store_path))) == []

    def test_a_time_that_is_no_number_is_damage(self, project, drives, monkeypatch):
        real = Recording._guarded

        def odd(self, topics):
            monkeypatch.setattr(type(self), "_read", lambda s, t: iter([broken]))
            return real(self, topics)

        with open_recording(find_one(drives["mcap"])) as recording:
            broken = next(iter(recording.messages(["/odom"])))._replace(log_time_ns=b"\0")
            monkeypatch.setattr(Recording, "_guarded", odd)
            with pytest.raises(RecordingError, match="has no time or no bytes"):
                list(recording.messages(["/odom"]))


class TestMessages:
    """A message that cannot be used is counted as lost, up to the limit of the recipe."""

    def recipe_with(self, project, limit):
        file = project.state.parent / "recipe.yaml"
        file.write_text(TEXT.format(name="test", root="bags") + f"limits: {{lost_messages: {limit}}}\n")
        return load_recipe(file)

    def spoil(self, project):
        """Cut every fourth image short."""

        def cut(topic, number, data):
            return data[:-100] if topic == "/cam/image_raw" and number % 4 == 3 else data

        write_tiny(project.bags.root / "good.mcap", duration_s=1.5, spoil=cut)

    def test_more_than_the_limit_fails_that_channel_with_topic_and_numbers(self, project):
        self.spoil(project)
        reported = sentence(project, "good.mcap")
        assert "good.mcap: CAM_FRONT: topic /cam/image_raw lost 3 of 14 messages" in reported
        assert "limits.lost_messages" in reported
        assert any('"LIDAR_TOP"' in path.read_text() for path in made_actions(project))

    def test_up_to_the_limit_they_are_counted(self, project):
        self.spoil(project)
        recipe = self.recipe_with(project, 0.3)
        made = {result.asset: result for result in build_of(recipe, "good.mcap").build()}
        counts = made["frames"].artifact.summary()["channels"]["CAM_FRONT"]
        assert (counts["read"], counts["written"], counts["merged"]) == (14, 11, 0)
        assert sum(counts["lost"].values()) == 3

    def test_a_surprise_costs_one_asset_and_says_where_it_was(self, project, monkeypatch):
        def surprise(*args, **options):
            return {}["no such key"]

        monkeypatch.setattr(calibration, "make_calibration", surprise)
        errors, made = errors_of(project)
        (err,) = errors.values()
        assert isinstance(err, UnexpectedError)
        assert "good.mcap: calibration met something in this recording" in str(err)
        assert "KeyError: 'no such key'" in str(err)
        assert isinstance(err.__cause__, KeyError)
        assert "ego_poses" in made
        assert failed_actions(project) == []  # tried again by the next build

    def test_a_surprise_costs_one_channel(self, project, monkeypatch):
        real = execute._feed

        def spoiled(recording, extractors, *rest):
            def add(message):
                raise ZeroDivisionError("division by zero")

            extractors["frames CAM_FRONT"].add = add
            real(recording, extractors, *rest)

        monkeypatch.setattr(execute, "_feed", spoiled)
        reported = sentence(project, "good.mcap")
        assert "CAM_FRONT met something" in reported
        assert any(
            json.loads(p.read_bytes())["action"]["params"].get("channel") == "LIDAR_TOP"
            for p in made_actions(project)
        )


class TestMissing:
    def fails(self, project, old, new):
        file = project.state.parent / "recipe.yaml"
        text = TEXT.format(name="test", root="bags")
        assert old in text
        file.write_text(text.replace(old, new))
        recipe = load_recipe(file)
        return errors_of(recipe)

    def test_no_pose(self, project):
        errors, made = self.fails(project, "topic: /odom", "topic: /no/odometry")
        assert set(errors) == {"ego_poses"}
        reported = str(errors["ego_poses"])
        assert all(word in reported for word in ("/no/odometry", "/odom"))
        assert "frames" in made
        assert "nuscenes_tables" not in made

    def test_no_extrinsics(self, project):
        errors, made = self.fails(project, "topic: /points", "topic: /points, frame: nowhere")
        reported = str(errors["calibration"])
        assert "nowhere" in reported
        assert "base_link" in reported
        assert made[-1] == "ego_poses"

    def test_no_intrinsics(self, project):
        errors, _ = self.fails(
            project, "topic: /cam/image_raw", "topic: /cam/image_raw, camera_info: /no/info"
        )
        assert "/no/info" in str(errors["calibration"])


class TestChanges:
    """A recording that changes while it is read fails, and nothing is recorded of it."""

    def check_nothing_recorded(self, recipe, but=()):
        steps = {json.loads(path.read_bytes())["action"]["step"] for path in made_actions(recipe)}
        assert steps <= set(but)
        assert failed_actions(recipe) == []
        assert list(check_store(Store(recipe.store_path))) == []
        assert list((recipe.store_path / "tmp").iterdir()) == []

    @pytest.mark.parametrize("how", ["grows", "shrinks", "is replaced", "vanishes"])
    @pytest.mark.parametrize("when", ["inventory", "frames"])
    def test_while_a_step_reads_it(self, project, monkeypatch, how, when):
        path = project.bags.root / "good.mcap"
        content = path.read_bytes()
        real, passes = Recording._guarded, []

        def change(self, topics):
            if type(self).__name__ == "McapRecording":
                passes.append(1)
            for number, message in enumerate(real(self, topics)):
                if number == 5 and len(passes) == {"inventory": 1, "frames": 2}[when]:
                    spoil(path, content, how)
                yield message

        monkeypatch.setattr(Recording, "_guarded", change)
        reported = sentence(project, "good.mcap")
        assert str(path) in reported
        assert ("was it removed?" if how == "vanishes" else "changed while it was read") in reported
        earlier = ("inventory", "calibration", "ego_poses", "annotations", "track")
        self.check_nothing_recorded(project, but=() if when == "inventory" else earlier)
        # As soon as it is complete, it is built.
        monkeypatch.undo()
        path.write_bytes(content)
        assert list(build_of(project, "good.mcap").build())[-1].asset == "nuscenes_tables"

    @pytest.mark.parametrize("how", ["grows", "shrinks", "is replaced", "vanishes"])
    def test_while_it_is_hashed(self, project, monkeypatch, how):
        path = project.bags.root / "good.mcap"
        recording, content, real = find_one(path), path.read_bytes(), digest.digest_file

        def change(*args):
            made = real(*args)
            spoil(path, content, how)
            return made

        monkeypatch.setattr(digest, "digest_file", change)
        with pytest.raises(RecordingError, match=r"good\.mcap.*(changed while it was hashed|cannot be read)"):
            recording_digest(recording)
        if path.exists():
            assert stored_digest(find_one(path)) is None

    def test_between_digest_and_build(self, project):
        build = build_of(project, "good.mcap")
        (project.bags.root / "good.mcap").unlink()
        with pytest.raises(BuildFailure, match="was it removed"):
            list(build.build())
        self.check_nothing_recorded(project)

    def test_an_unreadable_attribute_is_as_good_as_none(self, project, monkeypatch):
        recording = find_one(project.bags.root / "good.mcap")
        truth = recording_digest(recording).digest

        def refuse(*args):
            raise OSError(5, "Input/output error")

        monkeypatch.setattr(os, "getxattr", refuse)
        again = recording_digest(recording, DigestIndex(project.state))
        assert (again.digest, again.hashed_bytes) == (truth, recording.size)


def spoil(path, content, how):
    if how == "grows":
        with path.open("ab") as stream:
            stream.write(b"more")
    elif how == "shrinks":
        os.truncate(path, len(content) // 2)
    elif how == "is replaced":
        other = path.with_name(".other")
        other.write_bytes(content)
        other.replace(path)
        os.utime(path, ns=(0, 10**18))
    else:
        path.unlink(missing_ok=True)


def start_build(recipe, *args):
    command = [
        sys.executable,
        "-m",
        "bagassets_tests.build_process",
        str(recipe.state.parent / "recipe.yaml"),
    ]
    return subprocess.Popen(
        [*command, *map(str, args)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def everything(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".bagassets")
    }


@pytest.fixture(scope="module")
def reference(tmp_path_factory, drives):
    """Three recordings and the dataset that they make."""
    recipe = make_project(tmp_path_factory.mktemp("reference"), text=TEXT)
    shutil.copytree(drives["mcap"].parent, recipe.bags.root)
    make_dataset(recipe)
    return everything(recipe.nuscenes.output)


@pytest.fixture
def three(tmp_path, drives):
    recipe = make_project(tmp_path, text=TEXT)
    shutil.copytree(drives["mcap"].parent, recipe.bags.root)
    return recipe


class TestFullDisk:
    def test_the_sentence_and_the_next_build(self, three, reference):
        """A limit on the size of files stands in for a full disk: images fit, tables do not."""
        build = start_build(three, 3000)
        reported = build.communicate(timeout=60)[1].strip()
        assert build.returncode == 1
        assert f": {three.store_path}" in reported
        assert "cannot be written (File too large); free disk space, or make the folder writable" in reported
        store = Store(three.store_path)
        assert list(check_store(store)) == []
        assert failed_actions(three) == []  # the disk failed, not the action
        assert read_lock(three.nuscenes.output / VERSION) is None
        make_dataset(three)
        assert everything(three.nuscenes.output) == reference

    def test_a_real_one(self, three, reference, tmp_path):
        with mounted(tmp_path / "disk", "-t", "tmpfs", "-o", "size=200k", "tmpfs"):
            store = tmp_path / "disk" / "store"
            three.store_path.parent.mkdir(exist_ok=True)
            store.mkdir()
            three.store_path.symlink_to(store)
            with pytest.raises(BagAssetsError, match=r"No space left on device.*free disk space"):
                make_dataset(three)
            assert list(check_store(Store(store))) == []
            assert failed_actions(three) == []
            assert list((store / "tmp").iterdir()) == []
            subprocess.run(["mount", "-o", "remount,size=50m", str(tmp_path / "disk")], check=True)
            make_dataset(three)
            assert list(check_store(Store(store))) == []
            assert everything(three.nuscenes.output) == reference

    def test_a_full_disk_under_the_dataset_leaves_the_old_one(self, three, reference, tmp_path):
        store = Store(three.store_path)
        made = build_all(three)
        parts = [Part(key, key, assets["nuscenes_tables"].artifact.digest) for key, assets in made.items()]
        with mounted(tmp_path / "disk", "-t", "tmpfs", "-o", "size=400k", "tmpfs"):
            output = tmp_path / "disk" / "dataset"
            assemble(NUSCENES, parts[:1], three.nuscenes, store, output)
            before = everything(output)
            (tmp_path / "disk" / "ballast").write_bytes(b"x" * free_bytes(tmp_path / "disk"))
            with pytest.raises(BagAssetsError, match=r"No space left on device.*free disk space"):
                assemble(NUSCENES, parts, three.nuscenes, store, output)
            assert check_dataset(output, VERSION) == []
            assert {name: data for name, data in everything(output).items() if name in before} == before
            (tmp_path / "disk" / "ballast").unlink()
            subprocess.run(["mount", "-o", "remount,size=50m", str(tmp_path / "disk")], check=True)
            assemble(NUSCENES, parts, three.nuscenes, store, output)
            assert everything(output) == reference


def free_bytes(folder):
    stat = os.statvfs(folder)
    return stat.f_bavail * stat.f_bsize


@contextmanager
def mounted(folder, *options):
    folder.mkdir()
    done = subprocess.run(["mount", *options, str(folder)], capture_output=True, check=False)
    if done.returncode != 0:
        pytest.skip("this user may not mount file systems")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


class TestReadOnlyRoot:
    def test_digests_go_to_the_index_and_all_is_built(self, three, reference, tmp_path):
        (tmp_path / "recipe.yaml").write_text(TEXT.format(name="test", root="mounted"))
        with mounted(tmp_path / "mounted", "--bind", str(three.bags.root)):
            subprocess.run(["mount", "-o", "remount,bind,ro", str(tmp_path / "mounted")], check=True)
            recipe = load_recipe(tmp_path / "recipe.yaml")
            recording = find_one(recipe.bags.root / "good.mcap")
            index = DigestIndex(recipe.state)
            assert set(recording_digest(recording, index).kept.values()) == {"index"}
            assert recording_digest(recording, index).hashed_bytes == 0
            make_dataset(recipe)
        assert everything(recipe.nuscenes.output) == reference


class TestAtOnce:
    def test_two_builds_on_one_store(self, three, reference):
        builds = [start_build(three) for _ in range(2)]
        for build in builds:
            reported = build.communicate(timeout=120)[1]
            assert build.returncode == 0, reported
        assert list(check_store(Store(three.store_path))) == []
        assert list((three.store_path / "tmp").iterdir()) == []
        assert everything(three.nuscenes.output) == reference


class TestKilled:
    @pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
    def test_at_any_moment_the_next_build_carries_on(self, three, reference, seed):
        dice = random.Random(seed)
        store, output = Store(three.store_path), three.nuscenes.output
        finished = 0
        for _ in range(4):
            build = start_build(three)
            build.stdout.readline()
            time.sleep(dice.random() * 0.8)
            build.send_signal(signal.SIGKILL)
            build.communicate()
            # Nothing half-made is to be seen, and nothing finished is lost.
            assert list(check_store(store)) == []
            made = len(made_actions(three))
            assert made >= finished
            finished = made
            if read_lock(output / VERSION) is not None:
                assert check_dataset(output, VERSION) == []
        make_dataset(three)
        assert everything(output) == reference
        assert list(check_store(store)) == []


def no_memory_in_opencv():
    with pytest.raises(cv2.error) as caught:
        cv2.resize(np.zeros((1, 1, 3), np.uint8), (2**30, 2**30))
    return caught.value


def test_words_for_errors_that_are_ours_already():
    err = StoreError("x")
    assert explained_error(err, Path("a.bag"), "frames") is err
    full = explained_error(
        OSError(errno.ENOSPC, "No space left on device", "/store/x"), Path("a.bag"), "frames CAM_FRONT"
    )
    assert str(full).startswith(
        "/store/x: frames CAM_FRONT of a.bag cannot be made (No space left on device)"
    )
    assert full.transient  # not recorded, but tried again
    broken = explained_error(OSError(errno.EIO, "Input/output error"), Path("a.bag"), "frames CAM_FRONT")
    assert str(broken).startswith(
        "frames CAM_FRONT of a.bag cannot be made (Input/output error); check the disk or file server, and try again."
    )
    assert broken.transient
    for short in (MemoryError(), pa.lib.ArrowMemoryError("malloc of size 1 failed"), no_memory_in_opencv()):
        reported = explained_error(short, Path("a.bag"), "frames CAM_FRONT")
        assert reported.transient
        assert str(reported).startswith("a.bag: frames CAM_FRONT ran out of memory; ")
    assert ChangedWhileReadError.transient
    assert not RecordingError.transient


class TestInstance:
    def test_a_full_disk_under_the_database(self, tmp_path):
        with mounted(tmp_path / "disk", "-t", "tmpfs", "-o", "size=64k", "tmpfs"):
            text = in_process.QUICK + f"state: {tmp_path}/disk/state\n"
            file = tmp_path / "project" / "recipe.yaml"
            file.parent.mkdir()
            file.write_text(text.format(name="test", root="bags"))
            (file.parent / "bags").mkdir()
            reported = "Dagster's database cannot be used .*free disk space"
            with pytest.raises(StoreError, match=reported), open_project(file):
                pass
