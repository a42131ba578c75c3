"""Datasets too large for the memory are checked by some of their recordings, and those are whole."""

import shutil

import pytest
from handmade import Drive, make_tables

from bagassets.base.errors import DatasetError
from bagassets.formats.assembly import assemble
from bagassets.formats.checking import check_dataset, dataset_checks
from bagassets.formats.dataset_build import datasets_of
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.dataset_checks import (
    CHECKS,
    check,
    dataset_files_match,
    dataset_references_intact,
    dataset_tokens_unique,
)
from bagassets.formats.nuscenes.dataset_rows import read_dataset, repeated_tokens
from bagassets.formats.nuscenes.devkit_rules import devkit_ready
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.schema import TABLES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.formats.nuscenes.table_file import read_table
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_checks import Checks
from bagassets.store.store import Store
from bagassets_tests.nuscenes_checks import check_tables

pytestmark = pytest.mark.once

VERSION = "v1.0-test"
RECORDINGS = 6


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    store = Store(folder / "store")
    parts = []
    for number in range(RECORDINGS):
        tables = make_tables(store, Drive(seconds=2.2, seed=number), key=f"drive_{number}").artifact
        parts.append(Part(f"drive_{number}", str(number), tables.digest))
    assemble(NUSCENES, parts, NuScenes(version=VERSION), store, folder / "nuscenes")
    return folder / "nuscenes"


@pytest.fixture
def dataset(original, tmp_path):
    return shutil.copytree(original, tmp_path / "nuscenes")


def size_of(dataset):
    return sum((dataset / VERSION / f"{name}.json").stat().st_size for name in TABLES)


RULES = (dataset_references_intact, dataset_tokens_unique, dataset_files_match, devkit_ready)


@pytest.mark.parametrize(("share", "recordings"), [(2.0, 6), (0.5, 3), (0.34, 2), (0.01, 1)])
def test_the_rows_of_some_recordings_are_closed_in_themselves(dataset, share, recordings):
    rows = read_dataset(dataset, VERSION, round(share * size_of(dataset)))
    assert (rows.recordings, rows.of, rows.is_whole) == (recordings, RECORDINGS, recordings == RECORDINGS)
    assert len(rows.tables["scene"]) == recordings
    assert len(rows.scenes) == RECORDINGS
    for table in ("sample_data", "ego_pose", "sample_annotation", "instance", "calibrated_sensor"):
        whole = read_table(dataset / VERSION, table)
        assert len(rows.tables[table]) == pytest.approx(len(whole) * recordings / RECORDINGS, abs=3)
        assert all(row in whole for row in rows.tables[table][:5])
    assert check_tables(rows.tables) == []
    for rule in RULES:
        assert list(rule(rows).problems) == []
    assert dataset_tokens_unique(rows).facts["recordings_checked"] == recordings


def last_of(dataset, table):
    return (dataset / VERSION / f"{table}.json").read_text().splitlines()[-2]


def append(dataset, table, row):
    path = dataset / VERSION / f"{table}.json"
    path.write_text(path.read_text().removesuffix("\n]\n") + f",\n{row}\n]\n")


@pytest.mark.parametrize("share", [2.0, 0.3])
def test_a_token_that_two_recordings_share_is_found_whichever_rows_are_read(dataset, share):
    row = last_of(dataset, "ego_pose")
    token = row.split('"')[3]
    append(dataset, "ego_pose", row)
    append(dataset, "ego_pose", row)
    rows = read_dataset(dataset, VERSION, round(share * size_of(dataset)))
    (problem,) = dataset_tokens_unique(rows).problems
    assert problem == f"ego_pose: 1 token appears more than once: {token}."


def test_tokens_that_only_begin_alike_are_not_the_same(dataset):
    row = last_of(dataset, "log")
    token = row.split('"')[3]
    append(dataset, "log", row.replace(token, token[:16] + "0" * 16))
    assert list(repeated_tokens(dataset / VERSION)) == []


@pytest.mark.parametrize("share", [2.0, 0.3])
def test_files_that_are_gone_or_empty_are_named(dataset, share):
    budget = round(share * size_of(dataset))
    rows = read_dataset(dataset, VERSION, budget)
    images = [row["filename"] for row in rows.tables["sample_data"] if row["filename"].endswith(".jpg")]
    gone, empty = images[0], images[1]
    (dataset / gone).unlink()
    (dataset / empty).unlink()
    (dataset / empty).touch()
    problems = dataset_files_match(rows).problems
    assert [problem.rsplit(" ", 1)[-1] for problem in problems] == [f"{gone}.", f"{empty}."]


def test_a_broken_link_in_a_recording_that_is_read_is_named(dataset):
    path = dataset / VERSION / "sample_data.json"
    lines = path.read_text().splitlines()
    token = lines[1].split('"')[3]
    lines[1] = lines[1].replace('"ego_pose_token":"', '"ego_pose_token":"f')
    path.write_text("\n".join(lines) + "\n")
    rows = read_dataset(dataset, VERSION, size_of(dataset) // 4)
    (problem,) = dataset_references_intact(rows).problems
    assert token in problem


@pytest.mark.parametrize(
    ("table", "damaged"),
    [("sample_data", "sample_toke"), ("ego_pose", "toke")],
)
def test_a_row_without_its_token_is_reported_where_not_all_rows_are_read(dataset, table, damaged):
    path = dataset / VERSION / f"{table}.json"
    lines = path.read_text().splitlines()
    lines[1] = lines[1].replace(f'"{damaged}n":"', f'"{damaged}":"')
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(DatasetError, match=f"{table}.json: this nuScenes table cannot be read .a row has no"):
        read_dataset(dataset, VERSION, size_of(dataset) // 4)


def make_recipe(output, **fields):
    rig = {
        "name": "car",
        "ego_pose": {"source": "fixed"},
        "channels": {"CAM": {"modality": "camera", "topic": "/c"}},
    }
    settings = NuScenes(output=output, version=VERSION)
    return Recipe(name="x", bags={"root": output}, rigs=[rig], nuscenes=settings, **fields)


def test_all_checks_are_made_that_are_not_skipped(dataset):
    recipe = make_recipe(dataset)
    (made,) = datasets_of(recipe).values()
    names = dataset_checks(recipe, NUSCENES)
    assert names.keys() == {check.name for check in CHECKS}
    assert check_dataset(made, names.keys()).keys() == names.keys()
    some = make_recipe(dataset, checks=Checks.model_validate({"files_match": {"severity": "skip"}}))
    assert names.keys() - dataset_checks(some, NUSCENES).keys() == {"dataset_files_match"}
    few = check_dataset(made, {"devkit_ready"})
    assert few.keys() == {"devkit_ready"}


def test_a_dataset_without_recordings_passes(tmp_path):
    assemble(NUSCENES, [], NuScenes(version=VERSION), Store(tmp_path / "store"), tmp_path / "empty")
    settings = NuScenes(output=tmp_path / "empty", version=VERSION)
    for finding in check(settings, {one.name for one in CHECKS}).values():
        assert list(finding.problems) == []
