"""`bagassets.open_dataset` while the dataset is built again, and when files of it are gone or damaged."""

import itertools
import os
import pickle
import threading
import time
import zlib
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import pytest
from handmade import Drive, make_tables

import bagassets
from bagassets.base.errors import DatasetError
from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.vision.format import VISION
from bagassets.recipe import load_recipe
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.store.store import Store
from bagassets_tests.sample_drives import build_recordings

pytestmark = [pytest.mark.xdist_group("reader_while_built"), pytest.mark.once]

VERSION = "v1.0-test"


@pytest.fixture(scope="module")
def states(tmp_path_factory):
    store = Store(tmp_path_factory.mktemp("states") / "store")
    drives = {"drive_1": Drive(seconds=2.2), "drive_2": Drive(seconds=3.5, seed=1)}
    return store, [
        Part(key, key, make_tables(store, drive, key=key).artifact.digest) for key, drive in drives.items()
    ]


@contextmanager
def rebuilding(build, states):
    """Build the states in turn, until the block ends; give whether there is time left."""
    ended = threading.Event()

    def rebuild():
        for state in itertools.cycle(states):
            if ended.is_set():
                return
            build(state)

    builder = threading.Thread(target=rebuild)
    deadline = time.monotonic() + 120  # a busy machine may need it; others have seen enough within seconds
    builder.start()
    try:
        yield lambda: time.monotonic() < deadline and builder.is_alive()
    finally:
        ended.set()
        builder.join()


