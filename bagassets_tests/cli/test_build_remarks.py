"""What a build tells besides its table: findings of checks, copies, recordings that are all gone."""

import json
import shutil

import pytest

from bagassets_tests.in_process import run_command
from bagassets_tests.small_drive import RECIPE, write_drive

pytestmark = [pytest.mark.xdist_group("build_remarks"), pytest.mark.once]


def run(folder, *args):
    return run_command("build", "--recipe", folder / "recipe.yaml", *args)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("remarks")
    write_drive(folder / "bags" / "a.bag", "ros1")
    shutil.copy(folder / "bags" / "a.bag", folder / "bags" / "copy.bag")
    write_drive(folder / "bags" / "short.mcap", "mcap", duration_s=0.6)
    text = RECIPE.format(name="remarks", root="bags")
    text = text.replace("    channels:", "    annotations: [{topic: /boxes}]\n    channels:")
    text += "      RADAR_FRONT: {modality: radar, topic: /radr}\n"
    (folder / "recipe.yaml").write_text(text)
    return folder, run(folder)


def test_what_is_to_be_decided_for_one_rig_fails_its_recordings_only(tmp_path):
    for name, kind in (("a.bag", "ros1"), ("van.mcap", "mcap")):
        write_drive(tmp_path / "bags" / name, kind, duration_s=1.0)
    text = RECIPE.format(name="two", root="bags") + "preview: {enabled: false}\n"
    before, _, after = text.partition("rigs:\n")
    van = (
        '  - name: van\n    match: ["van*"]\n    ego_pose:\n'
        "    channels: {CAM_FRONT: {modality: camera, topic: /cam/image_raw}}\n"
    )
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(f"{before}rigs:\n{van}{after}")
    done = run(tmp_path, "--json")
    line = recipe.read_text().splitlines().index("    ego_pose:") + 1
    found = json.loads(done.stdout)["recordings"]
    assert (done.returncode, found["a.bag"]["result"], found["van.mcap"]["result"]) == (
        1,
        "built",
        "failed",
    )
    assert found["van.mcap"]["reason"].startswith(f"{recipe}:{line}: rigs[van].ego_pose: needs a value")
    recipe.write_text(recipe.read_text().replace("    ego_pose:\n", "    ego_pose: {source: fixed}\n"))
    decided = run(tmp_path, "--json")
    found = json.loads(decided.stdout)["recordings"]
    assert {one["result"] for one in found.values()} <= {"built", "hit", "fresh"}
    assert found["van.mcap"]["result"] == "built"


def test_what_checks_find_in_what_was_built_is_reported(project):
    _, done = project
    assert done.returncode == 0, done.stdout + done.stderr
    output = done.stdout
    assert "error a.bag: RADAR_FRONT: topic /radr is not in the recording" in output
    assert "(and 1 more)" in output
    assert "warn short.mcap: it has no scene: " in output
    assert "scenes.min_length_s" in output


def test_a_copy_is_reported(project):
    _, done = project
    assert "copy copy.bag: the same content as a.bag, which is in the dataset for both" in done.stdout


def test_all_recordings_gone_at_once_is_a_question_not_a_fact(project):
    folder, _ = project
    (folder / "bags").rename(folder / "elsewhere")
    (folder / "bags").mkdir()
    scenes = folder / "dataset" / "nuscenes" / "v1.0-test" / "scene.json"
    before = scenes.read_bytes()
    refused = run(folder)
    assert refused.returncode == 1
    assert "all 3 recordings that were here before cannot be found; is the disk mounted" in refused.stderr
    assert scenes.read_bytes() == before
    output = json.loads(run(folder, "--allow-empty", "--json").stdout)
    assert output["removed"] == ["a.bag", "copy.bag", "short.mcap"]
    assert json.loads(scenes.read_bytes()) == []


def test_a_dataset_that_was_never_made_is_not_up_to_date(tmp_path):
    write_drive(tmp_path / "bags" / "a.bag", "ros1", duration_s=1.0)
    (tmp_path / "recipe.yaml").write_text(
        RECIPE.format(name="odom", root="bags").replace("/odom}", "/odomm}")
    )
    done = run(tmp_path)
    assert done.returncode == 1
    assert "dataset: " in done.stdout
    assert "(not made)" in done.stdout
