"""The first pass over a new recording: hashed and inventoried together, so that a disk gives each byte once for both."""

import json
import os
import shutil
from collections import OrderedDict
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from threading import Lock

import pytest
import zstandard

from bagassets.base.errors import BagAssetsError, ChangedWhileReadError
from bagassets.defs.builds.made_ahead import make_first
from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import Naming
from bagassets.engine.execute import execute
from bagassets.engine.first_pass import first_pass
from bagassets.engine.graph import Graph
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe import load_recipe
from bagassets.recordings import decompress, digest, rosbag2
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.recordings.pack import PackedRecording
from bagassets.recordings.recording import Recording
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.store import canonical
from bagassets_tests.file_clock import next_tick
from bagassets_tests.in_process import build, make_project

pytestmark = pytest.mark.once

PAGE = 4096
LARGE = 1000  # bytes of a message; smaller ones are found with those around them
TARGETS = {"drive.bag": "ros1", "drive": "ros2", "drive.mcap": "mcap"}


class Disk:
    """Counts what a disk would have to give, below a page cache that holds a quarter of the recording."""

    def __init__(self, monkeypatch, file):
        self.content, self.read_bytes = file.read_bytes(), 0
        self.cache, self.most = OrderedDict(), len(self.content) // PAGE // 4
        self.lock = Lock()  # a thread hashes
        monkeypatch.setattr(canonical, "_READ_BYTES", 1 << 16)  # the files are small
        monkeypatch.setattr(digest, "_FOLLOW_BYTES", 1 << 16)
        monkeypatch.setattr(digest, "_MOST_BEHIND_BYTES", 1 << 17)
        self.watch_hashing(monkeypatch, file)
        self.watch_messages(monkeypatch)

    @property
    def times(self):
        """How often the file was read."""
        return self.read_bytes / len(self.content)

    def give(self, begin, end):
        with self.lock:
            for page in range(begin // PAGE, -(-end // PAGE)):
                if page not in self.cache:
                    self.read_bytes += PAGE
                self.cache[page] = True
                self.cache.move_to_end(page)
                if len(self.cache) > self.most:
                    self.cache.popitem(last=False)

    def watch_hashing(self, monkeypatch, file):
        disk, real = self, canonical.FileHasher.read_block

        def step(self, *most):
            read = real(self, *most)
            if Path(self._file.name) == file:
                disk.give(self.position - read, self.position)
            return read

        monkeypatch.setattr(canonical.FileHasher, "read_block", step)

    def watch_messages(self, monkeypatch):
        """See where in the file the messages are that readers return, or the compressed chunks that hold them."""
        disk, guarded = self, Recording._guarded

        def see(self, topics):
            for message in guarded(self, topics):
                if not isinstance(self, PackedRecording) and len(message.data) >= LARGE:
                    disk.find(bytes(message.data))
                yield message

        monkeypatch.setattr(Recording, "_guarded", see)
        for name, real in decompress._DECOMPRESSORS.items():

            def unpack(packed, most_bytes, real=real):
                disk.find(packed)
                return real(packed, most_bytes)

            monkeypatch.setitem(decompress._DECOMPRESSORS, name, unpack)

    def find(self, data):
        begin = self.content.find(data[:400])
        if begin < 0:
            return  # unpacked from what was found before
        if self.content.startswith(data, begin):
            self.give(begin, begin + len(data))
            return
        # SQLite keeps the beginning of a message on a page with others, and the rest on pages of its own, with links.
        self.give(begin, begin + 400)
        end = self.content.find(data[-200:], max(0, begin - 2 * len(data)))
        if end >= 0:
            self.give(max(0, end + 200 - len(data)), end + 200)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive in all formats that have a compression, by compression: rendered once for each, as that is dear."""
    folder = tmp_path_factory.mktemp("drives")
    formats = {
        "none": TARGETS,
        "zstd": ["drive", "drive.mcap"],
        "lz4": ["drive.bag", "drive.mcap"],
        "bz2": ["drive.bag"],
    }

    @cache
    def written(compression):
        targets = [
            Target(folder / compression / one, TARGETS[one], compression) for one in formats[compression]
        ]
        write_recordings(targets, duration_s=2.0)
        return folder / compression

    return written


def project_of(drive, folder, name, compression="none"):
    target, source = folder / "recordings" / name, drive(compression) / name
    target.parent.mkdir()
    (shutil.copytree if source.is_dir() else shutil.copyfile)(source, target)
    recipe = folder / "recipe.yaml"
    recipe.write_text(sample_recipe() + "preview: {enabled: false}\n")
    return recipe, max(one_of(recipe).files, key=lambda file: file.stat().st_size)


def one_of(recipe_file):
    """The only recording."""
    [recording] = discover(load_recipe(recipe_file).bags).recordings.values()
    return recording


def passed(recipe_file):
    """Make the first pass over the only recording; return its result, and what a graph needs."""
    recipe = load_recipe(recipe_file)
    assets, recording = recording_assets(recipe), one_of(recipe_file)
    stat = recording_stat(recording)
    made = first_pass(assets, recording, stat)
    return made, Graph(assets, recording, made.digest.digest, stat)


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("digests", ["no", pytest.param("stored", marks=pytest.mark.long)])
def test_a_cold_build_reads_a_recording_twice(drive, tmp_path, monkeypatch, name, digests):
    recipe, file = project_of(drive, tmp_path, name)
    if digests == "stored":
        recording = one_of(recipe)
        if recording_digest(recording).kept != {path.name: "attribute" for path in recording.files}:
            pytest.skip("this file system has no extended attributes")
    disk = Disk(monkeypatch, file)
    report, _ = build(recipe, monkeypatch)
    assert report.counts()["built"] == 1
    assert 1.6 < disk.times <= 2.05
    with open_project(recipe) as workspace:
        instance = workspace.instance
        assert Records(instance, Naming("test")).of("inventory", name).cached is False


@pytest.mark.parametrize(
    ("name", "compression"),
    [
        *((name, "none") for name in TARGETS),
        pytest.param("drive", "zstd", marks=pytest.mark.long),
        ("drive.bag", "lz4"),
        pytest.param("drive.bag", "bz2", marks=pytest.mark.long),
        pytest.param("drive.mcap", "lz4", marks=pytest.mark.long),
        ("drive.mcap", "zstd"),
    ],
)
def test_hash_and_inventory_take_one_pass(drive, tmp_path, monkeypatch, name, compression):
    recipe, file = project_of(drive, tmp_path, name, compression)
    disk = Disk(monkeypatch, file)
    made, graph = passed(recipe)
    assert made.inventory is not None
    assert disk.times <= 1.05
    # It is the one that a graph asks for, and the digest is that of the content.
    assert graph.node("inventory").outcome.artifact == made.inventory.artifact
    assert recording_digest(one_of(recipe), rehash=True).digest == made.digest.digest


def test_a_bag_compressed_as_a_whole_is_hashed_while_it_is_unpacked(drive, tmp_path, monkeypatch):
    recipe, plain = project_of(drive, tmp_path, "drive")
    file = plain.with_name(f"{plain.name}.zstd")
    file.write_bytes(zstandard.compress(plain.read_bytes()))
    metadata = plain.with_name("metadata.yaml")
    text = (
        metadata.read_text()
        .replace(plain.name, file.name)
        .replace("compression_mode: ''", "compression_mode: FILE")
    )
    metadata.write_text(text.replace("compression_format: ''", "compression_format: zstd"))
    plain.unlink()
    monkeypatch.setattr(canonical, "_READ_BYTES", 1 << 12)
    monkeypatch.setattr(digest, "_FOLLOW_BYTES", 1)
    monkeypatch.setattr(digest, "_MOST_BEHIND_BYTES", 0)
    hashed, step, decompress_file = [0], canonical.FileHasher.read_block, rosbag2.decompress_file

    def count(self, *most):
        read = step(self, *most)
        hashed[-1] += read if Path(self._file.name) == file else 0
        return read

    def unpack(*args):
        decompress_file(*args)
        hashed.append(0)

    monkeypatch.setattr(canonical.FileHasher, "read_block", count)
    monkeypatch.setattr(rosbag2, "decompress_file", unpack)
    made, _ = passed(recipe)
    assert made.inventory is not None
    assert sum(hashed) == file.stat().st_size
    assert hashed[0] > file.stat().st_size - (1 << 12)


@pytest.mark.parametrize(("select", "most"), [(["inventory"], 1.05), ([], 2.05)])
def test_made_ahead_it_takes_no_more_passes(drive, tmp_path, monkeypatch, select, most):
    recipe, file = project_of(drive, tmp_path, "drive.mcap")
    disk = Disk(monkeypatch, file)
    asked = {"recipe": str(recipe), "bags": [], "select": select}
    assert make_first({**asked, "state": str(load_recipe(recipe).state), "stamp": "0" * 64}) == 1
    assert most - 0.15 < disk.times <= most


@pytest.mark.parametrize("ahead", [True, False])
def test_a_damaged_recording_is_refused_while_it_is_hashed_and_then_salvaged(
    drive, tmp_path, monkeypatch, ahead
):
    recipe, file = project_of(drive, tmp_path, "drive.mcap", "zstd")
    recipe.write_text(recipe.read_text().replace("bags:\n", "bags:\n  recover: all\n"))
    content = bytearray(file.read_bytes())
    content[len(content) * 9 // 10] ^= 16
    file.write_bytes(content)
    disk = Disk(monkeypatch, file)
    if ahead:
        asked = {"recipe": str(recipe), "bags": [], "select": []}
        make_first({**asked, "state": str(load_recipe(recipe).state), "stamp": "0" * 64})
        assert 0.9 < disk.times <= 1.05
    report, _ = build(recipe, monkeypatch, select=("inventory",))
    assert report.counts()["built"] == 1
    assert 1.9 < disk.times <= 2.1


@pytest.fixture
def project(tmp_path):
    return make_project(tmp_path / "project")


def left_in(recipe_file):
    """Steps of which there is a record, and what is left of unfinished ones."""
    store = load_recipe(recipe_file).store_path
    steps = [json.loads(path.read_bytes())["action"]["step"] for path in store.glob("actions/*/*.json")]
    return steps, list(store.glob("tmp/*"))


@pytest.mark.parametrize("how", ["grows", "shrinks", "is replaced", "vanishes"])
def test_a_recording_that_changes_meanwhile(project, monkeypatch, how):
    path, real = one_of(project).path, Recording._guarded
    content = path.read_bytes()

    def change(self, topics):
        for number, message in enumerate(real(self, topics)):
            if number == 5:
                next_tick()
                spoil(path, content, how)
            yield message

    monkeypatch.setattr(Recording, "_guarded", change)
    with pytest.raises(ChangedWhileReadError) as raised:
        passed(project)
    told = str(raised.value)
    assert told.startswith(f"{path}: ")
    assert ("was it removed?" if how == "vanishes" else "changed while it was hashed") in told
    assert "\n" not in told
    assert left_in(project) == ([], [])
    monkeypatch.undo()
    path.write_bytes(content)
    assert passed(project)[0].inventory is not None


def test_a_damaged_recording_has_a_digest_and_its_inventory_fails_where_it_is_asked_for(project):
    path = one_of(project).path
    path.write_bytes(path.read_bytes()[:-5000])
    made, graph = passed(project)
    assert made.inventory is None
    assert made.digest.digest == recording_digest(one_of(project), rehash=True).digest
    assert left_in(project) == (["inventory"], []), "that it is refused is on record"
    with pytest.raises(BagAssetsError, match=r"a\.bag"):
        list(execute(graph))


def test_a_disk_that_fails_is_reported_as_when_hashing_alone(project, monkeypatch):
    def fail(*_):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(canonical, "_READ_BYTES", 1 << 12)
    monkeypatch.setattr(canonical.FileHasher, "read_block", fail)
    with pytest.raises(BagAssetsError, match=r"a\.bag: cannot be read \(Input/output error\)"):
        passed(project)
    assert left_in(project) == ([], [])


def test_a_recording_that_was_only_touched_is_just_hashed(project):
    assert passed(project)[0].inventory is not None
    os.utime(one_of(project).path, ns=(1, 1))
    made, graph = passed(project)
    assert made.inventory is None
    assert made.digest.hashed_bytes == one_of(project).size
    assert graph.node("inventory").is_cached


def test_a_recording_of_a_known_content_keeps_its_inventory(project):
    first, _ = passed(project)
    path = one_of(project).path
    path.rename(path.with_name("other.bag"))
    again, _ = passed(project)
    assert again.digest.hashed_bytes in {0, one_of(project).size}  # 0 where its attribute went along
    assert again.inventory is None or again.inventory.cached
    assert again.digest.digest == first.digest.digest


def test_a_run_of_the_recording_alone_makes_no_inventory(project, monkeypatch):
    build(project, monkeypatch, select=("bag",))
    assert "inventory" not in left_in(project)[0]


class TestSeveralProcesses:
    def test_only_one_of_them_makes_the_pass(self, project):
        with ProcessPoolExecutor(2, get_context("spawn")) as pool:
            made = list(pool.map(hashed_bytes, [project] * 2))
        assert sorted(made) == [0, one_of(project).size]


def hashed_bytes(recipe_file):
    return passed(recipe_file)[0].digest.hashed_bytes


def spoil(path, content, how):
    """Change a recording."""
    if how == "grows":
        path.write_bytes(content + b"more")
    elif how == "shrinks":
        path.write_bytes(content[: len(content) // 2])
    elif how == "is replaced":
        other = path.with_name("other")
        other.write_bytes(content)
        other.replace(path)
    else:
        path.unlink()
