"""`bagassets init` as a new user meets it: what it lists, what it asks, how it ends."""

import errno
import io
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from textwrap import dedent

import numpy as np
import pytest
import yaml
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bagassets.base.errors import RecipeError
from bagassets.cli.main import main
from bagassets.propose import project
from bagassets.propose.project import dagster_home
from bagassets.recipe import load_recipe
from bagassets.recordings.discover import discover
from bagassets_tests.in_process import build, make_project
from bagassets_tests.services import BIN
from bagassets_tests.small_drive import START_NS, STORE1, messages, write_drive

pytestmark = pytest.mark.once


def write_bag(path, entries, store=STORE1):
    """Write (topic, type, stamp, message) as a ROS 1 bag."""
    with Writer(path) as writer:
        connections = {}
        for topic, msgtype, stamp_ns, message in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=store)
            writer.write(connections[topic], stamp_ns, store.serialize_ros1(message, msgtype))


def robot(number):
    """Yield the messages of the small drive with the frames of one of several robots."""
    for topic, msgtype, stamp_ns, message in messages(STORE1, 1.5, ros1=True):
        for one in getattr(message, "transforms", [message]):
            one.header.frame_id = f"r{number}/{one.header.frame_id}"
            if hasattr(one, "child_frame_id"):
                one.child_frame_id = f"r{number}/{one.child_frame_id}"
        yield topic, msgtype, stamp_ns, message


@pytest.fixture
def init(tmp_path, capsys, monkeypatch):
    """Run `bagassets init project --bags bags`; return its exit status and what it printed."""
    monkeypatch.setenv("COLUMNS", "120")
    (tmp_path / "bags").mkdir()

    def run(*options, bags="bags"):
        status = main(["init", str(tmp_path / "project"), "--bags", str(tmp_path / bags), *options])
        printed = capsys.readouterr()
        return status, printed.out.replace(str(tmp_path), "/home/me"), printed.err

    return run


def test_everything_guessed(init, tmp_path):
    write_drive(tmp_path / "bags" / "drive.bag", "ros1")
    status, out, _ = init()
    assert status == 0
    assert out == dedent("""\
        One rig (1 recording; poses from odometry)
          topic             type                     messages  becomes
          /cam/image_raw    sensor_msgs/Image              29  CAM_FRONT
          /cam/camera_info  sensor_msgs/CameraInfo         29  calibration of CAM_FRONT
          /points           sensor_msgs/PointCloud2        29  LIDAR_TOP
          /odom             nav_msgs/Odometry             151  poses
          /tf_static        tf2_msgs/TFMessage              1  transforms

        Project /home/me/project: recipe.yaml, dagster.yaml, workspace.yaml, .env, definitions.py, pyproject.toml
        5 guesses are marked in recipe.yaml; look at them first.
        Then:
          cd /home/me/project
          bagassets build
        """)
    assert load_recipe(tmp_path / "project" / "recipe.yaml").rigs[0].name == "rig"


def test_what_is_to_be_decided_has_its_line_and_ends_with_2(init, tmp_path):
    write_drive(
        tmp_path / "bags" / "drive.bag", "ros1", keep=lambda topic, _: topic not in {"/odom", "/tf_static"}
    )
    status, out, _ = init()
    assert status == 2
    asked = out.split("To be decided in recipe.yaml before the first build:\n")[1]
    subjects = re.findall(r"^  (\S.*?) \(lines? ([\d, ]+)\): ", asked, re.MULTILINE)
    assert [subject for subject, _ in subjects] == ["ego_pose", "CAM_FRONT", "LIDAR_TOP"]
    text = (tmp_path / "project" / "recipe.yaml").read_text().splitlines()
    assert [text[int(line) - 1].strip() for _, line in subjects] == [
        "ego_pose:",
        "extrinsics:",
        "extrinsics:",
    ]
    assert all(text[int(line)].lstrip().startswith("# to be decided: ") for _, line in subjects)
    # A build refuses the recipe at the same lines, all at once.
    with pytest.raises(RecipeError) as caught:
        load_recipe(tmp_path / "project" / "recipe.yaml")
    assert re.findall(r"recipe\.yaml:(\d+): rigs\[rig\]", str(caught.value)) == [line for _, line in subjects]
    assert asked.endswith("When that is done:\n  cd /home/me/project\n  bagassets build\n")
    # Deciding is uncommenting.
    decided = "\n".join(text).replace("# source:", "source:")
    decided = decided.replace("# translation:", "translation:").replace("# rotation:", "rotation:")
    (tmp_path / "project" / "recipe.yaml").write_text(decided)
    (rig,) = load_recipe(tmp_path / "project" / "recipe.yaml").rigs
    assert rig.channels["CAM_FRONT"].extrinsics.rotation == (0.5, -0.5, 0.5, -0.5)
    assert rig.channels["LIDAR_TOP"].extrinsics.rotation == (1, 0, 0, 0)


