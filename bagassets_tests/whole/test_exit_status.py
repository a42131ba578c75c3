"""Every cell of the table of exit statuses in docs/operations.md: a command that ends so, or the test that has one."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.main import COMMANDS, main
from bagassets_tests.in_process import QUICK, build, make_project

pytestmark = [pytest.mark.xdist_group("exit_status"), pytest.mark.once]

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "operations.md").read_text("utf-8")
GOOD, BROKEN = "a.bag", "b.bag"
STATUSES = [0, 1, 2, 3, 70, 130]

# What is run in a project with a recording that is built, and one that failed; or where it is tested already.
CELLS = {
    ("every command", 0): "docs recipe",
    ("every command", 1): "report --recipe nowhere.yaml",
    ("every command", 2): "explain a.bag nothing",
    ("every command", 70): "test_exit_status.py::test_a_defect_has_a_status_of_its_own",
    (
        "every command",
        130,
    ): "test_commands.py::test_an_interrupt_before_the_command_line_is_there_is_no_traceback",
    ("init", 1): "init new --bags empty",
    ("init", 2): "test_init.py::test_what_is_to_be_decided_has_its_line_and_ends_with_2",
    ("doctor", 0): "test_doctor.py::test_a_sound_recording_is_said_to_be_that",
    ("doctor", 1): "test_doctor.py::test_what_is_no_recording_is_lost",
    ("doctor", 3): "test_doctor.py::test_the_page_says_what_where_what_can_be_saved_and_what_to_do",
    ("convert", 0): "test_convert.py::test_a_recording_becomes_a_dataset_of_its_own",
    ("convert", 1): "test_convert.py::test_what_gives_no_scene_gives_no_dataset",
    ("convert", 2): "test_convert.py::test_open_questions_are_listed_and_written_beside",
    ("build", 0): "test_build_server.py::test_the_first_build_starts_a_server_that_the_next_one_uses",
    ("build", 1): "test_build_remarks.py::test_what_is_to_be_decided_for_one_rig_fails_its_recordings_only",
    ("build --dry-run", 0): "build --dry-run",
    ("build --check", 0): "build --check --bag a.bag",
    ("build --check", 1): "build --check",
    ("build --check", 3): "build --check {edited}",
    ("status", 0): "status --bag a.bag",
    ("status", 1): "status",
    ("status", 3): "status {edited}",
    ("explain", 0): "explain b.bag nuscenes_dataset {edited}",
    ("check", 0): "check --bag a.bag",
    ("check", 1): "check",
    ("check", 3): "check {strict}",
    ("digest", 1): "digest nothing.bag",
    ("digest", 3): "test_digest_cmd.py::test_verify_reports_every_disagreement_and_changes_nothing",
    ("watch", 0): "watch --once bags",
    ("watch", 1): "test_exit_status.py::test_a_service_that_nobody_reads_ends",
    ("watch", 3): "test_watch.py::test_once_with_verify_shows_by_its_status",
    ("verify", 0): "verify",
    ("verify", 3): "test_verify.py::test_a_flipped_byte_is_named_with_file_and_topic",
    ("dataset diff", 0): "dataset diff dataset/nuscenes dataset/nuscenes",
    ("dataset diff", 1): "dataset diff dataset/nuscenes bags",
    ("dataset diff", 3): "dataset diff dataset/nuscenes other.lock.json",
    ("dataset restore", 0): "dataset restore dataset/nuscenes --output again",
    ("dataset restore", 1): "dataset restore other.lock.json --output another",
    (
        "decoders",
        1,
    ): "test_plugins_decoders.py::test_the_command_lists_plugins_and_fails_on_those_that_cannot_be_used",
    ("formats", 1): "test_formats_installed.py::test_what_cannot_be_used_is_left_out_and_named",
}


def cells():
    """Yield command and status of each cell of the table that says something."""
    table = PAGE.partition("## Exit status")[2].partition("\n## ")[0]
    rows = [
        [cell.strip() for cell in row.strip("|").split("|")]
        for row in re.findall(r"^\|.*\|$", table, re.MULTILINE)
    ]
    head, _, *body = rows
    assert [int(status) for status in head[1:]] == STATUSES == sorted({0, *ExitStatus})
    for names, *texts in body:
        for name in re.findall(r"`([^`]+)`", names) or [names]:
            yield from ((name, status) for status, text in zip(STATUSES, texts, strict=True) if text)


def test_each_cell_of_the_table_is_tested():
    assert list(cells()) == list(CELLS)
    assert {name.split()[0] for name, _ in CELLS} <= {*COMMANDS, "every"}
    for where in CELLS.values():
        if "::" in where:
            module, _, name = where.partition("::")
            [file] = (ROOT / "bagassets_tests").rglob(module)
            assert f"def {name}(" in file.read_text("utf-8"), where


def test_a_defect_has_a_status_of_its_own(monkeypatch, tmp_path, capsys):
    def broken(*_):
        raise ZeroDivisionError("an odd one")

    monkeypatch.setattr("bagassets.cli.plugins.echo", broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert main(["decoders"]) == ExitStatus.CRASHED
    (log,) = tmp_path.iterdir()
    assert f"(ZeroDivisionError: an odd one); the traceback is in {log}" in capsys.readouterr().err


def test_a_service_that_nobody_reads_ends(tmp_path):
    read, write = os.pipe()
    os.close(read)  # before it says anything; once read, it would go on for ever
    with os.fdopen(write) as output:
        command = [sys.executable, "-m", "bagassets", "watch", str(tmp_path)]
        done = subprocess.run(command, stdout=output, check=False, timeout=60)
    assert done.returncode == ExitStatus.FAILED


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    recipe = make_project(tmp_path_factory.mktemp("statuses"), [GOOD], text=QUICK)
    (recipe.parent / "bags" / BROKEN).write_bytes(b"#ROSBAG V2.0\n" + b"x" * 100)
    (recipe.parent / "empty").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        build(recipe, patch)
    (lock,) = recipe.parent.glob("dataset/nuscenes/*/dataset.lock.json")
    value = json.loads(lock.read_bytes())
    value["files"]["sample.json"] = "0" * 64
    (recipe.parent / "other.lock.json").write_text(json.dumps(value))
    return recipe


@pytest.mark.parametrize(
    ("cell", "command"), [(cell, command) for cell, command in CELLS.items() if "::" not in command]
)
def test_a_command_ends_as_the_table_says(project, cell, command, monkeypatch, capsys):
    text = project.read_text()
    recipes = {
        "edited": text.replace("topic: /cam/image_raw", "topic: /cam/image_raw, quality: 33"),
        "strict": text + "checks: {topic_rates: {severity: error, limits: {/odom: {min_hz: 999}}}}\n",
    }
    monkeypatch.chdir(project.parent)
    which = re.search(r" \{(\w+)\}", command)
    if which is not None:
        command = command.replace(which[0], "")
        project.write_text(recipes[which[1]])
    try:
        try:
            status = main(command.split())
        except SystemExit as end:
            status = end.code
    finally:
        project.write_text(text)
    assert status == cell[1], capsys.readouterr()
