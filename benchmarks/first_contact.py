"""Recordings that strangers made and published: what `bagassets init` proposes for each, and how many edits a build takes.

Each is fetched from its repository with git, or taken from FOLDER, which has repositories as OWNER/NAME.git::

    python -m benchmarks.first_contact [--repositories FOLDER] [--json FILE]

What `init` asks is answered as somebody would who knows no more than the recordings tell: the rig stands still, and sensors
are where the recipe's example has them. Each answer is one edit.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from bagassets.base.quantities import count_text
from benchmarks.common import ROOT, machine, markdown

__all__ = ["first_contact_table"]

_QUESTION = "# to be decided: "
_NEBULA = "tier4/nebula", "606ac41f1f136333915f0114736f2f828e9d2789"
_TRUTH = "test_resources/decoder_ground_truth"


@dataclass(frozen=True)
class Published:
    """A recording in a public repository.

    Attributes:
        repository: owner and name at GitHub.
        commit: a version of it.
        path: the file there, or the folder.
        about: what it is.
    """

    repository: str
    commit: str
    path: str
    about: str


_EVO = "MichaelGrupp/evo", "26d0953d4da0f0cb56f90ba6269a15e72f69d3ad"
_ROBOCODEC = "archebase/robocodec", "cf8a37f3eb390c52e9d15d3e9eb64c6f245e3bc4"
_PLOTJUGGLER = "facontidavide/PlotJuggler", "ddcbd05be05f9a8e90da624828b36ec795383fb4"
_LOCALIZATION = "cra-ros-pkg/robot_localization", "1cb953379378d13b3e0935ed73d0c7407bd80543"
_RECOGNITION = "jsk-ros-pkg/jsk_recognition", "300149fc7d63d95df90d9bede3b24ccfc6862c2a"
RECORDINGS = (
    Published(
        "naver/kapture",
        "5abafb9d56f91d8ab33917e1c8b646da2731b30f",
        "samples/t265/trimmed_locoffice.bag",
        "two fisheye cameras and the odometry of a RealSense T265",
    ),
    Published(
        "SICKAG/sick_scan_xd",
        "2d4796699158762cfee78ece05bf8d7c2ceb68d0",
        "doc/combination_rms_1xxx_lms_1xx/rms_1xxx_lms_1xx_movement_off.bag",
        "lidar and radar of SICK that stand still",
    ),
    Published(
        "jsk-ros-pkg/jsk_demos",
        "6a285281a190e1cd429402e458e13447219da9ef",
        "elevator_move_base_pr2/test/test-button-light.bag",
        "a Bayer camera of a PR2",
    ),
    Published(
        "swri-robotics/bag-reader-java",
        "a872d3902b89792b4dbd1e58d88afbcd20056aad",
        "src/test/resources/PointCloud2.bag",
        "a single cloud",
    ),
    Published(
        *_ROBOCODEC,
        "tests/fixtures/robocodec_test_11.mcap",
        "four JPEG cameras around two arms",
    ),
    Published(
        *_NEBULA,
        f"src/nebula_velodyne/nebula_velodyne/{_TRUTH}/vlp16/1673400471837873222",
        "packets of a VLP-16",
    ),
    Published(
        *_NEBULA,
        f"src/nebula_velodyne/nebula_velodyne/{_TRUTH}/vlp32/1713492677464078412",
        "packets of a VLP-32, 270°",
    ),
    Published(
        *_NEBULA,
        f"src/nebula_velodyne/nebula_velodyne/{_TRUTH}/vls128/1614315746471294674",
        "packets of a VLS-128",
    ),
    Published(
        *_NEBULA,
        f"src/nebula_hesai/nebula_hesai/{_TRUTH}/qt128/1730273789074637152",
        "packets of a Hesai QT128",
    ),
    Published(
        *_NEBULA,
        f"src/nebula_hesai/nebula_hesai/{_TRUTH}/xt32/1673400677802009732",
        "packets of a Hesai XT32",
    ),
    Published(
        *_NEBULA,
        f"src/nebula_continental/nebula_continental/{_TRUTH}/ars548/1708578204",
        "packets of an ARS548 radar",
    ),
    Published(
        "ouster-lidar/ouster-sdk",
        "46b7bceee7995914e2f3f3facf4d78418335b2d7",
        "tests/bags/512x10_raw.bag",
        "packets of an Ouster",
    ),
    Published(
        "klintan/rosbag2.js",
        "65ebe15d242c06efb026c11f3ced35065f80e7d6",
        "examples/sample.db3",
        "one message each of a camera, a fix, an Imu",
    ),
    Published(
        "rosbag-sharing-community/amber",
        "ee69a9edf3892ad8e783e6996286f2e135988c88",
        "tests/rosbag/soccer_goal/soccer_goal_12.mcap",
        "one part of a bag with compressed messages",
    ),
    Published(
        "cruise-automation/rosbag.js",
        "cdbeaf846da2bcd3660e7844203fc6eb68ae47b4",
        "fixtures/example-bz2.bag",
        "turtlesim",
    ),
    Published(*_EVO, "test/data/ROS_example.bag", "trajectories of two SLAMs and their truth"),
    Published(*_EVO, "test/data/nav2_turtlebot.mcap", "odometry and TF of a TurtleBot"),
    Published(*_EVO, "test/data/tf_example", "TF"),
    Published(*_LOCALIZATION, "test/test1.bag", "odometry, Imu and fixes of a Husky"),
    Published(*_LOCALIZATION, "test/test2.bag", "odometry and Imu of a Jackal"),
    Published(
        "jsk-ros-pkg/jsk_pr2eus",
        "61a57863ab63b3bb1faf0c0922c8a9d35c5015df",
        "pr2eus/test/pr1012_camera_info.bag",
        "CameraInfo of 14 cameras of a PR2",
    ),
    Published(*_RECOGNITION, "jsk_pcl_ros/sample/data/watercan.bag", "a segmented cloud and TF of a PR2"),
    Published(*_RECOGNITION, "jsk_pcl_ros/scripts/check_depth_error/test.bag", "results of a calibration"),
    Published(
        "jinbeizame007/rosbag2parquet",
        "93947fad11f61dae5ec275b138a6943f80985d23",
        "testdata/array_msgs/array_msgs_0.mcap",
        "an Imu and joint states",
    ),
    Published(
        *_ROBOCODEC,
        "tests/fixtures/robocodec_test_18.bag",
        "cameras and commands of a humanoid; its index is damaged",
    ),
    Published(*_PLOTJUGGLER, "datasamples/tilt_laser.bag", "a laser on a mount that nods, an Imu, fixes"),
    Published(*_PLOTJUGGLER, "datasamples/fake_joint_state.bag", "joint states"),
)
_WHY = {
    "nothing to convert": "nothing to convert",
    "no topic is proposed": "nothing to convert: what there is looks computed",
    "compressed": "needs the `metadata.yaml` of its bag",
    "no decoder": "needs a decoder",
    "and must have": "too short for an episode",
    "is left out: action": "no episode: actions begin too late for it",
}


def main() -> None:
    """Try each recording and write what came."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repositories", type=Path, help="folder of git repositories, OWNER/NAME.git")
    parser.add_argument("--json", type=Path, default=ROOT / "benchmarks" / "results" / "first_contact.json")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name)
        tried = [
            _tried(one, options.repositories or folder, folder / str(n)) for n, one in enumerate(RECORDINGS)
        ]
    found = {"machine": machine(), "recordings": tried}
    options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(first_contact_table(found))