def test_recordings_without_sensors_are_reported_to_have_nothing_to_convert(init, tmp_path):
    write_drive(tmp_path / "bags" / "poses.bag", "ros1", keep=lambda topic, _: topic == "/odom")
    status, out, _ = init()
    assert status == 2
    assert out.startswith(
        "Left out: poses.bag: nothing to convert: it has poses or transforms, but no camera, lidar or radar\n"
    )
    assert "so there is nothing to convert; name another" in " ".join(out.split())
    assert "bagassets build" not in out
    assert "guesses" not in out


@pytest.mark.parametrize(("answer", "wanted"), [("y\n", True), ("n\n", False), ("\n", False), (None, False)])
def test_whether_digests_go_beside_the_recordings_is_asked_on_a_terminal(
    init, tmp_path, monkeypatch, answer, wanted
):
    write_drive(tmp_path / "bags" / "drive.bag", "ros1")
    if answer is not None:
        terminal = io.StringIO(answer)
        terminal.isatty = lambda: True
        monkeypatch.setattr(sys, "stdin", terminal)
        monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    status, out, _ = init()
    assert status == 0
    assert ("Should they store digests beside them" in out) == (answer is not None)
    recipe_file = tmp_path / "project" / "recipe.yaml"
    assert load_recipe(recipe_file).bags.digest_attributes is wanted
    if not wanted:
        recipe_file.write_text(recipe_file.read_text().replace("# digest_attributes", "digest_attributes"))
        assert load_recipe(recipe_file).bags.digest_attributes


