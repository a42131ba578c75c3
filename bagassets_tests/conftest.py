"""The environment of all tests: the same wherever they run.

What somebody has set for other reasons (a locale, a time zone, threads of OpenBLAS, a proxy) changes what
libraries and programs do. So few variables are kept, and a test that depends on one sets it.
"""

import os
import re
import sys
import time
from collections.abc import Generator, Iterator
from fnmatch import fnmatchcase
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from bagassets_tests.slurm_cluster import Cluster

# Where programs and files are, the devkit's environment, and what drives the tests.
KEPT = (
    "PATH", "HOME", "TMPDIR", "USER", "LOGNAME", "SHELL", "PYTHONPATH", "LD_LIBRARY_PATH",
    "BAGASSETS_DEVKIT_PYTHON", "BAGASSETS_LEROBOT_PYTHON", "PYTEST_*", "HYPOTHESIS_*", "COVERAGE_*", "COV_CORE_*", "MUTA*", "PYTHONDONTWRITEBYTECODE",
)  # fmt: skip
SET = {"LC_ALL": "C.UTF-8", "TZ": "UTC"}
# By these, runs choose tests: a test has none that its file does not name, and all that `pytestmark` of its file names.
MARKS = ("benchmark", "lerobot", "long", "once")


def pytest_configure() -> None:
    """Replace the environment of this process, before a test imports a library that reads it."""
    for name in list(os.environ):
        if not any(fnmatchcase(name, pattern) for pattern in KEPT):
            del os.environ[name]
    os.environ.update(SET)
    time.tzset()
    os.umask(0o022)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keep the bytecode of tests even where none is to be written: each worker of each run would compile them anew."""
    before, sys.dont_write_bytecode = sys.dont_write_bytecode, False
    try:
        return (yield)
    finally:
        sys.dont_write_bytecode = before


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add what CI asks for: a test that could not run is no test that passed."""
    parser.addoption("--no-skips", action="store_true", help="fail if a test is skipped")


def may_be_chosen(text: str, expression: str) -> bool:
    """Whether marks let a run choose some test of a file; True if that cannot be told.

    Args:
        text: of the file.
        expression: what follows `-m`.
    """
    named = set(re.findall(r"\bmark\.(\w+)", text))
    by_all = re.search(r"^pytestmark = (\[[^]]*\]|.*)", text, re.MULTILINE)
    of_all = set(re.findall(r"\bmark\.(\w+)", by_all[0])) if by_all else set()
    cases = [(True,) if mark in of_all else (False, True) if mark in named else (False,) for mark in MARKS]
    try:
        return any(eval(expression, {}, dict(zip(MARKS, has, strict=True))) for has in product(*cases))
    except (NameError, SyntaxError):
        return True


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file of which no test is chosen: each worker of each part of `make test-all` would import all of them."""
    expression = config.getoption("markexpr")
    if not expression or collection_path.suffix != ".py":
        return None
    return None if may_be_chosen(collection_path.read_text("utf-8"), expression) else True


def pytest_sessionfinish(session: pytest.Session) -> None:
    """With `--no-skips`, fail if a test was skipped."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and session.config.getoption("no_skips") and "skipped" in reporter.stats:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say why a run without a failure fails."""
    if terminalreporter.config.getoption("no_skips") and "skipped" in terminalreporter.stats:
        terminalreporter.write_line("--no-skips: the tests above that were skipped must run.", red=True)


@pytest.fixture(scope="session")
def slurm_cluster() -> Iterator["Cluster"]:
    """A real Slurm, for the whole session."""
    from bagassets_tests.slurm_cluster import running_cluster

    with running_cluster() as cluster:
        yield cluster


@pytest.fixture
def slurm(slurm_cluster: "Cluster", monkeypatch: pytest.MonkeyPatch) -> "Cluster":
    """Slurm without a job, found by its commands."""
    slurm_cluster.reset()
    monkeypatch.delenv("BAGASSETS_RECIPE", raising=False)  # a build in this process has set it
    for name, value in slurm_cluster.environment.items():
        monkeypatch.setenv(name, value)
    return slurm_cluster
