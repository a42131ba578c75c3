"""Named datasets: the scenes that were asked for, whole and consistent, and nothing made twice."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.base.errors import RecipeError
from bagassets.engine.plan import AssetState, BagPlan, Plan
from bagassets.formats.assembly import assemble
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.dataset_build import Dataset, DatasetInputs, build_dataset, dataset_code_versions
from bagassets.formats.dataset_lock import read_lock
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.selection import inside, unmet_condition
from bagassets.formats.nuscenes.table_file import read_table
from bagassets.recipe import load_recipe
from bagassets.recipe.model_datasets import NamedDataset, moment_ns
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.store.store import Store
from bagassets_tests.devkit import run_devkit
from bagassets_tests.nuscenes_checks import check_dataset
from bagassets_tests.sample_drives import build_recordings

pytestmark = pytest.mark.once

SCENE = {
    "name": "monday_001",
    "start_ns": moment_ns("2025-06-15T12:00:00+02:00"),
    "speed_mps": 7.0,
    "boxes": {"vehicle.car": 12, "human.pedestrian.adult": 1},
    "points": [[48.0, 11.0], [48.1, 11.1]],
    "daylight": "day",
}


def refused(scene=SCENE, rig="car", key="monday.bag", **fields):
    return unmet_condition(NamedDataset(name="n", **fields), rig, key, scene)


class TestConditions:
    def test_without_conditions_every_scene_belongs(self):
        assert refused() is None

    @pytest.mark.parametrize(
        ("fields", "words"),
        [
            ({"rigs": ("truck",)}, "made by rig car"),
            ({"recordings": ("tue*",)}, "not one of the recordings"),
            ({"scenes": ("monday_00[02]",)}, "not one of the scenes"),
            ({"since": "2025-06-16"}, "begins before 2025-06-16"),
            ({"until": "2025-06-15T10:00:00"}, "does not begin before"),
            ({"place": ((47.0, 10.0), (47.0, 10.5), (47.5, 10.2))}, "elsewhere"),
            ({"daylight": ("night", "twilight")}, "day"),
            ({"labels": ("vehicle.car", "vehicle.b*")}, "no vehicle.b*"),
            ({"min_speed_mps": 7.5}, "slower than 7.5 m/s"),
        ],
    )
    def test_each_condition_is_reported(self, fields, words):
        assert words in refused(**fields)

    @pytest.mark.parametrize(
        "fields",
        [
            {"rigs": ("car", "truck")},
            {"recordings": ("mon*",)},
            {"scenes": ("monday_001",)},
            {"since": "2025-06-15", "until": "2025-06-15T10:00:01"},
            {"place": ((48.05, 11.05), (48.05, 12.0), (49.0, 12.0), (49.0, 11.05))},
            {"daylight": ("day",)},
            {"labels": ("vehicle.*", "human.*")},
            {"min_speed_mps": 7.0},
        ],
    )
    def test_each_condition_can_be_met(self, fields):
        assert refused(**fields) is None

    def test_what_is_not_known_is_not_guessed(self):
        nowhere = {**SCENE, "points": [], "daylight": None}
        assert refused(nowhere, place=((0.0, 0.0), (0.0, 1.0), (1.0, 0.0))) == "its place is not known"
        assert refused(nowhere, daylight=("day",)) == "its daylight is not known"

    def test_days_are_those_of_utc_unless_a_zone_is_said(self):
        assert moment_ns("1970-01-02") == 86_400 * 10**9
        assert moment_ns("1970-01-01T02:00:00+02:00") == 0


class TestPolygon:
    SQUARE = ((0.0, 0.0), (0.0, 10.0), (10.0, 10.0), (10.0, 0.0))
    HORSESHOE = (
        (0.0, 0.0),
        (0.0, 10.0),
        (10.0, 10.0),
        (10.0, 7.0),
        (3.0, 7.0),
        (3.0, 3.0),
        (10.0, 3.0),
        (10.0, 0.0),
    )

    @given(st.floats(-20, 20), st.floats(-20, 20))
    def test_a_square_holds_what_lies_between_its_sides(self, lat, lon):
        strictly = 0 < lat < 10 and 0 < lon < 10
        on_edge = lat in (0, 10) or lon in (0, 10)
        if not on_edge:
            assert inside((lat, lon), self.SQUARE) == strictly
            assert inside((lat, lon), self.SQUARE[::-1]) == strictly

    def test_a_concave_one_has_a_hollow(self):
        assert not inside((6.0, 5.0), self.HORSESHOE)
        assert inside((6.0, 1.0), self.HORSESHOE)
        assert inside((1.0, 5.0), self.HORSESHOE)


DATASETS = """
scenes: {keyframe_hz: 2, length_s: 1.5}
datasets:
  - {name: second-scenes, scenes: ["*_001"], version: v1.0-second}
  - {name: all}
  - {name: night, daylight: [night]}
  - {name: monday, recordings: ["monday*"], output: nuscenes, version: v1.0-monday}
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("named")
    for seed, name in enumerate(["monday.mcap", "tuesday.mcap"]):
        write_recordings([Target(folder / "recordings" / name, "mcap")], seed=seed, duration_s=3.4)
    text = sample_recipe().replace("scenes:\n  keyframe_hz: 2\n  length_s: 20\n", "")
    (folder / "recipe.yaml").write_text(text + DATASETS)
    recipe = load_recipe(folder / "recipe.yaml")
    return recipe, build_recordings(recipe)