def first_contact_table(found: dict[str, Any]) -> str:
    """Return a table of all recordings."""
    rows = []
    for one in found["recordings"]:
        made = one["made"]
        result = one["why"]
        if made:
            result = ", ".join(count_text(number, what.removesuffix("s")) for what, number in made.items())
        recording = f"[{one['repository']}](https://github.com/{one['repository']}): {one['about']}"
        rows.append((recording, ", ".join(one["channels"]) or "none", one["guesses"], one["edits"], result))
    return markdown(("recording", "channels or signals proposed", "guesses", "edits", "dataset"), rows)


def _tried(recording: Published, repositories: Path, folder: Path) -> dict[str, Any]:
    bags, project = folder / "bags", folder / "project"
    bags.mkdir(parents=True)
    _fetch(recording, repositories, bags)
    _bagassets("init", project, "--bags", bags)
    recipe = project / "recipe.yaml"
    text = recipe.read_text("utf-8")
    rigs = yaml.safe_load(text)["rigs"] or []
    facts: dict[str, Any] = {
        "repository": recording.repository,
        "path": recording.path,
        "about": recording.about,
        "channels": [name for rig in rigs for kind in ("channels", "signals") for name in rig.get(kind, ())],
        "guesses": len(re.findall(r"# guess: ", text)),
        "edits": 0,
        "made": None,
        "why": "",
    }
    if not rigs:
        (asked,) = re.findall(rf"{_QUESTION}(.*(?:\n +#  .*)*)", text)
        words = " ".join(asked.replace("#", " ").split())
        return facts | {"why": _short(words)}
    answered, facts["edits"] = _answered(text)
    recipe.write_text(answered, "utf-8")
    done = _bagassets("build", "--recipe", recipe)
    if done.returncode:
        (why, *_) = re.findall(r"^error:? (.*)", done.stderr + done.stdout, re.MULTILINE)
        return facts | {"why": _short(why)}
    return facts | {"made": _counts(project / "dataset")}


