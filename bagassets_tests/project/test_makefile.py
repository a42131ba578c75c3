"""Which Python `make` takes for the environments, and what CI makes of tests that are skipped."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.once

ROOT = Path(__file__).parents[2]
CI = ROOT / ".ci" / "run"
# A Python of another version, as far as somebody sees who asks it for that; and a shim of pyenv.
PYTHON = (
    '#!/bin/sh\ntest "$1" = -c && exec {real} -c "import sys; sys.version_info = {version}; $2"\nexit 1\n'
)
SHIM = "#!/bin/sh\necho 'pyenv: command not found' >&2\nexit 127\n"
# With --basetemp they do not remove what other runs of tests have left.
PYTEST = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]


@pytest.fixture
def checkout(tmp_path):
    """A folder with the Makefile and what it reads, and an empty folder of programs."""
    for name in ("Makefile", "pyproject.toml", "requirements.lock", "requirements-devkit.lock"):
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "bin").mkdir()
    for name in ("sh", "make", "echo", "touch"):
        program(tmp_path, name, f'#!/bin/sh\nexec {shutil.which(name)} "$@"\n')
    return tmp_path


def program(checkout, name, text):
    path = checkout / "bin" / name
    path.write_text(text)
    path.chmod(0o755)


def make(checkout, *arguments):
    environment = {"PATH": str(checkout / "bin")}
    return subprocess.run(
        [shutil.which("make"), *arguments],
        cwd=checkout,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def chosen(checkout, *arguments):
    """Return the Pythons that make .venv and .devkit-venv."""
    done = make(checkout, "-n", *arguments, ".venv/.made", ".devkit-venv/.made")
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines() if " -m venv " in line]
    assert [line[-1] for line in lines] == [".venv", ".devkit-venv"]
    return [line[0].strip('"') for line in lines]


@pytest.mark.parametrize(
    ("there", "taken"),
    [
        ({"python3": (3, 11)}, ["python3", "python3"]),
        ({"python3.11": (3, 11)}, ["python3.11", "python3.11"]),
        ({"python3.12": (3, 12)}, ["python3.12", "python3.12"]),
        ({"python3": (3, 9), "python3.12": (3, 12), "python3.11": (3, 11)}, ["python3.12", "python3.12"]),
        ({"python3": (3, 13), "python3.11": (3, 11)}, ["python3", "python3.11"]),
        ({"python3.13": (3, 13)}, ["python3.13", "python3.13"]),
        ({"python3": (3, 15), "python3.14": (3, 14), "python3.12": None}, ["python3.14", "python3.14"]),
        ({"python3": None, "python": (3, 12)}, ["python", "python"]),
    ],
)
def test_the_first_python_that_serves_is_taken(checkout, there, taken):
    for name, version in there.items():
        text = SHIM if version is None else PYTHON.format(real=sys.executable, version=version)
        program(checkout, name, text)
    assert chosen(checkout) == taken


def test_environments_of_other_names_are_made_under_these(checkout):
    program(checkout, "python3", PYTHON.format(real=sys.executable, version=(3, 11)))
    shutil.copy(ROOT / "requirements-lerobot.lock", checkout)
    names = {"VENV": "own", "DEVKIT": "own-devkit", "LEROBOT": "own-lerobot"}
    named = [f"{variable}={name}" for variable, name in names.items()]
    done = make(checkout, "-n", *named, "env", "env-lerobot", "env-fuzz")
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines() if " -m venv " in line]
    assert [line[-1] for line in lines] == [*names.values()]
    assert "touch own/.made-fuzz" in done.stdout


def test_one_that_is_named_is_taken(checkout):
    for name, version in {"python3": (3, 11), "mine": (3, 13), "kit": (3, 11)}.items():
        program(checkout, name, PYTHON.format(real=sys.executable, version=version))
    assert chosen(checkout, "PYTHON=mine") == ["mine", "mine"]
    assert chosen(checkout, "PYTHON=mine", "DEVKIT_PYTHON=kit") == ["mine", "kit"]


@pytest.mark.parametrize(
    ("there", "arguments", "output"),
    [
        ({}, [], "none is on the PATH"),
        ({"python3": (3, 10), "python3.13": None}, [], "none is on the PATH"),
        ({"python3": (3, 12), "old": (3, 10)}, ["PYTHON=old"], "old is not that"),
        ({"python3": (3, 12)}, ["PYTHON=/no/such/python"], "/no/such/python is not that"),
    ],
)
def test_where_none_serves_that_is_said_and_nothing_is_made(checkout, there, arguments, output):
    for name, version in there.items():
        text = SHIM if version is None else PYTHON.format(real=sys.executable, version=version)
        program(checkout, name, text)
    for target in ("demo", "test"):
        done = make(checkout, target, *arguments)
        assert done.returncode == 2
        sentence, end = done.stderr.splitlines()
        assert sentence == (
            f"bagassets needs Python 3.11 to 3.14 with its module venv; {output}. "
            "Install one, or name it: make PYTHON=/path/to/python3.12"
        )
        assert "Error 1" in end
    assert not list(checkout.glob(".*venv"))


def test_ci_fails_where_postgresql_cannot_be_installed(tmp_path):
    """It would have to skip tests."""
    (tmp_path / ".ci").mkdir()
    text = CI.read_text().replace("/usr/lib/postgresql", str(tmp_path / "nowhere"))
    (tmp_path / ".ci" / "run").write_text(text)
    for name, status in {"apt-get": 100, "sudo": 100, "make": 0}.items():
        path = tmp_path / name
        path.write_text(f"#!/bin/sh\necho {name} >> {tmp_path}/ran\nexit {status}\n")
        path.chmod(0o755)
    environment = {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(["bash", tmp_path / ".ci" / "run"], env=environment, check=False)
    assert done.returncode != 0
    assert "make" not in (tmp_path / "ran").read_text()


@pytest.mark.parametrize(
    ("options", "status"), [([], 0), (["--no-skips"], 1), (["--no-skips", "-n", "1"], 1)]
)
def test_a_skipped_test_fails_where_none_may_be_skipped(tmp_path, options, status):
    shutil.copy(Path(__file__).parents[1] / "conftest.py", tmp_path)
    (tmp_path / "test_it.py").write_text(
        "import pytest\n\ndef test_a():\n    pytest.skip('no time')\n\ndef test_b():\n    pass\n"
    )
    done = subprocess.run(
        [*PYTEST, "-rs", f"--basetemp={tmp_path}/base", *options, str(tmp_path)],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == status, done.stdout
    assert "no time" in done.stdout
    assert "\nmake test PYTEST_ARGS=--no-skips\n" in CI.read_text()


def test_tests_are_compiled_once_and_what_they_import_as_somebody_wishes(tmp_path):
    shutil.copy(Path(__file__).parents[1] / "conftest.py", tmp_path)
    (tmp_path / "test_it.py").write_text(
        "import sys\n\ndef test_a(monkeypatch, tmp_path):\n    (tmp_path / 'own.py').touch()\n"
        "    monkeypatch.syspath_prepend(tmp_path)\n    import own\n    assert not (tmp_path / '__pycache__').exists()\n"
    )
    done = subprocess.run(
        [*PYTEST, f"--basetemp={tmp_path}/base", str(tmp_path)],
        cwd=tmp_path, env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert [path for path in tmp_path.glob("__pycache__/test_it.*.pyc") if "pytest" in path.name]


def test_an_environment_that_somebody_else_made_is_kept(checkout):
    program(checkout, "python3", PYTHON.format(real=sys.executable, version=(3, 12, 1)))
    mine = checkout / ".venv" / "mine"
    mine.parent.mkdir()
    mine.touch()
    done = make(checkout, ".venv/.made")
    assert done.returncode != 0
    assert (
        ".venv is here already, and not made by make: remove it, or keep it and name another" in done.stderr
    )
    assert mine.exists()
    (checkout / ".venv" / ".by-make").touch()
    done = make(checkout, ".venv/.made")
    assert "not made by make" not in done.stderr