def test_what_cannot_be_read_is_named_with_its_reason_beside_what_can(init, tmp_path):
    write_drive(tmp_path / "bags" / "drive.bag", "ros1")
    (tmp_path / "bags" / "torn.bag").write_bytes(b"#ROSBAG V2.0\nnothing")
    (tmp_path / "bags" / "lost").mkdir()
    (tmp_path / "bags" / "lost" / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    status, out, _ = init()
    assert status == 0
    unreadable = [line for line in out.splitlines() if line.startswith("Left out: ")]
    assert [line.split(": ")[1] for line in unreadable] == ["lost", "torn.bag"]
    assert "there is no .db3 or .mcap file beside its metadata.yaml" in unreadable[0]
    assert "left out: torn.bag: " in (tmp_path / "project" / "recipe.yaml").read_text()


def test_damaged_recordings_are_named_with_what_builds_make_of_them(init, tmp_path):
    for name in ("a.bag", "b.bag"):
        write_drive(tmp_path / "bags" / name, "ros1")
    assert "Damaged" not in init()[1]
    torn = tmp_path / "bags" / "b.bag"
    torn.write_bytes(torn.read_bytes()[: torn.stat().st_size * 3 // 4])
    status, out, _ = init("--force")
    assert status == 0
    assert "One rig (2 recordings; " in out
    assert "Damaged: b.bag. Builds use those of which nothing is missing; " in out


def test_nothing_but_unreadable_recordings(init, tmp_path):
    (tmp_path / "bags" / "torn.bag").write_bytes(b"#ROSBAG V2.0\nnothing")
    status, out, _ = init()
    assert status == 2
    assert "Left out: torn.bag: " in out
    assert "rigs (line " in out
    assert "no recording could be read" in out


def test_its_help_says_how_it_ends_without_a_recording_that_can_be_read(init, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "bags" / "torn.bag").write_bytes(b"#ROSBAG V2.0\nnothing")
    assert init(bags="empty")[0] == 1
    assert init()[0] == 2
    assert main(["init", "--help"]) == 0
    output = " ".join(capsys.readouterr().out.split())
    statuses = dict(re.findall(r"(\d) ([^;]*)", output.partition("Exit status: ")[2]))
    assert "no recording is found" in statuses["1"]
    assert "no recording can be read" in statuses["2"]


@pytest.mark.parametrize(
    ("definition", "value", "what"),
    [
        (
            "uint8[] data\n",
            np.zeros(9, np.uint8),
            "its packets, which are of no Velodyne, nor of a Hesai of a known model",
        ),
        ("float64 range\n", 1.5, "rslidar_msgs/rslidarScan"),
    ],
)
def test_a_sensor_without_decoder_is_named_with_its_type(init, tmp_path, definition, value, what):
    msgtype = "rslidar_msgs/msg/rslidarScan"
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(definition, msgtype))
    message = store.types[msgtype](value)
    write_bag(tmp_path / "bags" / "packets.bag", [("/rslidar_packets", msgtype, START_NS, message)], store)
    status, out, _ = init()
    assert status == 2
    assert re.search(r"^  /rslidar_packets  rslidar_msgs/rslidarScan +1$", out, re.MULTILINE)
    assert f"      not decodable: no decoder for {what}; " in out


def test_of_topics_that_nothing_needs_a_few_are_shown(init, tmp_path):
    text = STORE1.types["std_msgs/msg/String"]("word")
    write_bag(
        tmp_path / "bags" / "many.bag",
        [(f"/text_{number:02d}", "std_msgs/msg/String", START_NS + number, text) for number in range(12)],
    )
    _, out, _ = init()
    assert len(re.findall(r"^  /text_\d+ .* not needed$", out, re.MULTILINE)) == 8
    assert "\n  and 4 more that are not needed\n" in out


def test_three_robots_in_one_folder(init, tmp_path):
    for number in range(3):
        write_bag(tmp_path / "bags" / f"robot{number}.bag", robot(number))
    status, out, _ = init()
    assert status == 0
    assert [line for line in out.splitlines() if line.startswith("Rig ")] == [
        f"Rig robot{number} (1 recording; poses from odometry)" for number in range(3)
    ]
    assert out.count("  the topics of rig robot0, with other frames or poses\n") == 2
    assert out.count("LIDAR_TOP") == 1
    recipe = load_recipe(tmp_path / "project" / "recipe.yaml")
    assert [(rig.match, rig.ego_frame) for rig in recipe.rigs] == [
        ((f"robot{number}.bag",), f"r{number}/base_link") for number in range(3)
    ]


def test_one_recording_instead_of_a_folder(init, tmp_path):
    write_drive(tmp_path / "bags" / "drive [1].bag", "ros1")
    (tmp_path / "bags" / "other.bag").write_bytes(b"no recording")
    status, out, _ = init(bags="bags/drive [1].bag")
    assert status == 0
    assert "other.bag" not in out
    recipe = load_recipe(tmp_path / "project" / "recipe.yaml")
    assert recipe.bags.root == tmp_path / "bags"
    assert [one.relative for one in discover(recipe.bags).recordings.values()] == ["drive [1].bag"]


def test_a_file_in_a_ros2_folder_stands_for_the_folder(init, tmp_path):
    folder = write_drive(tmp_path / "bags" / "drive", "ros2")
    status, _, _ = init(bags=next(folder.glob("*.db3")).relative_to(tmp_path))
    assert status == 0
    recipe = load_recipe(tmp_path / "project" / "recipe.yaml")
    assert (recipe.bags.root, recipe.bags.include) == (folder, ("**",))


def test_what_is_no_recording_is_refused(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("hello")
    assert main(["init", str(tmp_path / "project"), "--bags", str(tmp_path / "notes.txt")]) == 1
    assert "notes.txt: expected a recording" in capsys.readouterr().err
    assert not (tmp_path / "project").exists()


def test_what_dg_loads_is_the_recipe_of_the_project(init, tmp_path):
    write_drive(tmp_path / "bags" / "drive.bag", "ros1")
    assert init()[0] == 0
    project = tmp_path / "project"
    settings = tomllib.loads((project / "pyproject.toml").read_text())["tool"]["dg"]
    assert settings["directory_type"] == "project"
    (named,) = {
        settings["project"][key] for key in ("root_module", "defs_module", "code_location_target_module")
    }
    ruff = [
        BIN / "ruff",
        "check",
        "--isolated",
        "--select",
        "ALL",
        "--ignore",
        "D203,D213,CPY001,INP001,COM812",
    ]
    for command in (ruff, [BIN / "ruff", "format", "--check", "--isolated"]):
        checked = subprocess.run(
            [*command, project / f"{named}.py"], capture_output=True, text=True, check=False
        )
        assert checked.returncode == 0, checked.stdout
    # The name by which `.env` is found; without it the web UI and the launcher would know no recipe.
    paths = yaml.safe_load((project / "dagster.yaml").read_text())["secrets"]["custom"]["config"][
        "location_paths"
    ]
    assert list(paths) == [settings["project"]["code_location_name"]]
    definitions = runpy.run_path(str(project / f"{named}.py"))["defs"]
    assert definitions.resources["workspace"].recipe_file == str(project / "recipe.yaml")


@pytest.mark.parametrize("own", ["definitions.py", "pyproject.toml"])
def test_files_for_dg_are_not_written_beside_one_of_the_users(init, tmp_path, capsys, own):
    write_drive(tmp_path / "bags" / "drive.bag", "ros1")
    project = tmp_path / "project"
    project.mkdir()
    (project / own).write_text("# mine\n")
    _, out, _ = init()
    assert "recipe.yaml, dagster.yaml, workspace.yaml, .env\n" in out
    assert main(["init", str(project)]) == 0
    wrote = f"Wrote dagster.yaml, .env in {project}; kept recipe.yaml, workspace.yaml.\n"
    assert capsys.readouterr().out == wrote
    assert (project / own).read_text() == "# mine\n"
    assert len([*project.glob("definitions.py"), *project.glob("pyproject.toml")]) == 1


def test_a_project_of_an_older_version_gets_the_files_for_dg(init, tmp_path, capsys):
    write_drive(tmp_path / "bags" / "drive.bag", "ros1")
    init()
    project = tmp_path / "project"
    for name in ("definitions.py", "pyproject.toml"):
        (project / name).unlink()
    assert main(["init", str(project)]) == 0
    assert capsys.readouterr().out.startswith("Wrote dagster.yaml, .env, definitions.py, pyproject.toml in ")


@pytest.mark.parametrize("how", ["moved", "copied", "copied without its .env"])
def test_a_project_that_was_moved_or_copied_does_not_write_to_where_it_was(tmp_path, monkeypatch, capfd, how):
    before, after = tmp_path / "before", tmp_path / "it is here"
    make_project(before)
    (shutil.move if how == "moved" else shutil.copytree)(before, after)
    if how == "copied without its .env":
        (after / ".env").unlink()
    with pytest.raises(RecipeError, match="this project was moved or copied from there") as refused:
        build(after / "recipe.yaml", monkeypatch)
    assert f"`bagassets init {shlex.quote(str(after))}`" in str(refused.value)
    if how == "moved":  # the server of a build meets it first
        capfd.readouterr()
        assert main(["build", "--recipe", str(after / "recipe.yaml")]) == 1
        assert capfd.readouterr().err.splitlines()[-1] == f"error: {refused.value}"
    assert main(["init", str(after)]) == 0
    report, _ = build(after / "recipe.yaml", monkeypatch)
    assert report.succeeded
    assert (after / "dataset" / "nuscenes").is_dir()
    assert not (before / "dataset").exists()


@pytest.mark.parametrize(
    "line",
    [
        "BAGASSETS_RECIPE='{recipe}'",
        "BAGASSETS_RECIPE={recipe}",
        'BAGASSETS_RECIPE="{recipe}"',
        "BAGASSETS_RECIPE='{recipe}'  # ours",
        "BAGASSETS_RECIPE=recipe.yaml",
    ],
)
def test_an_env_that_somebody_wrote_is_no_sign_of_a_move(tmp_path, line):
    recipe_file = make_project(tmp_path, ())
    (tmp_path / ".env").write_text(line.format(recipe=recipe_file))
    config = tmp_path / "dagster.yaml"
    config.write_text(config.read_text().replace(str(recipe_file), "recipe.yaml"))
    assert dagster_home(recipe_file, load_recipe(recipe_file)) == tmp_path


def test_a_folder_that_cannot_be_written_is_named_with_what_to_do(init, tmp_path, monkeypatch):
    """Images of containers are often mounted read-only; the first command may be a build or `init`."""
    write_drive(tmp_path / "bags" / "a.bag", "ros1", duration_s=0.5)
    recipe_file = make_project(tmp_path / "other", ())
    (tmp_path / "other" / "dagster.yaml").unlink()

    def refuse(*_arguments, **_options):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(project, "write_atomically", refuse)
    advice = r"\(Read-only file system\); mount its disk for writing, or use another folder"
    status, _, said = init()
    assert status == 1
    assert re.search(f"/project: the project cannot be written {advice}", said)
    with pytest.raises(
        RecipeError, match=f"the Dagster home cannot be made {advice}: `state` in the recipe names it"
    ):
        dagster_home(recipe_file, load_recipe(recipe_file))