def state(recipe, made):
    bags, parts = {}, []
    for key, assets in made.items():
        states = {
            name: AssetState("fresh", "", assets[name].artifact.digest)
            for name in recording_assets(recipe).names
        }
        bags[key] = BagPlan(key, {"bag": AssetState("fresh", "", key), **states}, "mcap")
        parts.append(Part(key, key, assets["nuscenes_tables"].artifact.digest))
    return Plan(bags, {}, ()), DatasetInputs({"nuscenes": tuple(parts)})


def make(built, name, **update):
    recipe, made = built
    plan, inputs = state(recipe, made)
    wanted = next(dataset for dataset in recipe.datasets if dataset.name == name).model_copy(update=update)
    settings = recipe.nuscenes.model_copy(
        update={"output": wanted.output, "version": wanted.version or recipe.nuscenes.version}
    )
    store = Store(recipe.store_path)
    dataset = Dataset(wanted.asset, NUSCENES, settings, wanted)
    chosen = NUSCENES.select(recipe, store, plan, inputs.parts["nuscenes"], wanted)
    return (build_dataset(dataset, recipe, store, plan, inputs), chosen), wanted


class TestDatasets:
    @pytest.mark.devkit
    def test_some_scenes_of_each_recording_make_a_dataset_that_the_devkit_walks(self, built):
        (summary, chosen), wanted = make(built, "second-scenes")
        assert chosen.left_out == {"not one of the scenes": 2}
        scenes = read_table(wanted.output / "v1.0-second", "scene")
        assert [row["name"] for row in scenes] == ["monday.mcap_001", "tuesday.mcap_001"]
        assert check_dataset(wanted.output, "v1.0-second") == []
        walked = run_devkit("devkit_walk.py", wanted.output, "v1.0-second")
        assert len(walked["scenes"]) == 2
        assert summary.facts["rows"]["sample"] == sum(row["nbr_samples"] for row in scenes)

    def test_rows_are_those_of_the_whole_dataset(self, built, tmp_path):
        recipe, made = built
        (_, _), wanted = make(built, "second-scenes")
        parts = [Part(key, key, assets["nuscenes_tables"].artifact.digest) for key, assets in made.items()]
        whole = assemble(NUSCENES, parts, recipe.nuscenes, Store(recipe.store_path), tmp_path)
        for table in ("scene", "sample", "sample_data", "sample_annotation", "instance", "ego_pose"):
            all_rows = {row["token"]: row for row in read_table(whole.folder, table)}
            some = read_table(wanted.output / "v1.0-second", table)
            assert 0 < len(some) < len(all_rows), table
            assert all(all_rows[row["token"]] == row for row in some), table

    def test_files_are_links_and_only_those_of_the_scenes(self, built):
        (_, _), wanted = make(built, "second-scenes")
        named = {row["filename"] for row in read_table(wanted.output / "v1.0-second", "sample_data")}
        on_disk = {
            path.relative_to(wanted.output).as_posix()
            for folder in ("samples", "sweeps")
            for path in (wanted.output / folder).rglob("*")
            if path.is_file()
        }
        assert on_disk == named
        assert all((wanted.output / name).stat().st_nlink >= 2 for name in named)

    def test_all_scenes_are_the_tables_of_the_recordings_themselves(self, built):
        _, made = built
        (_, chosen), _ = make(built, "all")
        assert {part.artifact for part in chosen.parts} == {
            assets["nuscenes_tables"].artifact.digest for assets in made.values()
        }

    def test_a_dataset_without_scenes_is_empty_and_says_why(self, built):
        (summary, chosen), wanted = make(built, "night")
        assert summary.facts["rows"]["scene"] == 0
        assert chosen.left_out == {"day": 4}
        lock = read_lock(wanted.output / "v1.0-sample").value
        assert lock["skipped"]["monday.mcap"] == "no scene belongs to it: 2 day"

    def test_versions_may_share_the_dataroot_of_the_whole_dataset(self, built):
        recipe, made = built
        parts = [Part(key, key, assets["nuscenes_tables"].artifact.digest) for key, assets in made.items()]
        assemble(NUSCENES, parts, recipe.nuscenes, Store(recipe.store_path), recipe.nuscenes.output)
        (summary, _), _ = make(built, "monday")
        assert summary.files.get("linked", 0) == 0, "its files are there already"
        assert check_dataset(recipe.nuscenes.output, "v1.0-monday") == []
        assert check_dataset(recipe.nuscenes.output, "v1.0-sample") == []

    def test_a_selection_that_shrinks_leaves_nothing_behind(self, built, tmp_path):
        make(built, "all", output=tmp_path)
        make(built, "all", output=tmp_path, scenes=("monday*_000",))
        files = {path.name for path in (tmp_path / "samples").rglob("*") if path.is_file()}
        assert files
        assert all("monday" in name for name in files)
        assert check_dataset(tmp_path, "v1.0-sample") == []

    def test_nothing_is_made_twice(self, built):
        recipe, made = built
        store, (plan, inputs) = Store(recipe.store_path), state(recipe, made)
        make(built, "second-scenes")
        before = sorted(path.name for path in (recipe.store_path / "actions").rglob("*.json"))
        NUSCENES.select(recipe, store, plan, inputs.parts["nuscenes"], recipe.datasets[0])
        NUSCENES.select(recipe, store, plan, inputs.parts["nuscenes"], recipe.datasets[1])
        assert sorted(path.name for path in (recipe.store_path / "actions").rglob("*.json")) == before

    def test_facts_about_scenes_are_true(self, built):
        recipe, made = built
        plan, inputs = state(recipe, made)
        store = Store(recipe.store_path)
        NUSCENES.select(recipe, store, plan, inputs.parts["nuscenes"], recipe.datasets[0])
        files = (recipe.store_path / "artifacts").rglob("scenes.json")
        facts = next(
            value
            for value in map(json.loads, (f.read_text() for f in files))
            if value["key"] == "monday.mcap"
        )
        first, second = facts["scenes"]
        assert second["start_ns"] - first["start_ns"] == pytest.approx(1.5e9, abs=0.15e9)
        poses = made["monday.mcap"]["ego_poses"].artifact.read_table("ego_poses.parquet")
        stamps = poses["stamp_ns"].to_numpy()
        during = (stamps >= first["start_ns"]) & (stamps <= first["end_ns"])
        steps = np.diff(np.stack([poses[name].to_numpy()[during] for name in "xyz"], axis=1), axis=0)
        driven_m = np.linalg.norm(steps, axis=1).sum()
        assert first["length_m"] == pytest.approx(driven_m, rel=0.03)
        assert first["speed_mps"] == pytest.approx(
            driven_m * 1e9 / (first["end_ns"] - first["start_ns"]), rel=0.03
        )
        assert first["boxes"]["vehicle.car"] > 0
        assert first["daylight"] == "day"
        assert first["points"][0][0] == pytest.approx(48.0775, abs=1e-3)


