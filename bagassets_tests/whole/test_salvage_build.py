"""Builds of damaged recordings: what `recover` says, what users are shown, and what is made again when."""

import json
import shutil

import pytest
from click.testing import CliRunner

from bagassets.assets.inventory import INVENTORY
from bagassets.base.errors import BagAssetsError
from bagassets.cli.main import root
from bagassets.engine.graph import Graph
from bagassets.engine.plan import BagPlan
from bagassets.formats import dataset_build
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.dataset_lock import load_lock
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Bags
from bagassets.recordings.discover import discover
from bagassets.recordings.salvage.damage_map import VERSION
from bagassets.store.store import Store
from bagassets_tests import in_process
from bagassets_tests.nuscenes_checks import check_dataset
from bagassets_tests.recorded_bags import NOON_NS, text, write_ros1
from bagassets_tests.small_drive import RECIPE, write_drive
from bagassets_tests.store_check import check_store
from bagassets_tests.whole.test_end_to_end import build_of

pytestmark = pytest.mark.once
TEXT = RECIPE.format(name="test", root="bags") + "preview: {enabled: false}\n"


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    names = {"ros1": "a.bag", "ros2": "a", "mcap": "a.mcap"}
    return {kind: write_drive(folder / name, kind, 3.0) for kind, name in names.items()}


def project(tmp_path, recover=None):
    """Write the recipe, and return it."""
    given = f"root: bags, recover: {recover}" if recover else "root: bags"
    (tmp_path / "recipe.yaml").write_text(TEXT.replace("root: bags", given))
    (tmp_path / "bags").mkdir(exist_ok=True)
    return load_recipe(tmp_path / "recipe.yaml")


def without_end(path, target, share=0.6):
    data = path.read_bytes()
    target.write_bytes(data[: int(len(data) * share)])
    return target


def without_index(path, target):
    data = path.read_bytes()
    at = data.index(b"index_pos=") + 10
    end = int.from_bytes(data[at : at + 8], "little")
    target.write_bytes(data[:at] + bytes(8) + data[at + 8 : end])
    return target


def made(recipe, key):
    return {result.asset: result for result in build_of(recipe, key).build()}


def error_of(recipe, key):
    with pytest.raises(BagAssetsError) as caught:
        made(recipe, key)
    return str(caught.value)


def test_a_bag_without_index_gives_what_the_whole_one_gives(tmp_path, drives):
    recipe = project(tmp_path)
    shutil.copy(drives["ros1"], recipe.bags.root / "whole.bag")
    without_index(drives["ros1"], recipe.bags.root / "damaged.bag")
    whole, damaged = made(recipe, "whole.bag"), made(recipe, "damaged.bag")
    for asset in ("calibration", "ego_poses", "frames", "sweeps", "annotations"):
        assert damaged[asset].artifact.digest == whole[asset].artifact.digest
    inventories = [one["inventory"].artifact.read_json("inventory.json") for one in (whole, damaged)]
    damage = inventories[1].pop("damage")
    assert damage["lost"] == {}
    assert "nothing says where it ended" in damage["findings"][1]
    assert inventories[0]["topics"] == inventories[1]["topics"]
    assert list(check_store(Store(recipe.store_path))) == []


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_recover_decides_what_becomes_of_a_cut_recording(tmp_path, drives, kind):
    name = drives[kind].name
    recipe = project(tmp_path, "refuse")
    path = without_end(drives[kind], recipe.bags.root / name)
    refused = error_of(recipe, name)
    assert "recover: all" not in refused
    recipe = project(tmp_path)
    told = error_of(recipe, name)
    assert told.startswith(refused.rstrip("."))
    assert "recover: all" in told
    assert "messages can be read; how many there were is not known" in told
    recipe = project(tmp_path, "all")
    results = made(recipe, name)
    counts = results["frames"].artifact.summary()["channels"]["CAM_FRONT"]
    assert counts["read"] == counts["written"] > 10
    inventory = results["inventory"].artifact
    assert inventory.summary()["damage"].split()[0] == str(inventory.summary()["messages"])
    shown = INVENTORY.face.shown(inventory)
    assert next(iter(shown)) == "damaged"
    assert shown["damaged"].rows[-1][0] == name
    assert all(result.cached for result in made(recipe, name).values())
    assert path.read_bytes() == drives[kind].read_bytes()[: path.stat().st_size]


