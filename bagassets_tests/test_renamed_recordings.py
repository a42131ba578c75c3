"""A recording under another name or suffix: what it comes to does not depend on what was built before."""

import shutil

import pytest

from bagassets.engine.recording_build import BuildFailure
from bagassets_tests.small_drive import RECIPE
from bagassets_tests.test_end_to_end import build_of, make_project
from bagassets_tests.tiny_mcap import write_tiny


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
    told = str(failure_of(project, "renamed.bag"))
    assert "renamed.bag" in told
    assert "rosbag reindex" in told
    shutil.copy(good, project.bags.root / "other.mcap")
    again = list(build_of(project, "other.mcap").build())
    assert [one.asset for one in again if not one.cached] == ["nuscenes_tables"]
    assert again[0].artifact.digest == made["inventory"]
