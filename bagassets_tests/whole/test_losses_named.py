"""By the command: what a channel lost is named with the way out, at the end of the build and whenever one asks."""

import json

import pytest
from rosbags.rosbag2 import Writer

from bagassets_tests.in_process import QUICK, run_command
from bagassets_tests.small_drive import LATENCY_NS, START_NS, STORE2, messages, write_drive

pytestmark = [pytest.mark.xdist_group("losses_named"), pytest.mark.once]

FOUND = 3


def run(folder, command, *args):
    return run_command(command, "--recipe", folder / "recipe.yaml", *args)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A recording whose camera stamps seven images of eight like the one before."""
    folder = tmp_path_factory.mktemp("losses")
    (folder / "bags").mkdir()
    last, number = None, 0
    with Writer(folder / "bags" / "drive", version=9) as writer:
        connections = {}
        for topic, msgtype, stamp_ns, message in messages(STORE2, 4.0):
            if topic == "/cam/image_raw":
                if number % 8:
                    message.header.stamp = last
                last, number = message.header.stamp, number + 1
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=STORE2)
            writer.write(connections[topic], stamp_ns + LATENCY_NS, STORE2.serialize_cdr(message, msgtype))
    (folder / "recipe.yaml").write_text(
        QUICK.format(name="losses", root="bags").replace("min_length_s: 0.5", "tolerance_s: 0.2")
    )
    return folder


TOLD = (
    "error drive: CAM_FRONT: 34 of 39 messages (87%) were lost because of duplicate stamps. If these are separate "
    "readings, `clock: log` tells them apart by their log times: for this channel (rigs[].channels.CAM_FRONT.clock), while "
    "others keep their stamps, or for all (clock), as where a simulation was restarted (frames_complete)"
)


def test_a_build_ends_with_what_was_lost_and_the_way_out(project):
    done = run(project, "build")
    assert done.returncode == 0, done.stderr
    assert TOLD in done.stdout
    (project / "bags" / "drive" / "metadata.yaml").touch()
    examined, noted = run(project, "build").stdout, run(project, "build").stdout
    assert "1 hit in" in examined
    assert "nothing to do" in noted
    for told in (examined, noted):
        assert TOLD in told.splitlines(), "what was lost is not forgotten when there is nothing to do"


def test_it_is_known_whenever_one_asks(project):
    checked = run(project, "build", "--check")
    assert checked.returncode == 0
    assert TOLD in checked.stdout
    (remark,) = [
        one
        for one in json.loads(run(project, "build", "--check", "--json").stdout)["remarks"]
        if one["check"] == "frames_complete"
    ]
    assert (remark["key"], remark["severity"]) == ("drive", "error")
    done = run(project, "check")
    assert done.returncode == FOUND
    assert "CAM_FRONT: 34 of 39 messages (87%) were lost" in done.stdout


def test_the_recipe_says_which_share_is_named_and_changing_it_makes_nothing_stale(project):
    text = (project / "recipe.yaml").read_text()
    (project / "recipe.yaml").write_text(text + "limits: {reported_losses: 0.9}\n")
    try:
        checked = run(project, "build", "--check")
        assert "were lost" not in checked.stdout
        assert checked.stdout.endswith("nothing to do: 1 recording up to date.\n")
    finally:
        (project / "recipe.yaml").write_text(text)


def test_the_way_out_leads_out(project):
    text = (project / "recipe.yaml").read_text()
    (project / "recipe.yaml").write_text(text.replace("modality: camera,", "modality: camera, clock: log,"))
    try:
        output = json.loads(run(project, "build", "--json").stdout)
        assert [one for one in output["remarks"] if one["check"] == "frames_complete"] == []
        assert output["summary"][0]["images"] == 39
    finally:
        (project / "recipe.yaml").write_text(text)


def test_the_way_out_of_a_restarted_simulation_is_for_all(tmp_path):
    """A camera on another clock than the poses has none."""

    def restart(_topic, _number, message, log_ns):
        simulated_ns = 10**6 + (log_ns - LATENCY_NS - START_NS) % (2 * 10**9)
        for part in getattr(message, "transforms", [message]):
            part.header.stamp.sec, part.header.stamp.nanosec = divmod(simulated_ns, 10**9)
        return [(log_ns, message)]

    (tmp_path / "bags").mkdir()
    write_drive(tmp_path / "bags" / "drive", "ros2", 4.0, change=restart)
    text = QUICK.format(name="restarted", root="bags")
    (tmp_path / "recipe.yaml").write_text(text)
    assert "or for all (clock), as where a simulation was restarted" in run(tmp_path, "build").stdout
    (tmp_path / "recipe.yaml").write_text(text.replace("modality: camera,", "modality: camera, clock: log,"))
    assert "CAM_FRONT: 39 of 39 readings have no ego pose" in run(tmp_path, "build").stdout
    (tmp_path / "recipe.yaml").write_text(f"clock: log\n{text}")
    output = json.loads(run(tmp_path, "build", "--json").stdout)
    assert output["remarks"] == []
    assert output["summary"][0]["images"] == 39