def test_bytes_behind_its_end_are_no_damage_to_builds(tmp_path, drives):
    recipe = project(tmp_path, "refuse")
    whole = drives["mcap"].read_bytes()
    (recipe.bags.root / "whole.mcap").write_bytes(whole)
    (recipe.bags.root / "behind.mcap").write_bytes(whole + b"more" * 250)
    (sound, behind) = (made(recipe, f"{name}.mcap") for name in ("whole", "behind"))
    for asset in ("calibration", "ego_poses", "frames", "sweeps", "annotations"):
        assert behind[asset].artifact.digest == sound[asset].artifact.digest
    inventory = behind["inventory"].artifact.read_json("inventory.json")
    assert "damage" not in inventory
    assert not any("index" in note for note in inventory["notes"])


def test_only_what_was_salvaged_has_its_version_in_the_key(tmp_path, drives):
    recipe = project(tmp_path)
    shutil.copy(drives["mcap"], recipe.bags.root / "whole.mcap")
    without_index(drives["ros1"], recipe.bags.root / "damaged.bag")
    assert made(recipe, "whole.mcap")
    assert made(recipe, "damaged.bag")
    actions = [json.loads(path.read_bytes()) for path in (recipe.store_path / "actions").rglob("*.json")]
    keyed = [one for one in actions if "salvage" in one["action"]["params"]]
    assert [one["action"]["params"]["salvage"] for one in keyed] == [
        {"version": VERSION, "recover": "complete"}
    ]
    assert {one["action"]["step"] for one in keyed} == {"inventory"}
    changed = project(tmp_path, "all")
    assert all(result.cached for result in made(changed, "whole.mcap").values())
    again = made(changed, "damaged.bag")
    assert not again["inventory"].cached
    assert all(result.cached for asset, result in again.items() if asset != "inventory")


def test_what_failed_before_salvage_existed_is_tried_once_more_and_then_no_more(tmp_path, drives):
    refusing = project(tmp_path, "refuse")
    without_index(drives["ros1"], refusing.bags.root / "a.bag")
    error_of(refusing, "a.bag")

    def state(recipe):
        recording = discover(recipe.bags).recordings["a.bag"]
        return Graph.of(recording_assets(recipe), recording).states()["inventory"]

    assert state(refusing).state == "failed"
    recipe = project(tmp_path)
    assert state(recipe).state == "missing"
    made(recipe, "a.bag")
    assert state(recipe).state == "record-only"
    without_end(drives["ros1"], recipe.bags.root / "a.bag")
    assert state(recipe).state != "failed"
    told = error_of(recipe, "a.bag")
    assert (state(recipe).state, state(recipe).reason) == ("failed", told)


def test_init_looks_into_damaged_recordings_and_lists_what_recorders_left(tmp_path, drives):
    (tmp_path / "bags").mkdir()
    without_end(drives["ros1"], tmp_path / "bags" / "cut.bag")
    (tmp_path / "bags" / "gone.db3-wal").write_bytes(bytes(100))
    done = CliRunner().invoke(root, ["init", str(tmp_path / "project"), "--bags", str(tmp_path / "bags")])
    assert done.exit_code == 0, done.output
    assert "CAM_FRONT" in (tmp_path / "project" / "recipe.yaml").read_text()
    assert "gone.db3-wal: the last messages of gone.db3" in done.output


