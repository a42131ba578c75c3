"""`make test-all`: which Pythons it finds, what it says of each part, and that the lowest versions are the lowest."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from bagassets_tests.conftest import MARKS, may_be_chosen
from bagassets_tests.services import eventually
from scripts import test_all

pytestmark = pytest.mark.once

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
SHIM = "#!/bin/sh\necho 'pyenv: command not found' >&2\nexit 127\n"


def program(path, version):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\necho {version[0]} {version[1]}\n" if version else SHIM)
    path.chmod(0o755)
    return str(path)


def locked(name):
    lines = (ROOT / name).read_text("utf-8").splitlines()
    pins = (Requirement(line) for line in lines if line and not line.startswith("#"))
    return {canonicalize_name(pin.name): str(pin.specifier).removeprefix("==") for pin in pins}


@pytest.mark.parametrize(
    "text",
    [
        *PROJECT["dependencies"],
        *(one for extra in ("postgres", "video") for one in PROJECT["optional-dependencies"][extra]),
    ],
)
def test_lowest_versions_are_those_that_the_package_allows(text):
    requirement = Requirement(text)
    [lowest] = [one.version for one in requirement.specifier if one.operator == ">="]
    pinned = locked("requirements-lowest.lock")[canonicalize_name(requirement.name)]
    assert pinned in requirement.specifier
    # Of some releases only a later patch has wheels, or was published at all.
    assert pinned.split(".")[: lowest.count(".") + 1] == lowest.split("."), (
        "make requirements-lowest.lock again"
    )


def test_the_lock_holds_versions_that_the_package_allows():
    pins = locked("requirements.lock")
    for text in PROJECT["dependencies"]:
        requirement = Requirement(text)
        assert pins[canonicalize_name(requirement.name)] in requirement.specifier


def test_pythons_are_found_on_the_path_and_among_those_of_pyenv(tmp_path, monkeypatch):
    for name, version in {
        "python3.14": None,
        "python3.13": None,
        "python3.12": (3, 12),
        "python3": (3, 9),
    }.items():
        program(tmp_path / "bin" / name, version)
    own = program(tmp_path / "own", (3, 11))
    pyenv = program(tmp_path / "pyenv" / "versions" / "3.13.0" / "bin" / "python", (3, 13))
    program(tmp_path / "pyenv" / "versions" / "3.12.1" / "bin" / "python", (3, 12))
    program(tmp_path / "pyenv" / "versions" / "3.14.1" / "bin" / "python", None)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
    monkeypatch.setattr(sys, "executable", own)
    assert test_all.find_pythons() == {(3, 11): own, (3, 12): "python3.12", (3, 13): pyenv}


@pytest.fixture
def parts(monkeypatch):
    def fail():
        test_all._run(sys.executable, "-c", "raise SystemExit(3)")

    def pass_():
        test_all._run(sys.executable, "-c", "print('1 passed')")

    def lack():
        raise test_all.LeftOutError("there is no Python 3.99")

    parts = {
        "good": test_all.Part("what works", pass_),
        "bad": test_all.Part("what does not", fail),
        "lacking": test_all.Part("what cannot be tried", lack),
    }
    monkeypatch.setattr(test_all, "PARTS", parts)
    monkeypatch.setattr(test_all, "BY_HAND", ("bad",))


def test_each_part_says_what_it_does_and_how_long_it_took(parts, capfd):
    assert test_all.main(["good", "lacking"]) == 0
    said = capfd.readouterr().out
    assert "== good: what works\n" in said
    assert "\n1 passed\n" in said
    assert "== good: passed (" in said
    lines = [line.split(maxsplit=3) for line in said.rstrip().splitlines()[-3:]]
    assert [(line[0], line[2]) for line in lines] == [("good", "s"), ("lacking", "s"), ("all", "s")]
    assert "left out: there is no Python 3.99" in said


def test_a_part_that_fails_does_not_keep_others_from_running(parts, capfd):
    assert test_all.main(["bad", "good"]) == 1
    said = capfd.readouterr().out
    assert "== bad: FAILED: " in said
    assert "exit status 3" in said
    assert "== good: passed" in said


def test_a_part_that_is_run_by_hand_is_run_if_it_is_named(parts, capfd):
    assert test_all.main([]) == 0
    said = capfd.readouterr().out
    assert "== good: passed" in said
    assert "bad" not in said


def test_what_a_part_leaves_running_ends_with_it(monkeypatch, tmp_path):
    monkeypatch.setattr(test_all, "_AT_MOST_S", 2.0)
    pid, usual = tmp_path / "pid", subprocess.Popen.wait

    def wait(process, timeout=None):
        if timeout is not None:  # which counts from here on, whenever a busy machine lets it begin
            eventually(lambda: pid.exists() and pid.read_text(), "it has begun")
        return usual(process, timeout)

    monkeypatch.setattr(subprocess.Popen, "wait", wait)
    code = "import os, sys, time; open(sys.argv[1], 'w').write(str(os.getpid())); time.sleep(600)"
    with pytest.raises(test_all.FailedError, match="took more than 2 s"):
        test_all._run(sys.executable, "-c", code, str(pid))
    assert not Path("/proc", pid.read_text()).exists()


def test_an_unknown_part_is_refused(capsys):
    with pytest.raises(SystemExit):
        test_all.main(["longest"])
    assert (
        "no part 'longest'; the parts are long, lerobot, fuzz, lowest, newest, benchmarks"
        in capsys.readouterr().err
    )


def test_without_the_python_that_it_needs_a_part_is_left_out(monkeypatch, capfd):
    monkeypatch.setattr(test_all, "find_pythons", dict)
    assert test_all.main(["lowest", "newest"]) == 0
    said = capfd.readouterr().out
    assert "lowest: left out: there is no Python 3.11" in said
    assert "newest: left out: there is no Python" in said
    assert re.search("prepare .* done, but for lowest, newest\n", said)


SOME_LONG = """
import pytest