class TestWhileItIsBuilt:
    """Two states of a dataset: with one recording, and with two."""

    @pytest.fixture
    def build(self, states, tmp_path):
        store, both = states

        def build(number):
            assemble(NUSCENES, both[:number], NuScenes(version=VERSION), store, tmp_path / "nuscenes")

        return build

    def content(self, dataset):
        """All that the tables say."""
        return [
            [scene.name for scene in dataset.scenes],
            [
                [sample.token, [box.token for box in sample.boxes], *(sample.global_SE3_ego(c).tolist() for c in sample.channels)]
                for sample in dataset
            ],
            dataset.splits,
        ]  # fmt: skip

    def test_a_reader_sees_the_old_or_the_new_one(self, build, tmp_path):
        build(2)
        both = self.content(bagassets.open_dataset(tmp_path / "nuscenes"))
        build(1)
        one = self.content(bagassets.open_dataset(tmp_path / "nuscenes"))
        assert one != both
        seen = [0, 0]
        with rebuilding(build, (2, 1)) as has_time:
            while (min(seen) < 10 or sum(seen) < 40) and has_time():
                content = self.content(bagassets.open_dataset(tmp_path / "nuscenes"))
                assert content in (one, both)
                seen[content == both] += 1
        assert min(seen) >= 3

    def test_its_images_are_those_of_the_samples_or_it_says_that_it_has_to_be_opened_again(
        self, build, tmp_path
    ):
        build(2)
        truth = {
            sample.token: zlib.crc32(sample.image("CAM_FRONT").tobytes())
            for sample in bagassets.open_dataset(tmp_path / "nuscenes")
        }
        assert len(set(truth.values())) > len(truth) / 2, "images differ"
        seen = Counter()
        with rebuilding(build, (2, 1)) as has_time:
            while seen["whole"] < 40 and has_time():
                dataset = bagassets.open_dataset(tmp_path / "nuscenes")
                try:
                    found = {
                        sample.token: zlib.crc32(sample.image("CAM_FRONT").tobytes()) for sample in dataset
                    }
                except DatasetError as err:
                    seen["refused" if str(err).endswith("; open it again.") else str(err)] += 1
                else:
                    assert found.items() <= truth.items()
                    seen["whole"] += 1
        assert seen["whole"] >= 10
        assert seen.keys() <= {"whole", "refused"}

    def test_a_folder_that_is_swapped_while_it_is_opened_is_opened_again(self, build, tmp_path, monkeypatch):
        build(2)
        both = self.content(bagassets.open_dataset(tmp_path / "nuscenes"))
        build(1)
        swaps = iter([True])

        def scan(folder, scan=os.scandir):
            # After the folder was opened, before its files are.
            if isinstance(folder, int) and next(swaps, False):
                build(2)
                (tmp_path / "rest").mkdir()
                (tmp_path / "rest" / "scene.json").touch()
                return scan(tmp_path / "rest")
            return scan(folder)

        monkeypatch.setattr(os, "scandir", scan)
        assert self.content(bagassets.open_dataset(tmp_path / "nuscenes")) == both

    def test_one_that_was_open_stays_as_it_was(self, build, tmp_path):
        build(2)
        fresh = bagassets.open_dataset(tmp_path / "nuscenes")
        before = self.content(bagassets.open_dataset(tmp_path / "nuscenes"))
        build(1)
        # Its tables are read only now.
        assert self.content(fresh) == before
        kept, gone = fresh.scenes[0][0], fresh.scenes[-1][0]
        assert kept.image("CAM_FRONT").any()
        with pytest.raises(
            DatasetError,
            match=r"v1.0-test: this dataset was built again since it was opened, and \S+ is no longer",
        ) as found:
            gone.image("CAM_FRONT")
        assert str(found.value).endswith("; open it again.")
        with pytest.raises(DatasetError, match="no longer part of it; open it again"):
            gone.points("LIDAR_TOP")

    def test_a_worker_that_starts_later_refuses_another_one(self, build, tmp_path):
        build(2)
        sent = pickle.dumps(bagassets.open_dataset(tmp_path / "nuscenes"))
        build(1)
        with pytest.raises(DatasetError, match="was built again since it was opened; open it again"):
            pickle.loads(sent)
        build(2)
        assert len(pickle.loads(sent)) == len(bagassets.open_dataset(tmp_path / "nuscenes")), "the same again"

    def test_files_removed_by_hand_are_named_with_what_restores_them(self, build, tmp_path):
        build(1)
        dataset = bagassets.open_dataset(tmp_path / "nuscenes")
        path = dataset[0].readings["CAM_FRONT"].path
        path.unlink()
        lock = tmp_path / "nuscenes" / VERSION / "dataset.lock.json"
        with pytest.raises(DatasetError) as found:
            dataset[0].image("CAM_FRONT")
        assert str(found.value) == (
            f"{path}: this file of the dataset is missing; `bagassets build` in its project makes it again, and so does "
            f"`bagassets dataset restore {lock}`."
        )
        table = tmp_path / "nuscenes" / VERSION / "ego_pose.json"
        table.unlink()
        with pytest.raises(
            DatasetError, match=r"ego_pose.json: this file of the dataset is missing; `bagassets"
        ):
            bagassets.open_dataset(tmp_path / "nuscenes")

    def test_damaged_files_are_named(self, build, tmp_path):
        build(1)
        dataset = bagassets.open_dataset(tmp_path / "nuscenes")
        for channel, read in (
            ("CAM_FRONT", dataset[0].image), ("LIDAR_TOP", dataset[0].points), ("RADAR_FRONT", dataset[0].points),
        ):  # fmt: skip
            for content in (b"", b"no picture"):
                path = dataset[0].readings[channel].path
                path.unlink()
                path.write_bytes(content)
                if channel == "LIDAR_TOP" and not content:
                    assert len(read(channel)) == 0
                else:
                    with pytest.raises(DatasetError, match=f"{path.name}: expected .*`bagassets verify`"):
                        read(channel)
        table = tmp_path / "nuscenes" / VERSION / "sample.json"
        table.unlink()
        table.write_text("[{")
        with pytest.raises(DatasetError, match=r"sample.json: this file of the dataset cannot be read"):
            len(bagassets.open_dataset(tmp_path / "nuscenes"))

    def test_what_is_no_dataset_is_refused_in_a_sentence(self, build, tmp_path):
        with pytest.raises(DatasetError, match=r"nuscenes: there is no such folder; `bagassets build` makes"):
            bagassets.open_dataset(tmp_path / "nuscenes")
        (tmp_path / "empty").mkdir()
        with pytest.raises(DatasetError, match=r"expected a dataset with one version; there is none"):
            bagassets.open_dataset(tmp_path / "empty")
        build(1)
        with pytest.raises(DatasetError, match=f"there is none; name {tmp_path / 'nuscenes'}\\.$"):
            bagassets.open_dataset(tmp_path)  # as of a project
        (tmp_path / "recipe.yaml").write_text("name: test\n")
        found = f"expected the folder of a dataset, found a file; name {tmp_path / 'nuscenes'}"
        with pytest.raises(DatasetError, match=rf"recipe\.yaml: {found}\.$"):
            bagassets.open_dataset(tmp_path / "recipe.yaml")
        folder = tmp_path / "nuscenes" / VERSION
        assert len(bagassets.open_dataset(folder)) == len(bagassets.open_dataset(tmp_path / "nuscenes")) > 0
        assert len(bagassets.open_dataset(str(tmp_path / "nuscenes"), version=VERSION)) > 0
        with pytest.raises(DatasetError, match=f"there is no version v2; there is {VERSION}."):
            bagassets.open_dataset(tmp_path / "nuscenes", version="v2")
        leftover = folder.with_name(f"{folder.name}.tmp-0123")
        leftover.mkdir()
        (leftover / "sample.json").write_text("[]")
        assert len(bagassets.open_dataset(tmp_path / "nuscenes")) > 0
        other = folder.with_name("v1.1")
        leftover.rename(other)
        with pytest.raises(
            DatasetError, match=r"expected `version` to name one; there is v1\.0-test, v1\.1\.$"
        ):
            bagassets.open_dataset(tmp_path / "nuscenes")

    def test_without_a_lock_nothing_of_bagassets_is_needed(self, build, tmp_path):
        """As the datasets that others made."""
        build(2)
        folder = tmp_path / "nuscenes" / VERSION
        (folder / "dataset.lock.json").unlink()
        (folder / "splits.json").unlink()
        dataset = bagassets.open_dataset(tmp_path / "nuscenes")
        assert dataset[0].image("CAM_FRONT").any()
        assert dataset.splits == {}
        assert len(pickle.loads(pickle.dumps(dataset))) == len(dataset)
        dataset[0].readings["CAM_FRONT"].path.unlink()
        with pytest.raises(DatasetError, match="is missing; get it from where the dataset comes from"):
            dataset[0].image("CAM_FRONT")

    def test_files_are_closed_with_the_dataset(self, build, tmp_path):
        build(1)
        for _ in range(5):
            opened = bagassets.open_dataset(tmp_path / "nuscenes")
            opened.scenes[0][0].boxes.in_camera("CAM_FRONT")
            opened.scenes[0][0].points("LIDAR_TOP").in_global()
            assert open_below(tmp_path)
            del opened
            assert open_below(tmp_path) == [], "at once, not by the garbage collector"


