"""By the command: every sample has every channel, and what that costs is said at the end of the build."""

import json
from collections import Counter

import pytest

from bagassets_tests.in_process import QUICK, run_command
from bagassets_tests.small_drive import START_NS, write_drive

pytestmark = [pytest.mark.xdist_group("complete_samples"), pytest.mark.once]

STOPS_NS = START_NS + 1_150_000_000
STALE = 3


def run(folder, command, *args):
    return run_command(command, "--recipe", folder / "recipe.yaml", *args)


def camera_stops(topic, stamp_ns):
    return not topic.startswith("/cam") or stamp_ns < STOPS_NS


def no_camera(topic, _stamp_ns):
    return not topic.startswith("/cam")


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A recording whose camera stops after 1.15 of 4 s, and one that is whole."""
    folder = tmp_path_factory.mktemp("complete")
    write_drive(folder / "bags" / "stops.bag", "ros1", duration_s=4.0, keep=camera_stops)
    write_drive(folder / "bags" / "whole.mcap", "mcap", duration_s=2.0)
    (folder / "recipe.yaml").write_text(QUICK.format(name="complete", root="bags"))
    return folder


def table(folder, name):
    return json.loads((folder / "dataset" / "nuscenes" / "v1.0-test" / f"{name}.json").read_bytes())


def keyframes_of(folder):
    """sample token -> number of its keyframe readings."""
    return Counter(row["sample_token"] for row in table(folder, "sample_data") if row["is_key_frame"])


def test_by_default_no_sample_lacks_a_channel_and_the_cost_is_named(project):
    done = run(project, "build")
    assert done.returncode == 0, done.stderr
    assert set(keyframes_of(project).values()) == {2}
    assert len(keyframes_of(project)) == len(table(project, "sample")) == 3 + 4
    (output,) = [line for line in done.stdout.splitlines() if "keyframes_complete" in line]
    assert output.startswith("warn stops.bag: 5 of 8 keyframes were dropped, where a channel has no reading")
    assert "CAM_FRONT at 5 keyframes (5 after it stops at 1.1 s, 2023-11-14T22:13:21.110Z)" in output
    assert "whole.mcap:" not in done.stdout


def test_it_can_be_found_after_a_build_that_did_nothing(project):
    checked = run(project, "build", "--check")
    assert checked.returncode == 0
    assert "warn stops.bag: 5 of 8 keyframes were dropped" in checked.stdout
    assert checked.stdout.endswith("nothing to do: 2 recordings up to date.\n")
    remarks = json.loads(run(project, "build", "--check", "--json").stdout)["remarks"]
    assert [(one["key"], one["check"]) for one in remarks] == [("stops.bag", "keyframes_complete")]
    output = run(project, "check").stdout
    assert "warn  stops.bag: keyframes_complete\n      5 of 8 keyframes were dropped" in output


def test_samples_may_lack_a_channel_if_the_recipe_allows_it_and_are_counted(project):
    text = (project / "recipe.yaml").read_text()
    (project / "recipe.yaml").write_text(text.replace("min_length_s: 0.5", "missing: allow"))
    try:
        output = json.loads(run(project, "build", "--json").stdout)
        assert len(table(project, "sample")) == 8 + 4
        assert Counter(keyframes_of(project).values()) == {1: 5, 2: 7}
        found = {(one["key"], one["check"]): one for one in output["remarks"]}
        lacking = found["stops.bag", "keyframes_complete"]
        assert lacking["severity"] == "warn"
        assert lacking["problem"].startswith(
            "5 of 8 samples lack a channel, as scenes.missing allows: CAM_FRONT at 5 keyframes"
        )
        of_dataset = found["", "devkit_ready"]
        assert of_dataset["severity"] == "warn"
        assert of_dataset["problem"].startswith(
            "5 of 12 samples lack a channel that other samples of the same rig have"
        )
        assert "CAM_FRONT in 5" in of_dataset["problem"]
        checked = run(project, "check")
        assert checked.returncode == 0
        assert "warn  dataset: devkit_ready\n      5 of 12 samples lack a channel" in checked.stdout
    finally:
        (project / "recipe.yaml").write_text(text)


def test_a_camera_at_no_keyframe_is_a_sensor_all_the_same(project):
    """Its images are sweeps, which lead to a row of the table of sensors."""
    text = (project / "recipe.yaml").read_text()
    (project / "recipe.yaml").write_text(
        text.replace("min_length_s: 0.5", "missing: allow, tolerance_s: 0.001")
    )
    try:
        output = json.loads(run(project, "build", "--json").stdout)
        assert not any(
            row["is_key_frame"] for row in table(project, "sample_data") if row["fileformat"] == "jpg"
        )
        sensors = {row["token"]: row["channel"] for row in table(project, "sensor")}
        assert sorted(sensors.values()) == ["CAM_FRONT", "LIDAR_TOP"]
        assert {row["sensor_token"] for row in table(project, "calibrated_sensor")} == sensors.keys()
        assert [one for one in output["remarks"] if one["severity"] == "error"] == []
        seen = run(project, "view", "whole.mcap_000", "--output", project / "seen.mcap")
        assert seen.returncode == 0, seen.stderr
    finally:
        (project / "recipe.yaml").write_text(text)


def test_a_recording_without_a_channel_is_built_without_it_and_named(project):
    write_drive(project / "bags" / "blind.bag", "ros1", duration_s=2.0, keep=no_camera)
    try:
        done = run(project, "build")
        assert done.returncode == 0, done.stderr
        assert (
            "error blind.bag: CAM_FRONT: topic /cam/image_raw is not in the recording, so its samples lack CAM_FRONT "
            "(rigs[].required skips such recordings)"
        ) in done.stdout
        assert (
            "warn dataset: 4 of 11 samples lack a channel that other samples of the same rig have"
            in done.stdout
        )
    finally:
        (project / "bags" / "blind.bag").unlink()
