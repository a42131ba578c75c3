"""What the build of a recording hands to its steps."""

import pytest

from bagassets.base.errors import CalibrationError, RecordingError, StoreError
from bagassets.engine.execute import BuildFailure
from bagassets.geometry.se3 import SE3
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from bagassets_tests.recording_build import RecordingBuild
from bagassets_tests.small_drive import RECIPE, write_drive

pytestmark = pytest.mark.once

URDF = """<robot name="car">
<joint name="a" type="fixed"><origin xyz="0.25 0.5 1.5"/><parent link="base_link"/><child link="lidar"/></joint>
<joint name="b" type="fixed"><origin xyz="1 2 3"/><parent link="base_link"/><child link="cam"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("build")
    write_drive(folder / "bags" / "a.bag", "ros1", duration_s=0.5)
    return folder


def build_of(folder, fields="", **options):
    text = RECIPE.format(name="test", root="bags").replace("  - name: car\n", f"  - name: car\n{fields}")
    (folder / "recipe.yaml").write_text(text)
    recipe = load_recipe(folder / "recipe.yaml")
    (recording,) = discover(recipe.bags).recordings.values()
    return RecordingBuild(
        recipe,
        Store(recipe.store_path),
        recording,
        recording_digest(recording).digest,
        recording_stat(recording),
        **options,
    )


def test_the_urdf_of_the_recipe_reaches_the_calibration(bags):
    (bags / "car.urdf").write_text(URDF)
    build = build_of(bags, "    urdf: car.urdf\n    tf_static: [/none]\n")
    list(build.build(["inventory", "calibration"]))
    channels = build.last.inputs.calibration.channels
    assert channels["LIDAR_TOP"].ego_SE3_sensor == SE3((1.0, 0.0, 0.0, 0.0), (0.25, 0.5, 1.5))
    assert channels["CAM_FRONT"].ego_SE3_sensor.translation == (1.0, 2.0, 3.0)


def test_what_was_made_before_has_to_be_there(bags):
    with pytest.raises(
        StoreError, match=r"a\.bag: inventory is not materialized .*; materialize inventory first"
    ):
        list(build_of(bags).build(["calibration"]))


def test_a_failure_costs_what_reads_it_and_nothing_else(bags):
    build = build_of(bags, "    ego_frame: nowhere\n")
    made = []
    with pytest.raises(BuildFailure) as caught:
        made += [result.asset for result in build.build()]
    assert set(caught.value.errors) == {"calibration", "ego_poses"}
    assert all(
        isinstance(err, CalibrationError)
        for name, err in caught.value.errors.items()
        if name == "calibration"
    )


def test_what_assets_have_in_common_is_said_once(tmp_path):
    path = tmp_path / "a.bag"
    errors = [
        RecordingError(f"{path}: it changed."),
        RecordingError("no such topic."),
        RecordingError(f"{path}: it changed."),
    ]
    failure = BuildFailure(dict(zip(("frames", "preview", "sweeps"), errors, strict=True)), path)
    assert str(failure).split("\n") == [f"{path}: it changed.", f"{path}: no such topic."]


def test_a_second_build_runs_nothing(bags):
    first = {result.asset: result for result in build_of(bags).build()}
    again = {result.asset: result for result in build_of(bags).build()}
    assert list(again) == list(first)
    assert all(result.cached for result in again.values())
    assert {name: result.artifact for name, result in again.items()} == {
        name: result.artifact for name, result in first.items()
    }
    dry = {result.asset: result for result in build_of(bags, dry=True).build()}
    assert {name: result.action_digest for name, result in dry.items()} == {
        name: result.action_digest for name, result in first.items()
    }
    for asset, channels in (("frames", {"CAM_FRONT"}), ("sweeps", {"LIDAR_TOP"})):
        assert set(first[asset].artifact.read_json("channels.json")) == channels
        counts = first[asset].artifact.summary()
        assert set(counts["channels"]) == channels
        assert counts["bytes"] > 0
