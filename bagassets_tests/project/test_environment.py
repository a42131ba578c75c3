"""Environments of other people: what the tests see of them, and what a build makes in them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bagassets.forkserver.client import Client
from bagassets.recordings.globs import matches
from bagassets_tests.services import BIN, bare_environment
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

HOSTILE = {
    "LC_ALL": "C",
    "PYTHONUTF8": "0",
    "TZ": "Asia/Kolkata",
    "OPENBLAS_CORETYPE": "Haswell",
    "OMP_NUM_THREADS": "3",
    "OPENCV_LOG_LEVEL": "DEBUG",
    "DAGSTER_HOME": "/nowhere/rubbish",
    "HOME": os.devnull,
    "XDG_RUNTIME_DIR": "",
    "XDG_CONFIG_HOME": "/nowhere",
    "PYTHONHASHSEED": "7",
    "PYTHONSAFEPATH": "1",
    "PYTHONWARNINGS": "default",
    "FORCE_COLOR": "1",
    "COLUMNS": "40",
    "HTTP_PROXY": "http://127.0.0.1:9",
    "http_proxy": "http://127.0.0.1:9",
}
FOLDER, BAG = "東京 ü", "Tür 1.bag"


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return write_drive(tmp_path_factory.mktemp("drive") / BAG, "ros1", duration_s=2.0)


def bagassets(*arguments, cwd, environment):
    return subprocess.run(
        ["sh", "-c", 'umask 077; exec "$@"', "sh", BIN / "bagassets", *arguments],
        cwd=cwd, env=bare_environment() | environment, capture_output=True, check=False, timeout=300,
    )  # fmt: skip


def built(folder, drive, environment):
    """Make a project as a user does, in a folder with a blank; return the files of its dataset."""
    (folder / "bags" / FOLDER).mkdir(parents=True)
    shutil.copy2(drive, folder / "bags" / FOLDER / BAG)
    try:
        for command in (["init", "a project", "--bags", "bags"], ["build"], ["build"], ["status"]):
            cwd = folder if command[0] == "init" else folder / "a project"
            done = bagassets(*command, cwd=cwd, environment=environment)
            assert done.returncode == 0, done.stderr.decode("utf-8", "replace")
            assert b"Traceback" not in done.stdout + done.stderr
    finally:
        for client in Client.all_of(folder / "a project" / ".bagassets"):
            client.shutdown(grace_s=0.0)
    assert b"1 recording: 9 fresh" in done.stdout
    root = folder / "a project" / "dataset" / "nuscenes"
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


@pytest.mark.long
def test_a_dataset_has_the_same_bytes_in_a_hostile_environment(tmp_path, drive):
    ours = built(tmp_path / "ours", drive, {})
    theirs = built(tmp_path / "their drives ü", drive, HOSTILE)
    assert len(ours) > 20
    assert ours == theirs


def test_what_tests_rely_on_is_not_the_environment_they_were_started_in():
    code = (
        "import os, sys, time; sys.path.insert(0, '.'); from bagassets_tests import conftest; "
        "conftest.pytest_configure(); seen = dict(os.environ); mask = os.umask(0); "
        "print([name for name in sys.argv[1:] if name in seen], seen['LC_ALL'], time.strftime('%z'), mask)"
    )
    names = HOSTILE.keys() - {"LC_ALL", "TZ", "HOME"}
    done = subprocess.run(
        ["sh", "-c", 'umask 077; exec "$@"', "sh", sys.executable, "-c", code, *names],
        cwd=Path(__file__).parents[2],
        env=os.environ | HOSTILE, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.split("\n")[0] == "[] C.UTF-8 +0000 18", done.stderr


@pytest.mark.filterwarnings("error")
def test_a_glob_means_what_it_says_and_warns_of_nothing():
    assert matches("[[]a].bag", "[a].bag")
    assert matches("[a&&b]x.bag", "&x.bag")
    assert not matches("[a||b]x.bag", "cx.bag")
