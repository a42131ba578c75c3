"""Datasets are joined group by group: whatever was copied from the one before, the bytes are those of a clean build."""

import json
import random
import shutil
import string
from dataclasses import replace

import pytest
from handmade import Drive, make_tables
from hypothesis import given
from hypothesis import strategies as st

from bagassets.base.errors import StoreError
from bagassets.engine.freshness.published import Publication
from bagassets.formats import assembly, groups, joining
from bagassets.formats.assembly import assemble
from bagassets.formats.dataset_lock import LOCK, read_lock
from bagassets.formats.format import Part
from bagassets.formats.groups import FoundInGroups, GroupsRecord, cut
from bagassets.formats.json_files import json_bytes, rows_bytes
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.vision.format import VISION
from bagassets.formats.vision.settings import Vision
from bagassets.recipe.model_splits import Splits
from bagassets.store.action import Step
from bagassets.store.store import Store

pytestmark = pytest.mark.once

NUMBER, FORMATS = 12, ("nuscenes", "vision", "one")


def nuscenes_part(store, key, seed):
    drive = Drive(seconds=1.1, seed=seed, channels=("CAM_FRONT",), boxes=seed % 2 == 0)
    made = make_tables(store, drive, key=key, min_length_s=0.5)
    return Part(key, f"{key} {seed}", made.artifact.digest)