def open_below(folder):
    """Return what this process has open in a folder; what other tests have left open may be closed at any time."""
    links = [os.path.realpath(link) for link in Path("/proc/self/fd").iterdir()]
    return [link for link in links if link.startswith(str(folder))]


@pytest.fixture(scope="module")
def qualities(tmp_path_factory):
    """A drive built with two qualities of its images: recipes, and what was made."""
    folder = tmp_path_factory.mktemp("qualities")
    write_recordings([Target(folder / "recordings" / "drive.mcap", "mcap")], seed=4, duration_s=1.6)
    found = []
    for quality in (90, 30):
        lines = [
            line.replace("modality: camera", f"modality: camera, quality: {quality}")
            for line in (sample_recipe() + "\nvision: {frames: 4}\n").splitlines()
        ]
        (folder / "recipe.yaml").write_text("\n".join(lines))
        recipe = load_recipe(folder / "recipe.yaml")
        found.append((recipe, build_recordings(recipe)["drive.mcap"]))
    return found


@pytest.mark.parametrize("kind", [NUSCENES, VISION], ids=lambda kind: kind.name)
class TestImagesThatAreMadeAgain:
    """The same recording with the same times, whose images have other bytes."""

    @pytest.fixture
    def build(self, kind, qualities, tmp_path):
        def build(number):
            recipe, made = qualities[number]
            part = Part("drive.mcap", "content", made[kind.part].artifact.digest)
            settings = getattr(recipe, kind.name)
            assemble(kind, [part], settings, Store(recipe.store_path), tmp_path / "dataset")
            return bagassets.open_dataset(tmp_path / "dataset")

        return build

    def images(self, dataset):
        """The digest of each image, or the end of the sentence that says that there is none."""
        found = []
        for sample in dataset:
            (channel, *_) = sample.channels
            try:
                found.append(zlib.crc32(sample.image(channel).tobytes()))
            except DatasetError as err:
                found.append(str(err).rpartition("; ")[2])
        return found

    def test_what_was_open_never_shows_the_new_ones(self, build):
        old = build(0)
        before = self.images(old)
        new = build(1)
        after = self.images(new)
        assert len(before) == len(after) >= 3
        assert not set(before) & set(after)
        assert set(self.images(old)) == {"open it again."}
        assert self.images(build(0)) == before
        assert self.images(old) == before, "the same dataset again"

    def test_while_they_are_made_an_image_is_that_of_the_tables_or_none(self, build, tmp_path):
        states = [self.images(build(number)) for number in (0, 1)]
        seen = Counter()
        with rebuilding(build, (0, 1)) as has_time:
            while (min(seen[0], seen[1]) < 100 or not seen["refused"]) and has_time():
                found = self.images(bagassets.open_dataset(tmp_path / "dataset"))
                (state,) = {number for number in (0, 1) if set(found) & set(states[number])} or {"refused"}
                for image, true in zip(found, states[state] if state in (0, 1) else found, strict=True):
                    assert image in (true, "open it again.")
                    seen["refused" if image == "open it again." else state] += 1
        assert min(seen[0], seen[1]) >= 10