class TestSeries:
    def parts(self, tmp_path):
        some = [text(NOON_NS + i * 10**8, f"{i}" * 500) for i in range(600)]
        return [write_ros1(tmp_path / f"d_{n}.bag", some[n * 200 : (n + 1) * 200]) for n in range(3)]

    def keys(self, tmp_path, recover="complete"):
        return list(discover(Bags(root=tmp_path, recover=recover, settle_s=0)).recordings)

    def test_a_part_without_index_stays_in_its_drive(self, tmp_path):
        parts = self.parts(tmp_path)
        without_index(parts[1], parts[1])
        assert self.keys(tmp_path) == ["d.bag"]
        assert self.keys(tmp_path, "refuse") != ["d.bag"]
        recipe = project(tmp_path)
        for part in parts:
            part.rename(recipe.bags.root / part.name)
        inventory = next(iter(build_of(recipe, "d.bag").build(["inventory"]))).artifact
        assert inventory.summary()["messages"] == 600
        assert "messages can be read" in inventory.summary()["damage"]

    def test_a_part_that_is_cut_leaves_its_drive_unless_everything_is_wanted(self, tmp_path):
        parts = self.parts(tmp_path)
        without_end(parts[2], parts[2])

        def names(recover):
            found = discover(Bags(root=tmp_path, recover=recover, settle_s=0)).recordings
            return [[part.key for part in one.parts] or one.key for one in found.values()]

        assert names("complete") == [["d_0.bag", "d_1.bag"], "d_2.bag"]
        assert names("all") == [["d_0.bag", "d_1.bag", "d_2.bag"]]

    def test_a_part_in_the_middle_costs_itself_where_the_recipe_says_that_it_is_one_drive(self, tmp_path):
        project(tmp_path)
        for part in self.parts(tmp_path):
            part.rename(tmp_path / "bags" / part.name)
        middle = tmp_path / "bags" / "d_1.bag"
        without_end(middle, middle)
        file = tmp_path / "recipe.yaml"
        file.write_text(file.read_text().replace("root: bags", "root: bags, series: {d.bag: true}"))
        told = error_of(load_recipe(file), "d.bag")
        assert "d_1.bag" in told
        assert "recover: all" in told
        file.write_text(file.read_text().replace("root: bags", "root: bags, recover: all"))
        inventory = next(iter(build_of(load_recipe(file), "d.bag").build(["inventory"]))).artifact
        assert 500 < inventory.summary()["messages"] < 560
        damage = inventory.read_json("inventory.json")["damage"]
        assert {hole["file"] for hole in damage["holes"]} == {"d_1.bag"}


def test_a_whole_build_tells_of_the_damage_everywhere(tmp_path, drives, monkeypatch):
    recipe = project(tmp_path, "all")
    shutil.copy(drives["mcap"], recipe.bags.root / "whole.mcap")
    without_end(drives["ros1"], recipe.bags.root / "cut.bag")
    shutil.copytree(drives["ros2"], recipe.bags.root / "torn")
    (database,) = (recipe.bags.root / "torn").glob("*.db3")
    without_end(database, database, 0.7)
    (recipe.bags.root / "gone.db3-wal").write_bytes(bytes(100))
    (recipe.bags.root / "half.db3.zstd").write_bytes(bytes(100))
    write_project(tmp_path, (tmp_path / "recipe.yaml").read_text())
    report, _ = in_process.build(tmp_path / "recipe.yaml", monkeypatch)
    assert {outcome.result for outcome in report.outcomes.values()} == {"built"}
    check_dataset(recipe.nuscenes.output, recipe.nuscenes.version)
    lock = load_lock(recipe.nuscenes.output).value
    assert set(lock["damaged"]) == {"cut.bag", "torn"}
    assert "messages can be read" in lock["damaged"]["torn"]
    verdicts = json.loads(
        CliRunner().invoke(root, ["check", "--recipe", str(tmp_path / "recipe.yaml"), "--json"]).stdout
    )
    found = {one["recording"]: one["passed"] for one in verdicts if one["check"] == "recording_whole"}
    assert found == {"cut.bag": False, "torn": False, "whole.mcap": True}
    status = CliRunner().invoke(root, ["status", "--recipe", str(tmp_path / "recipe.yaml")]).output
    assert "gone.db3-wal: left out: the last messages of gone.db3" in status
    assert "half.db3.zstd: left out: compressed by a recorder" in status
    page = tmp_path / "report.html"
    CliRunner().invoke(root, ["report", "--recipe", str(tmp_path / "recipe.yaml"), "--output", str(page)])
    assert "lost, in damaged parts of the recording" in page.read_text()
    # A dataset that is made again says the same, without a look at what has not changed.
    known = dataset_build._damaged

    def damaged(*of):
        with monkeypatch.context() as patched:
            patched.setattr(BagPlan, "current_artifact", None)
            return known(*of)

    monkeypatch.setattr(dataset_build, "_damaged", damaged)
    (recipe.bags.root / "whole.mcap").unlink()
    in_process.build(tmp_path / "recipe.yaml", monkeypatch)
    anew = load_lock(recipe.nuscenes.output).value
    assert anew != lock
    assert anew["damaged"] == lock["damaged"]