def _short(why: str) -> str:
    return next((said for part, said in _WHY.items() if part in why), why)


def _counts(datasets: Path) -> dict[str, int]:
    """Return how much of what a dataset has: of nuScenes, or of LeRobot."""
    for info in datasets.glob("*/*/meta/info.json"):
        totals = json.loads(info.read_text("utf-8"))
        return {"episodes": totals["total_episodes"], "frames": totals["total_frames"]}
    (samples,) = datasets.glob("*/*/sample.json")
    tables = {"samples": samples, "readings": samples.with_name("sample_data.json")}
    return {what: len(json.loads(table.read_text("utf-8"))) for what, table in tables.items()}


def _answered(text: str) -> tuple[str, int]:
    """Return a recipe whose questions are answered, and their number: what is commented out below each counts."""
    lines, edits, is_asked = text.splitlines(), 0, False
    for number, line in enumerate(lines):
        words = line.strip()
        if words.startswith(_QUESTION):
            edits, is_asked = edits + 1, True
        elif not words.startswith("#"):
            is_asked = False
        if re.match(r"# (source: fixed|translation: |rotation: )", words) and is_asked:
            lines[number] = line.replace("# ", "", 1)
        if re.match(r"# frame: ", words) and _QUESTION in "".join(lines[number : number + 4]):
            lines[number] = line.replace("# ", "", 1)
    return "\n".join(lines) + "\n", edits


def _fetch(recording: Published, repositories: Path, bags: Path) -> None:
    """Write the files of a recording into a folder."""
    repository = repositories / f"{recording.repository}.git"
    if not repository.exists():
        url = f"https://github.com/{recording.repository}"
        subprocess.run(
            ["git", "clone", "--quiet", "--bare", "--filter=blob:none", url, repository], check=True
        )
    git = ["git", "--git-dir", str(repository)]
    listed = subprocess.run(
        [*git, "ls-tree", "-r", "--name-only", recording.commit, recording.path],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    for path in listed.stdout.splitlines():
        file = bags / Path(path).relative_to(Path(recording.path).parent)
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("wb") as out:
            subprocess.run([*git, "show", f"{recording.commit}:{path}"], check=True, stdout=out)


def _bagassets(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bagassets", *map(str, arguments)],
        check=False, capture_output=True, text=True, env={**os.environ, "COLUMNS": "1000"},
    )  # fmt: skip


if __name__ == "__main__":
    main()