class TestRecipe:
    def test_each_is_an_asset_with_a_version_of_its_own(self, built):
        recipe, _ = built
        versions = dataset_code_versions(recipe)
        assert "dataset_second_scenes" in versions
        assert len({versions[dataset.asset] for dataset in recipe.datasets}) == 4

    @pytest.mark.parametrize(
        ("datasets", "words"),
        [
            (
                "[{name: a}, {name: a}]",
                "datasets[1].name: would have the same asset name as the dataset a; rename one",
            ),
            ("[{name: a-b}, {name: a.b}]", "the same asset name as the dataset a-b"),
            ("[{name: a, place: [[48, 11], [49, 11]]}]", "a polygon needs three corners"),
            ("[{name: a, place: [[48, 11], [49, 11], [111, 48]]}]", "latitude comes first"),
            ("[{name: a, rigs: [bus]}]", "bus is not a rig of this recipe"),
            ("[{name: a, since: yesterday}]", "as in 2025-06-15"),
            ("[{name: a, since: 2025-06-15, until: 2025-06-15}]", "must be later than since"),
            ("[{name: a, output: nuscenes}]", "must be different"),
            ("[{name: a, output: x}, {name: b, output: x/y}]", "output of a"),
            ("[{name: a, daylight: [dusk]}]", "day, twilight or night"),
        ],
    )
    def test_wrong_selections_are_refused(self, tmp_path, datasets, words):
        (tmp_path / "recipe.yaml").write_text(sample_recipe() + f"datasets: {datasets}\n")
        with pytest.raises(RecipeError) as caught:
            load_recipe(tmp_path / "recipe.yaml")
        assert words in str(caught.value)
