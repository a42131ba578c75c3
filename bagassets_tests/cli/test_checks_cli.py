"""`bagassets check` on a real project."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from bagassets.cli.main import root
from bagassets.formats import checking
from bagassets.formats.catalogue import OUR_ASSETS, recording_assets
from bagassets.formats.nuscenes.dataset_checks import CHECKS as DATASET_CHECKS
from bagassets.recipe import load_recipe, parse_recipe
from bagassets.store.store import Store
from bagassets_tests.in_process import QUICK, build, make_project

pytestmark = pytest.mark.once

GOOD, SHORT = "a.mcap", "b.mcap"
PASSED, USAGE, FOUND = 0, 2, 3
# Of the assets that this recipe asks for: not of signals, for one.
ASSETS = recording_assets(parse_recipe(QUICK.format(name="test", root="."), Path("recipe.yaml")))
ALL = {check.name for asset in ASSETS for check in asset.checks} | {check.name for check in DATASET_CHECKS}


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """One recording, and one that is skipped."""
    folder = tmp_path_factory.mktemp("check")
    text = QUICK.replace("settle_s: 0", "settle_s: 0, min_duration_s: 1.2")
    recipe_file = make_project(folder, [GOOD], text=text, duration_s=1.5)
    make_project(folder / "short", [SHORT], duration_s=1.0)
    (folder / "short" / "bags" / SHORT).rename(folder / "bags" / SHORT)
    return recipe_file


@pytest.fixture(scope="module")
def built(project):
    with pytest.MonkeyPatch.context() as patch:
        build(project, patch)
    return project


@pytest.fixture
def with_checks(built):
    """Change the recipe's checks."""
    text = built.read_text()

    def change(checks):
        built.write_text(f"{text}\nchecks: {json.dumps(checks)}\n")
        return built

    yield change
    built.write_text(text)


def run(*args, recipe):
    return CliRunner().invoke(
        root, ["check", *map(str, args), "--recipe", str(recipe)], standalone_mode=False
    )


def test_before_anything_is_built_no_check_is_made(project):
    # The module's first test.
    done = run("--json", recipe=project)
    assert done.return_value == PASSED
    verdicts = json.loads(done.stdout)
    assert {verdict["passed"] for verdict in verdicts} == {None}


def test_what_was_built_passes_every_check(built):
    done = run("--json", recipe=built)
    assert done.return_value == PASSED
    verdicts = json.loads(done.stdout)
    assert {verdict["check"] for verdict in verdicts} == ALL
    assert {verdict["passed"] for verdict in verdicts} == {True}
    assert {verdict["recording"] for verdict in verdicts} == {GOOD, None}  # nothing about the skipped one
    assert run(recipe=built).stdout == f"{len(ALL)} checks: {len(ALL)} passed.\n"


def test_what_has_not_changed_is_not_checked_again(with_checks, monkeypatch):
    recipe = with_checks({"topic_rates": {"limits": {"/odom": {"min_hz": 60}}}})
    checked, check_bag = [], checking.check_bag

    def noted(*args, **options):
        checked.append(args[2].key)
        return check_bag(*args, **options)

    monkeypatch.setattr(checking, "check_bag", noted)
    run(recipe=recipe)  # it is planned anew, as the recipe has changed
    first, checked[:] = run("--json", recipe=recipe).stdout, []
    assert run("--json", recipe=recipe).stdout == first
    assert checked == []
    assert [one["check"] for one in json.loads(first) if one["passed"] is False] == ["topic_rates"]
    store = Store(load_recipe(recipe).store_path)
    poses = next(store.root.glob("artifacts/*/*/files/ego_poses.parquet"))
    stranger = poses.with_name("stranger")
    stranger.touch()
    assert run("--json", recipe=recipe).stdout == first
    assert GOOD in checked, "somebody was at its artifact"
    stranger.unlink()


def test_a_threshold_counts_at_once_and_an_error_ends_with_status_3(with_checks):
    recipe = with_checks({"topic_rates": {"severity": "error", "limits": {"/odom": {"min_hz": 60}}}})
    done = run(recipe=recipe)
    assert done.return_value == FOUND
    first, second, last = done.stdout.splitlines()
    assert first == f"error {GOOD}: topic_rates"
    assert second.strip().startswith("/odom: ")
    assert second.endswith(" Hz, at least 60 Hz expected")
    assert last == f"{len(ALL)} checks: {len(ALL) - 1} passed, 1 error."


def test_a_warning_is_printed_and_ends_well(with_checks):
    done = run(recipe=with_checks({"calibration_plausible": {"max_distance_m": 0.1}}))
    assert done.return_value == PASSED
    assert done.stdout.startswith(f"warn  {GOOD}: calibration_plausible\n      CAM_FRONT: is ")


def test_one_recording_is_checked_without_the_dataset(built):
    done = run("--bag", GOOD, "--json", recipe=built)
    assert {verdict["recording"] for verdict in json.loads(done.stdout)} == {GOOD}


def test_a_skipped_recording_is_said_to_be_skipped(built):
    first, last = run("--bag", SHORT, recipe=built).stdout.splitlines()
    assert re.fullmatch(rf"skipped {SHORT}: .+ bags\.min_duration_s asks for .+", first)
    assert last == "0 checks: none."
    assert "skipped" not in run(recipe=built).stdout, "status lists them"
    assert json.loads(run("--bag", SHORT, "--json", recipe=built).stdout) == []


def test_an_unknown_recording_is_wrong_usage(built):
    done = CliRunner().invoke(root, ["check", "--bag", "nope", "--recipe", str(built)])
    assert done.exit_code == USAGE
    assert "nope: no such recording" in done.output


def test_skipped_checks_are_not_made(with_checks):
    done = run("--json", recipe=with_checks({"files_match": {"severity": "skip"}}))
    assert {verdict["check"] for verdict in json.loads(done.stdout)} == ALL - {
        "files_match",
        "dataset_files_match",
    }
    assert json.loads(run("--json", recipe=with_checks({"enabled": False})).stdout) == []


def test_an_artifact_that_is_gone_is_a_finding(built):
    recipe = load_recipe(built)
    done = json.loads(run("--json", "--bag", GOOD, recipe=built).stdout)
    assert all(verdict["passed"] for verdict in done)
    manifests = [
        path
        for path in (recipe.store_path / "artifacts").rglob("manifest.json")
        if (path.parent / "files" / "calibration.json").is_file()
    ]
    hidden = manifests[0].rename(manifests[0].with_name("hidden"))
    try:
        done = {
            verdict["check"]: verdict
            for verdict in json.loads(run("--json", "--bag", GOOD, recipe=built).stdout)
        }
        assert "is not in the store" in done["calibration_plausible"]["problems"][0]
    finally:
        hidden.rename(manifests[0])


def test_the_table_of_the_documentation_is_that_of_the_assets():
    result = CliRunner().invoke(root, ["docs", "checks"])
    text = (Path(__file__).parents[2] / "docs" / "checks.md").read_text(encoding="utf-8")
    assert result.stdout in text, "docs/checks.md is out of date: make docs"
    assert {line.split("`")[1] for line in result.stdout.splitlines()[2:]} == {
        check.name for asset in OUR_ASSETS for check in asset.checks
    }