@pytest.mark.long
def test_one(): ...


def test_two(): ...
"""


@pytest.mark.parametrize(
    ("text", "chosen_by"),
    [
        ("def test_one(): ...\n", {"not long", "not long and not once"}),
        (SOME_LONG, {"not long", "not long and not once", "long and not lerobot and not benchmark"}),
        ("pytestmark = pytest.mark.long\n", {"long and not lerobot and not benchmark"}),
        ("pytestmark = pytest.mark.once\n", {"not long"}),
        (
            f"pytestmark = pytest.mark.once\n{SOME_LONG}",
            {"not long", "long and not lerobot and not benchmark"},
        ),
        ('pytestmark = [pytest.mark.xdist_group("a"), pytest.mark.once]\n', {"not long"}),
        (
            'pytestmark = [\n    pytest.mark.long,\n    pytest.mark.skipif(1, reason="b"),\n]\n',
            {"long and not lerobot and not benchmark"},
        ),
        ("pytestmark = [pytest.mark.lerobot, pytest.mark.long]\n", {"lerobot"}),
        (
            "pytestmark = pytest.mark.long\n\n\n@pytest.mark.benchmark\ndef test_one(): ...\n",
            {"long and not lerobot and not benchmark", "benchmark"},
        ),
        ("@pytest.mark.once\ndef test_one(): ...\n", {"not long", "not long and not once"}),
    ],
)
def test_files_without_a_test_that_is_chosen_are_not_imported(text, chosen_by):
    expressions = (
        "not long",
        "not long and not once",
        "long and not lerobot and not benchmark",
        "lerobot",
        "benchmark",
    )
    assert {one for one in expressions if may_be_chosen(text, one)} == chosen_by
    assert may_be_chosen(text, "of_tomorrow or not long")
    assert may_be_chosen(text, "and")


def test_marks_that_choose_tests_are_named_in_the_files_of_the_tests():
    named = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "bagassets_tests").rglob("*.py")
        if re.search(rf"mark\.({'|'.join(MARKS)})\b", path.read_text("utf-8"))
    }
    assert len(named) > 50
    assert [name for name in named if not name.rpartition("/")[2].startswith("test_")] == []
