"""A recording under another name or suffix: what it comes to does not depend on what was built before."""

import shutil
from pathlib import Path

import pytest

from bagassets.engine.execute import BuildFailure
from bagassets.store.action import Step
from bagassets.store.store import Store
from bagassets_tests.small_drive import RECIPE
from bagassets_tests.tiny_mcap import write_tiny
from bagassets_tests.whole.test_end_to_end import build_of, make_project

pytestmark = pytest.mark.once


@pytest.fixture
def project(tmp_path):
    recipe = make_project(tmp_path, text=RECIPE + "preview: {{enabled: false}}\n")
    recipe.bags.root.mkdir()
    return recipe


def failure_of(recipe, key, **options):
    with pytest.raises(BuildFailure) as caught:
        list(build_of(recipe, key, **options).build())
    return caught.value


def test_another_suffix_is_read_as_another_format_whatever_is_known(project):
    good = write_tiny(project.bags.root / "good.mcap")
    made = {one.asset: one.artifact.digest for one in build_of(project, "good.mcap").build()}
    shutil.copy(good, project.bags.root / "renamed.bag")
    output = str(failure_of(project, "renamed.bag"))
    assert "renamed.bag" in output
    assert "its content is that of an MCAP file, whatever its name says; have its name end in .mcap" in output
    shutil.copy(good, project.bags.root / "other.mcap")
    again = list(build_of(project, "other.mcap").build())
    assert [one.asset for one in again if not one.cached] == ["nuscenes_tables"]
    assert again[0].artifact.digest == made["inventory"]


def kept_errors(recipe):
    return [path.read_text() for path in (recipe.store_path / "actions").rglob("*.failed.json")]


def told_by_plan(recipe, key):
    """Return the message of a failure on record, without trying again."""
    (err,) = failure_of(recipe, key, dry=True).errors.values()
    return str(err)


def test_a_failure_on_record_is_reported_for_the_recording_at_hand(project):
    first, second = project.bags.root / "first.bag", project.bags.root / "second.bag"
    first.touch()
    failure_of(project, "first.bag")
    assert len(kept_errors(project)) == 2, "of the ordinary reader, and of what saves damaged recordings"
    assert not [error for error in kept_errors(project) if str(first) in error]
    assert told_by_plan(project, "first.bag").startswith(f"{first}: the file is empty")
    first.rename(second)
    assert told_by_plan(project, "second.bag").startswith(f"{second}: the file is empty")


def test_empty_files_of_three_formats_are_reported_by_their_own_names(project):
    names = ("empty.bag", "empty.db3", "empty.mcap")
    for name in names:
        (project.bags.root / name).touch()
        failure_of(project, name)
    for name in names:
        assert told_by_plan(project, name).startswith(f"{project.bags.root / name}: the file is empty")


def test_files_beside_the_recording_keep_their_names(tmp_path):
    store, action = Store(tmp_path), Step("a", 1).action({}, {})
    store.record_failure(action, "/r/a: see /r/a.json, /r/a-2, /r/ab, /r/a/0.db3 and /r/a.", Path("/r/a"))
    output = store.failure(action.digest, Path("/r/new"))
    assert output == "/r/new: see /r/a.json, /r/a-2, /r/ab, /r/new/0.db3 and /r/new."
