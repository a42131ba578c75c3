"""Checks of a dataset read what changed, and find what a look at everything finds."""

import json
import re
import shutil

import pytest
from handmade import Drive, make_tables, rig

from bagassets.engine.freshness.published import Publication
from bagassets.formats import dataset_build, groups
from bagassets.formats.assembly import assemble
from bagassets.formats.dataset_build import recordings_without_scenes
from bagassets.formats.format import Part
from bagassets.formats.groups import GroupsRecord
from bagassets.formats.nuscenes import dataset_checks, dataset_rows, group_checks
from bagassets.formats.nuscenes.dataset_checks import CHECKS, check
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.recipe.model import Recipe
from bagassets.store.action import Step
from bagassets.store.store import Store

pytestmark = pytest.mark.once

NUMBER, NAMES = 9, frozenset(check.name for check in CHECKS)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return Store(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def original(store):
    """Recordings with a lidar and a camera, but for two: one has no camera, and one has no lidar."""
    made = []
    for number in range(NUMBER):
        channels = {2: ("LIDAR_TOP",), 7: ("CAM_FRONT",)}.get(number, ("CAM_FRONT", "LIDAR_TOP"))
        drive = Drive(seconds=1.6, seed=number, channels=channels)
        tables = make_tables(store, drive, key=f"drive_{number}", min_length_s=0.5)
        made.append(Part(f"drive_{number}", str(number), tables.artifact.digest))
    return made


@pytest.fixture(autouse=True)
def small_groups(monkeypatch):
    monkeypatch.setattr(groups, "RECORDINGS", 2)


@pytest.fixture
def parts(original):
    return [*original]


@pytest.fixture
def dataset(tmp_path, store):
    return Dataset(tmp_path, store)


@pytest.fixture
def looked_at(monkeypatch):
    """Digests of the groups that are read."""
    real, found = group_checks._proof, []

    def proof(settings, record, digest, shared):
        found.append(digest)
        return real(settings, record, digest, shared)

    monkeypatch.setattr(group_checks, "_proof", proof)
    return found


class Dataset:
    def __init__(self, folder, store):
        self.store, self.state = store, folder / "state"
        self.settings = NuScenes(version="v1.0-test", output=folder / "dataset")
        self.folder = self.settings.output / "v1.0-test"
        self.publication = Publication(self.state, "nuscenes_dataset")

    def build(self, parts):
        publication, output = self.publication, self.settings.output
        suspects, record = publication.changed_files(output), GroupsRecord.from_json(publication.groups())
        made = assemble(NUSCENES, parts, self.settings, self.store, output, suspects=suspects, record=record)
        publication.write(output, made.published, made.links, suspects, made.gone, made.record.as_json())

    def check(self):
        """Check by groups, after which a look at everything must say the same."""
        found = check(self.settings, NAMES, self.publication)
        assert found == check(self.settings, NAMES)
        return found


def problems(found):
    return [problem for finding in found.values() for problem in finding.problems]


def damaged(store, part, changes):
    """A part with other bytes in its tables: table -> pattern and what takes its place, once."""
    before = store.artifact(part.artifact)
    pending = store.begin(Step("damaged", 1).action({"of": part.artifact, "changes": str(changes)}, {}))
    for entry in before.entries():
        text = before.path(entry.path).read_text()
        for name, (pattern, by) in changes.items():
            if entry.path == f"{name}.json":
                text, number = re.subn(pattern, by, text, count=1)
                assert number == 1
        pending.out.write(entry.path, text.encode())
    return Part(part.key, f"{part.content} {changes}", pending.commit({}).artifact.digest)


def value(store, part, table, column):
    return store.artifact(part.artifact).read_json(f"{table}.json")[0][column]


class TestWhatIsRead:
    def test_where_nothing_is_wrong_nothing_is_read_but_groups(self, dataset, parts, monkeypatch):
        """Though a reading and its ego pose have the same token."""
        dataset.build(parts)
        monkeypatch.setattr(dataset_checks, "read_dataset", None)
        found = check(dataset.settings, NAMES, dataset.publication)
        assert problems(found) == []
        assert found["dataset_references_intact"].facts["scene"] == NUMBER
        tokens = {
            name: {row["token"] for row in json.loads((dataset.folder / f"{name}.json").read_bytes())}
            for name in ("sample_data", "ego_pose")
        }
        assert tokens["sample_data"] == tokens["ego_pose"] != set()

    def test_everything_once_then_the_group_that_changed(self, dataset, store, parts, looked_at):
        dataset.build(parts)
        found = dataset.check()
        assert problems(found) == []
        assert found["dataset_tokens_unique"].facts["recordings_checked"] == NUMBER
        record = GroupsRecord.from_json(dataset.publication.groups())
        assert sorted(looked_at) == sorted(record.groups)
        assert len(looked_at) > 2
        looked_at.clear()
        dataset.check()
        assert looked_at == []
        parts[4] = damaged(store, parts[4], {"scene": ('"description":"', '"description":"another ')})
        dataset.build(parts)
        assert problems(dataset.check()) == []
        assert len(looked_at) == 1
        now = GroupsRecord.from_json(dataset.publication.groups())
        assert set(looked_at) == now.groups.keys() - record.groups.keys()

    def test_a_dataset_too_large_for_the_memory_is_read_whole_all_the_same(self, dataset, parts, monkeypatch):
        monkeypatch.setattr(dataset_rows.read_dataset, "__defaults__", (1000, frozenset()))
        monkeypatch.setattr(group_checks, "MOST_BYTES", 1000)
        dataset.build(parts)
        assert not dataset_rows.read_dataset(dataset.settings.output, "v1.0-test").is_whole
        found = check(dataset.settings, NAMES, dataset.publication)
        facts = found["dataset_references_intact"].facts
        assert facts["recordings_checked"] == facts["recordings"] == facts["scene"] == NUMBER

    def test_a_recording_without_scenes_counts_nowhere(self, dataset, store, parts):
        tables = make_tables(store, Drive(seconds=1.6, seed=99), key="short", min_length_s=60.0)
        dataset.build([*parts, Part("short", "99", tables.artifact.digest)])
        assert dataset.check()["dataset_tokens_unique"].facts["recordings"] == NUMBER

    def test_nothing_of_a_dataset_that_is_not_on_record_is_known(self, dataset, parts, looked_at):
        assert group_checks.prove(dataset.settings, dataset.publication) == frozenset()
        dataset.build(parts)
        shutil.rmtree(dataset.state)
        assert problems(dataset.check()) == []
        assert looked_at == []

    def test_an_empty_dataset_passes(self, dataset):
        dataset.build([])
        assert problems(dataset.check()) == []

    def test_channels_are_compared_over_all_recordings(self, dataset, parts):
        """Also between groups that were read at different times."""
        dataset.build(parts[:2])
        assert dataset.check()["devkit_ready"].warnings == []
        dataset.build(parts)
        (warning,) = dataset.check()["devkit_ready"].warnings
        assert "CAM_FRONT in" in warning
        assert "LIDAR_TOP in" in warning
        dataset.build([parts[2]])
        assert dataset.check()["devkit_ready"].warnings == []


class TestWhatIsWrong:
    @pytest.mark.parametrize(
        ("table", "pattern", "by", "problem"),
        [
            ("sample_data", '"ego_pose_token":"..', '"ego_pose_token":"xx', "ego_pose_token"),
            ("sample_data", '"is_key_frame":true', '"is_key_frame":"true"', "not a JSON boolean"),
            ("sample_data", '"fileformat":"..."', '"fileformat":".jpg"', "fileformat"),
            ("sample", '"timestamp":', '"timestamp":1000', "not an integer in microseconds"),
            ("ego_pose", r'"rotation":\[', '"rotation":[3.0,', "unit quaternion"),
            ("sample_annotation", r'"size":\[', '"size":[-', "size is not positive"),
            ("instance", '"nbr_annotations":', '"nbr_annotations":1', "disagree"),
            ("calibrated_sensor", '"sensor_token":"..', '"sensor_token":"xx', "in no row of sensor"),
            ("instance", '"category_token":"..', '"category_token":"xx', "in no row of category"),
        ],
    )
    def test_a_wrong_row_is_found_when_it_comes_and_as_long_as_it_is_there(
        self, dataset, store, parts, table, pattern, by, problem
    ):
        dataset.build(parts)
        dataset.check()
        dataset.build([*parts[:4], damaged(store, parts[4], {table: (pattern, by)}), *parts[5:]])
        for _ in range(2):
            assert problem in " ".join(problems(dataset.check()))
        dataset.build(parts)
        assert problems(dataset.check()) == []

    @pytest.mark.parametrize("table", ["log", "ego_pose", "scene"])
    def test_a_token_in_two_groups_is_found(self, dataset, store, parts, table):
        token = value(store, parts[0], table, "token")
        dataset.build(
            [*parts[:8], damaged(store, parts[8], {table: ('"token":"[0-9a-f]*', f'"token":"{token}')})]
        )
        assert f"{table}: 1 token appears more than once: {token}." in problems(dataset.check())

    def test_a_file_in_two_groups_is_found(self, dataset, store, parts):
        name = value(store, parts[0], "sample_data", "filename")
        other = damaged(store, parts[8], {"sample_data": ('"filename":"[^"]*', f'"filename":"{name}')})
        dataset.build([*parts[:8], other])
        assert f"sample_data: 1 file is named by more than one row: {name}." in problems(dataset.check())

    def test_what_is_wrong_in_a_large_dataset_is_among_what_is_read(self, dataset, store, parts, monkeypatch):
        dataset.build(
            [*parts[:8], damaged(store, parts[8], {"ego_pose": (r'"rotation":\[', '"rotation":[3.0,')})]
        )
        size = sum(path.stat().st_size for path in dataset.folder.glob("*.json"))
        monkeypatch.setattr(dataset_rows.read_dataset, "__defaults__", (size // NUMBER, frozenset()))
        found = check(dataset.settings, NAMES, dataset.publication)
        assert "unit quaternion" in " ".join(problems(found))
        assert found["dataset_references_intact"].facts["recordings_checked"] < NUMBER

    @pytest.mark.parametrize("change", ["gone", "empty", "another", "in a folder of its own"])
    def test_files_are_compared_with_the_tables(self, dataset, parts, change):
        dataset.build(parts)
        assert problems(dataset.check()) == []
        folder = dataset.settings.output / "samples" / "CAM_FRONT"
        victim = min(folder.iterdir())
        if change in {"gone", "empty"}:
            victim.unlink()
        if change == "empty":
            victim.touch()
        elif change == "another":
            (folder / "notes.txt").write_text("mine")
        elif change == "in a folder of its own":
            (folder / "mine").mkdir()
            (folder / "mine" / "notes.txt").write_text("mine")
        assert len(problems(dataset.check())) == 1

    @pytest.mark.parametrize("change", ["gone", "another", "another for one that is gone"])
    def test_files_that_were_wrong_when_it_was_published_are_found(self, dataset, parts, change, monkeypatch):
        """What the record does not tell, the check does."""
        dataset.build(parts)
        folder = dataset.settings.output / "samples" / "CAM_FRONT"
        if "gone" in change:
            min(folder.iterdir()).unlink()
        if "another" in change:
            (folder / "notes.txt").write_text("mine")
        monkeypatch.setattr(Publication, "changed_files", lambda *_: frozenset())
        assert len(problems(dataset.check())) == 1 + ("for" in change)

    @pytest.mark.parametrize("file", ["splits.json", "map.json", "sensor.json", "category.json"])
    def test_files_that_exist_once_are_read_each_time(self, dataset, parts, file, monkeypatch):
        dataset.build(parts)
        assert problems(dataset.check()) == []
        monkeypatch.setattr(Publication, "changed_files", lambda *_: frozenset())
        path = dataset.folder / file
        value = json.loads(path.read_bytes())
        if file == "splits.json":
            value["train"] = ["drive_99_000"]
        elif file == "map.json":
            value[0]["log_tokens"].pop()
        else:
            value.pop()
        path.write_text(json.dumps(value))
        assert problems(dataset.check())

    def test_a_table_that_somebody_edited_is_read(self, dataset, parts):
        dataset.build(parts)
        dataset.check()
        path = dataset.folder / "ego_pose.json"
        path.write_text(path.read_text().replace('"rotation":[', '"rotation":[3.0,', 1))
        assert "unit quaternion" in " ".join(problems(dataset.check()))


class TestWithoutScenes:
    """Recordings without scenes are remembered by groups, too."""

    @pytest.fixture
    def recipe(self, store, tmp_path):
        made = Recipe(name="x", bags={"root": tmp_path}, rigs=[rig(("CAM_FRONT",))])
        return made.model_copy(update={"store": store.root, "state": tmp_path / "state"})

    def test_only_what_changed_is_read(self, recipe, store, parts, monkeypatch):
        short = make_tables(store, Drive(seconds=0.3), key="short").artifact.digest
        of = {part.key: part.artifact for part in parts} | {"short": short}
        real, read = dataset_build._fills_split, []

        def fills(kind, some, store):
            read.extend(part.key for part in some)
            return real(kind, some, store)

        monkeypatch.setattr(dataset_build, "_fills_split", fills)
        assert recordings_without_scenes(recipe, {"nuscenes": of}) == {"short"}
        assert sorted(read) == sorted(of)
        read.clear()
        assert recordings_without_scenes(recipe, {"nuscenes": of}) == {"short"}
        assert read == []
        of["drive_1"] = of["drive_2"]
        assert recordings_without_scenes(recipe, {"nuscenes": of}) == {"short"}
        assert 0 < len(read) < len(of)

    def test_a_part_that_is_not_in_the_store_is_asked_for_again(self, recipe, store, tmp_path):
        own = Store(shutil.copytree(store.root, tmp_path / "own"))
        recipe = recipe.model_copy(update={"store": own.root})
        short = make_tables(own, Drive(seconds=0.3), key="short").artifact
        away = tmp_path / "away"
        short.folder.rename(away)
        assert recordings_without_scenes(recipe, {"nuscenes": {"short": short.digest}}) == frozenset()
        away.rename(short.folder)
        assert recordings_without_scenes(recipe, {"nuscenes": {"short": short.digest}}) == {"short"}