def vision_part(store, key, seed):
    """Two images and a sequence of them; of every third, nothing."""
    number = 2 * (seed % 3 > 0)
    pending = store.begin(Step("made_up", 1).action({"key": key, "seed": seed}, {}))
    for image in range(number):
        pending.out.write(f"CAM/{image}.jpg", f"{key} {seed} {image}".encode())
    folder = f"{key}-{seed}"
    rows = [{"folder": f"recordings/{folder}/CAM", "frames": [0, 1], "recording": key}] * (number // 2)
    pending.out.write("sequences.json", rows_bytes([json.dumps(row).encode() for row in rows]))
    pending.out.write_json("files.json", [])
    facts = {
        "rig": "car",
        "folder": folder,
        "sequences": number // 2,
        "images": number,
        "duration_s": 0.1 * seed,
    }
    pending.out.write_json("facts.json", {**facts, "daylight": None, "start": {"lat": 48.1}})
    return Part(key, f"{key} {seed}", pending.commit({}).artifact.digest)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return Store(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def versions(store):
    """Format -> recordings in the order of their keys, each in two versions."""
    keys = [f"drive_{number:02}" for number in range(NUMBER)]
    made = {
        "nuscenes": [[nuscenes_part(store, key, 2 * n + v) for v in (0, 1)] for n, key in enumerate(keys)],
        "vision": [[vision_part(store, key, 2 * n + v) for v in (0, 1)] for n, key in enumerate(keys)],
    }
    return {**made, "one": made["vision"]}


@pytest.fixture(autouse=True)
def small_groups(monkeypatch):
    monkeypatch.setattr(groups, "RECORDINGS", 3)


@pytest.fixture
def parts(versions):
    return [versions["nuscenes"][number][0] for number in range(NUMBER)]


class Dataset:
    """A dataset and its record, built as `build_dataset` does."""

    def __init__(self, folder, store, name="nuscenes"):
        self.output, self.store = folder / "dataset", store
        self.kind = NUSCENES if name == "nuscenes" else VISION
        self.settings = (
            NuScenes(version="v1.0-test")
            if name == "nuscenes"
            else Vision(files="one" if name == "one" else "per_split")
        )
        self.publication = Publication(folder / "state", f"{name}_dataset")

    @property
    def folder(self):
        return self.output / self.kind.folder(self.settings)

    @property
    def record(self):
        return GroupsRecord.from_json(self.publication.groups())

    def assemble(self, parts, **given):
        given = {"suspects": self.publication.changed_files(self.output), "record": self.record, **given}
        return assemble(self.kind, parts, self.settings, self.store, self.output, **given)

    def build(self, parts, **given):
        suspects = self.publication.changed_files(self.output)
        made = self.assemble(parts, suspects=suspects, **given)
        on_record = None if made.record is None else made.record.as_json()
        self.publication.write(self.output, made.published, made.links, suspects, made.gone, on_record)
        return made

    @property
    def content(self):
        return {
            path.relative_to(self.output).as_posix(): path.read_bytes()
            for path in sorted(self.output.rglob("*"))
            if path.is_file() and not path.name.startswith(".bagassets")
        }


@pytest.fixture
def dataset(tmp_path, store):
    return Dataset(tmp_path, store)


def clean(tmp_path, store, parts, name="nuscenes", **given):
    """The files of a dataset that is built at once."""
    made = Dataset(tmp_path / f"clean{random.getrandbits(64)}", store, name)
    made.build(parts, **given)
    return made.content


@pytest.fixture
def read(monkeypatch):
    """Keys of the recordings that are read from the store."""
    real, found = joining.Joint.member, []

    def member(self, part, number):
        found.append(part.key)
        return real(self, part, number)

    monkeypatch.setattr(joining.Joint, "member", member)
    return found


class TestCutting:
    @given(st.sets(st.text(string.ascii_letters, min_size=1, max_size=4), min_size=1, max_size=60), st.data())
    def test_one_that_comes_or_goes_changes_its_own_group_or_merges_or_divides_two(self, keys, data):
        gone = data.draw(st.sampled_from(sorted(keys)))
        before, after = (self.cut(some) for some in (keys, keys - {gone}))
        assert [key for group in before for key in group] == sorted(keys)
        assert len(set(before) - set(after)) <= 2
        assert len(set(after) - set(before)) <= 1

    def cut(self, keys):
        parts = [Part(key, key, key) for key in sorted(keys)]
        found = cut(parts, dict.fromkeys(keys, "train"))
        assert [group.first for group in found] == [
            sum(len(group.parts) for group in found[:n]) for n in range(len(found))
        ]
        return [tuple(part.key for part in group.parts) for group in found]

    def test_groups_have_about_as_many_as_asked_for(self, monkeypatch):
        monkeypatch.undo()
        sizes = [len(group) for group in self.cut({f"r{number:05}.bag" for number in range(10_000)})]
        assert groups.RECORDINGS / 2 < sum(sizes) / len(sizes) < groups.RECORDINGS * 2
        assert max(sizes) < 10 * groups.RECORDINGS

    @pytest.mark.parametrize("field", ["key", "content", "artifact", "split"])
    def test_a_group_is_another_if_anything_of_a_recording_is(self, parts, field):
        splits = dict.fromkeys((part.key for part in parts), "train") | {"other": "train"}
        (one,) = cut(parts[:1], splits)
        if field == "split":
            (other,) = cut(parts[:1], dict.fromkeys(splits, "val"))
        else:
            (other,) = cut([replace(parts[0], **{field: "other"})], splits)
        assert one.digest != other.digest


class TestSameBytes:
    @pytest.mark.parametrize("name", FORMATS)
    def test_whatever_happened_before_the_dataset_is_that_of_a_clean_build(
        self, versions, store, tmp_path, name, read
    ):
        dice, dataset, copied = random.Random(name), Dataset(tmp_path, store, name), 0
        state = {number: 0 for number in range(NUMBER) if dice.random() < 0.7}
        for _ in range(14):
            for _ in range(dice.choice((0, 1, 1, 2))):
                number = dice.randrange(NUMBER)
                if number in state and dice.random() < 0.5:
                    del state[number]
                else:
                    state[number] = dice.randrange(2)
            parts = [versions[name][number][version] for number, version in state.items()]
            if dice.random() < 0.3 and parts:  # equal content under another key
                parts.append(replace(parts[0], key=dice.choice(("a_copy", "z_copy"))))
            pinned = {f"drive_{dice.randrange(NUMBER):02}": "val"} if dice.random() < 0.3 else {}
            given = {"splits": Splits(pinned=pinned)}
            if dice.random() < 0.3:
                given |= {"skipped": {"calib": 'no "rig"'}, "failed": {"torn": "torn.bag: is\ntruncated."}}
            read.clear()
            made = dataset.build(parts, **given)
            copied += len({part.content for part in parts}) - len(read)
            assert dataset.content == clean(tmp_path, store, parts, name, **given)
            assert dataset.publication.changed_files(dataset.output) == frozenset()
            assert (
                made.digest
                == assemble(dataset.kind, parts, dataset.settings, store, tmp_path / "other", **given).digest
            )
        assert copied > 20

    def test_only_the_group_of_a_changed_recording_is_read(self, versions, store, dataset, parts, read):
        dataset.build(parts)
        splits = read_lock(dataset.folder).splits
        for number in range(NUMBER):
            parts[number] = versions["nuscenes"][number][1]
            (group,) = (
                [part.key for part in group.parts]
                for group in cut(parts, splits)
                if parts[number] in group.parts
            )
            read.clear()
            dataset.build(parts)
            assert read == group

    def test_rows_of_others_are_not_even_looked_for(self, versions, store, dataset, parts, read, tmp_path):
        """Not one file of their parts is opened: it would be missed."""
        own = Store(shutil.copytree(store.root, tmp_path / "own"))
        dataset.store = own
        dataset.build(parts)
        parts[0] = versions["nuscenes"][0][1]
        splits = read_lock(dataset.folder).splits
        (_, *others) = cut(parts, splits)
        for group in others:
            for part in group.parts:
                shutil.rmtree(own.artifact_folder(part.artifact))
        dataset.build(parts)
        assert dataset.content == clean(tmp_path, store, parts)

    def test_the_lock_is_written_as_ever(self, dataset, parts):
        dataset.build(parts, skipped={"a": "\0rows", "b": "ü"})
        lock = read_lock(dataset.folder)
        assert lock.text == json_bytes(lock.value)
        assert len(lock.bags) == NUMBER

    def test_what_the_summary_says_does_not_depend_on_what_was_copied(self, versions, store, dataset, parts):
        dataset.build(parts, splits=Splits(pinned={"drive_03": "train"}))
        parts[5] = versions["nuscenes"][5][1]
        given = {"splits": Splits(pinned={"drive_03": "val"}), "dealt": None}
        made = dataset.assemble(parts, **given)
        dataset.assemble(parts, suspects=None, splits=Splits(pinned={"drive_03": "train"}))
        again = dataset.assemble(parts, suspects=None, **given)
        assert (made.facts, made.shares, made.moved) == (again.facts, again.shares, again.moved)
        assert made.moved["drive_03"] == ("train", "val")


class TestLinks:
    def test_links_of_others_are_neither_made_nor_looked_at(self, versions, dataset, parts):
        dataset.build(parts)
        parts[0] = versions["nuscenes"][0][1]
        made = dataset.build(parts)
        assert set(made.links) < {part.artifact for part in parts}
        assert parts[0].artifact in made.links

    @pytest.mark.parametrize("name", FORMATS)
    def test_files_of_a_part_that_left_the_store_go_as_well(self, versions, store, tmp_path, name):
        own = Store(shutil.copytree(store.root, tmp_path / "own"))
        dataset = Dataset(tmp_path, own, name)
        parts = [of[0] for of in versions[name]]
        dataset.build(parts)
        shutil.rmtree(own.artifact_folder(parts[4].artifact))
        parts[4] = versions[name][4][1]
        dataset.build(parts)
        assert dataset.content == clean(tmp_path, store, parts, name)

    def test_a_link_that_somebody_removed_comes_back(self, versions, store, dataset, parts, tmp_path):
        dataset.build(parts)
        next((dataset.output / "samples" / "CAM_FRONT").iterdir()).unlink()
        parts[0] = versions["nuscenes"][0][1]
        dataset.build(parts)
        assert dataset.content == clean(tmp_path, store, parts)


class KilledError(Exception):
    pass


def kill(*_args, **_given):
    raise KilledError


class TestTorn:
    """A record that is not of the files on disk, however that came about."""

    def unnoticed(self, path, change):
        """Change a file so that its signature would not tell: here it is not even asked."""
        content = path.read_bytes()
        path.write_bytes(change(content))

    @pytest.mark.parametrize("file", ["sample_data.json", LOCK])
    @pytest.mark.parametrize(
        "change",
        [
            lambda content: content[:-100],
            lambda content: b"",
            lambda content: content.replace(b"drive_09", b"drive_08").replace(b'1"', b'2"'),
            lambda content: content + b" ",
        ],
    )
    def test_a_damaged_file_is_not_copied_from(self, versions, store, dataset, parts, tmp_path, file, change):
        dataset.build(parts)
        self.unnoticed(dataset.folder / file, change)
        parts[5] = versions["nuscenes"][5][1]
        dataset.assemble(parts, suspects=frozenset())
        left = {name for name in dataset.content if "drive_05" in name} if file == LOCK else set()
        expected = clean(tmp_path, store, parts)
        # Which files the old version had, only the lock could have said.
        assert dataset.content.keys() - left == expected.keys() - left
        assert {name: dataset.content[name] for name in expected} == expected

    def test_a_file_that_is_gone_is_made_again(self, versions, store, dataset, parts, tmp_path):
        dataset.build(parts)
        (dataset.folder / "scene.json").unlink()
        dataset.assemble([versions["nuscenes"][0][1], *parts[1:]], suspects=frozenset())
        assert dataset.content == clean(tmp_path, store, [versions["nuscenes"][0][1], *parts[1:]])

    def test_another_build_was_quicker(self, versions, store, dataset, parts, tmp_path):
        """Both began with the same record; the other one has swapped its folder in meanwhile."""
        dataset.build(parts)
        mine = dataset.record
        dataset.build([*parts[:3], *parts[5:]])
        parts[8] = versions["nuscenes"][8][1]
        dataset.assemble(parts, suspects=frozenset(), record=mine)
        assert dataset.content == clean(tmp_path, store, parts)

    @pytest.mark.parametrize("record", [{}, {"made_by": 1, "files": [], "groups": {"a": []}}, [], 3])
    def test_a_record_of_another_shape_is_none(self, record):
        assert GroupsRecord.from_json(record) is None

    def test_other_code_or_settings_join_everything_again(self, store, dataset, parts, read, monkeypatch):
        dataset.build(parts)
        read.clear()
        dataset.settings = NuScenes(version="v1.0-test", categories=[{"name": "animal"}])
        dataset.build(parts)
        assert len(read) == NUMBER
        read.clear()
        monkeypatch.setattr(joining, "loaded_code_fingerprint", lambda: "other code")
        dataset.build(parts)
        assert len(read) == NUMBER

    @pytest.mark.parametrize(
        "moment",
        [
            "joining.write_rows",
            "joining.framed",
            "assembly._put_files",
            "assembly.swap_in",
            "assembly._retire",
        ],
    )
    @pytest.mark.parametrize("name", FORMATS)
    @pytest.mark.parametrize("then", ["the same", "another", "what was"])
    def test_a_killed_join_leaves_nothing_behind(
        self, versions, store, tmp_path, monkeypatch, moment, name, then
    ):
        dataset = Dataset(tmp_path, store, name)
        parts = [of[0] for of in versions[name]]
        dataset.build(parts)
        wanted = [*parts[:2], versions[name][2][1], *parts[3:7], *parts[8:]]
        module, function = moment.split(".")
        module = {"joining": joining, "assembly": assembly}[module]
        real, calls = getattr(module, function), []

        def killed(*args, **given):
            calls.append(args)
            if function != "write_rows" or len(calls) == 3:
                if function == "_put_files":
                    real(*args, **given)
                raise KilledError
            return real(*args, **given)

        with monkeypatch.context() as patch:
            patch.setattr(module, function, killed)
            with pytest.raises(KilledError):
                dataset.build(wanted)
        wanted = {"the same": wanted, "another": [versions[name][9][1], *parts[:4]], "what was": parts}[then]
        dataset.build(wanted)
        assert dataset.content == clean(tmp_path, store, wanted, name)
        assert not list(dataset.output.rglob("*.tmp-*"))

    def test_files_that_a_killed_join_shares_with_the_dataset_stay(
        self, versions, store, dataset, parts, tmp_path, monkeypatch
    ):
        """Only the rows of the recording had changed: its files have the same names."""
        dataset.build(parts)
        before = store.artifact(parts[2].artifact)
        pending = store.begin(Step("made_up", 1).action({"of": before.digest}, {}))
        for entry in before.entries():
            content = before.path(entry.path).read_bytes()
            pending.out.write(entry.path, content.replace(b'"vehicle":"van"', b'"vehicle":"bus"'))
        other = Part(parts[2].key, "other", pending.commit({}).artifact.digest)
        assert other.artifact != parts[2].artifact
        with monkeypatch.context() as patch:
            patch.setattr(assembly, "swap_in", kill)
            with pytest.raises(KilledError):
                dataset.build([*parts[:2], other, *parts[3:]])
        wanted = [*parts[:9], versions["nuscenes"][9][1], *parts[10:]]
        dataset.build(wanted)
        assert dataset.content == clean(tmp_path, store, wanted)

    def test_killed_before_it_is_recorded_the_next_build_joins_everything(
        self, versions, store, dataset, parts, tmp_path, read, monkeypatch
    ):
        dataset.build(parts)
        parts[5] = versions["nuscenes"][5][1]
        with monkeypatch.context() as patch:
            patch.setattr(dataset.publication, "write", kill)
            with pytest.raises(KilledError):
                dataset.build(parts)
        parts[0] = versions["nuscenes"][0][1]
        read.clear()
        dataset.build(parts)
        assert len(read) == NUMBER
        assert dataset.content == clean(tmp_path, store, parts)

    def test_a_part_that_goes_while_it_is_joined_is_named_and_the_dataset_stays(
        self, versions, store, dataset, parts, tmp_path, monkeypatch
    ):
        own = dataset.store = Store(shutil.copytree(store.root, tmp_path / "own"))
        dataset.build(parts)
        before = dataset.content
        parts[5] = versions["nuscenes"][5][1]
        real = joining.cut

        def removed_meanwhile(*args):
            shutil.rmtree(own.artifact_folder(parts[5].artifact))
            return real(*args)

        with monkeypatch.context() as patch:
            patch.setattr(joining, "cut", removed_meanwhile)
            with pytest.raises(StoreError, match=parts[5].artifact[:16]):
                dataset.build(parts)
        assert {name: of for name, of in dataset.content.items() if ".tmp-" not in name} == before
        del parts[5]
        dataset.build(parts)
        assert dataset.content == clean(tmp_path, store, parts)


class TestFound:
    def test_what_was_found_comes_back_until_it_is_replaced(self, tmp_path):
        one = FoundInGroups(tmp_path, "a")
        assert one.load() == {}
        one.save({"x": b"1", "y": b"2"})
        other = FoundInGroups(tmp_path, "a")
        assert other.load() == {"x": b"1", "y": b"2"}
        other.save({"y": b"3", "z": b"4"})
        assert FoundInGroups(tmp_path, "a").load() == {"y": b"3", "z": b"4"}
        assert FoundInGroups(tmp_path, "b").load() == {}

    def test_of_other_code_nothing_counts_and_nothing_is_left(self, tmp_path, monkeypatch):
        FoundInGroups(tmp_path, "a").save({"x": b"1"})
        FoundInGroups(tmp_path, "b").save({"x": b"1"})
        with monkeypatch.context() as patch:
            patch.setattr(groups, "loaded_code_fingerprint", lambda: "other code")
            now = FoundInGroups(tmp_path, "a")
            assert now.load() == {}
            now.save({"y": b"2"})
        assert FoundInGroups(tmp_path, "a").load() == {}
        assert FoundInGroups(tmp_path, "b").load() == {"x": b"1"}
