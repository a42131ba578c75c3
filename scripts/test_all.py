"""`make test-all`: what `make test` leaves out, part by part, each with what it does and how long it took.

    python -m scripts.test_all                  # all parts but for `benchmarks`
    python -m scripts.test_all lowest newest    # some

A part that needs a Python which this machine lacks is left out with a message, and does not count as a failure.
"""

import argparse
import os
import platform
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

__all__ = ["LOWEST_PYTHON", "Part", "find_pythons", "main"]

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "build" / "test-all"
LOWEST_PYTHON = (3, 11)
NEWEST_PYTHON = (3, 14)
LEROBOT_PYTHON = (3, 11)
_USABLE = "import ensurepip, sys, venv; print(*sys.version_info[:2])"
_TESTS = ("-m", "pytest", "-q", "-n", "auto", "-p", "no:cacheprovider", "--dist")
_AT_MOST_S = 45 * 60.0  # a part that hangs must not take the time of the others; a slow day is no hang


class FailedError(Exception):
    """A command of a part failed."""


class LeftOutError(Exception):
    """This machine lacks what a part needs."""


@dataclass(frozen=True)
class Part:
    """One part.

    Attributes:
        about: what it does, for people.
        run: does it.
        prepare: makes an environment of its own.
    """

    about: str
    run: Callable[[], None]
    prepare: Callable[[], None] = lambda: None


def main(arguments: list[str]) -> int:
    """Run the parts that are named, or all that are not run by hand; return the exit status."""
    parser = argparse.ArgumentParser(prog="make test-all", description=__doc__)
    usual = [name for name in PARTS if name not in BY_HAND]
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; default: {', '.join(usual)}")
    chosen = parser.parse_args(arguments).parts or usual
    if unknown := [name for name in chosen if name not in PARTS]:
        parser.error(f"no part {unknown[0]!r}; the parts are {', '.join(PARTS)}")
    started = time.monotonic()
    # Together, as pip uses one processor, and before any test, as it takes that from what measures time.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        prepared = {name: pool.submit(PARTS[name].prepare) for name in chosen}
    left = ", ".join(name for name in chosen if prepared[name].exception())
    results = [("prepare", time.monotonic() - started, f"done, but for {left}" if left else "done")]
    for name in chosen:
        _say(f"== {name}: {PARTS[name].about}")
        started = time.monotonic()
        try:
            prepared[name].result()
            PARTS[name].run()
            result = "passed"
        except LeftOutError as err:
            result = f"left out: {err}"
        except FailedError as err:
            result = f"FAILED: {err}"
        results.append((name, time.monotonic() - started, result))
        _say(f"== {name}: {result} ({_minutes(results[-1][1])})")
    _say("")
    for name, took_s, result in results:
        _say(f"{name:8} {_minutes(took_s):>12}  {result}")
    _say(f"{'all':8} {_minutes(sum(took_s for _, took_s, _ in results)):>12}")
    return 1 if any(result.startswith("FAILED") for _, _, result in results) else 0


def _long() -> None:
    # Not by file: some files would keep one worker busy after all others are done.
    _run(sys.executable, *_TESTS, "loadgroup", "-m", "long and not lerobot and not benchmark")


def _benchmarks() -> None:
    _run(sys.executable, *_TESTS, "load", "-m", "benchmark")


def _prepare_lerobot() -> None:
    python = find_pythons().get(LEROBOT_PYTHON)
    if python is None:
        raise LeftOutError(f"there is no Python {_dotted(LEROBOT_PYTHON)}, with which this lerobot runs")
    _run("make", f"LEROBOT_PYTHON={python}", "env-lerobot")


def _lerobot() -> None:
    _run("make", "test-lerobot")


def _prepare_fuzz() -> None:
    if platform.machine() != "x86_64":
        raise LeftOutError(f"atheris has no wheels for {platform.machine()}")
    _run("make", "env-fuzz")


def _fuzz() -> None:
    _run("make", "FUZZ_MINUTES=1", "FUZZ=--seed 1", "fuzz")


def _prepare_lowest() -> None:
    python = find_pythons().get(LOWEST_PYTHON)
    if python is None:
        raise LeftOutError(
            f"there is no Python {_dotted(LOWEST_PYTHON)}, for which these versions have wheels"
        )
    _make_environment("lowest", python, ["--requirement", str(ROOT / "requirements-lowest.lock")])


def _prepare_newest() -> None:
    pythons = find_pythons()
    if not pythons:
        raise LeftOutError("there is no Python that bagassets runs with and that can make environments")
    version = max(pythons)
    if version == sys.version_info[:2]:
        _say(
            f"There is no newer Python than {_dotted(version)} here: the newest packages are tried with that."
        )
    _make_environment("newest", pythons[version], ["--prefer-binary", *_requirements()])


def _in_environment(name: str) -> None:
    """Run the tests that depend on libraries, with those of an environment."""
    _run(_python_of(name), *_TESTS, "loadfile", "-m", "not long and not once")


PARTS = {
    "long": Part(
        "tests that take long, or are some of many alike: the wheel, installed outside of the checkout", _long
    ),
    "lerobot": Part(
        "the real lerobot on datasets of ours, in an environment of its own", _lerobot, _prepare_lerobot
    ),
    "fuzz": Part("bytes that nobody wrote, for whatever reads bytes, a minute of them", _fuzz, _prepare_fuzz),
    "lowest": Part(
        "what depends on libraries, with the lowest versions that pyproject.toml allows",
        partial(_in_environment, "lowest"),
        _prepare_lowest,
    ),
    "newest": Part(
        "what depends on libraries, with the newest Python here, and the newest versions",
        partial(_in_environment, "newest"),
        _prepare_newest,
    ),
    "benchmarks": Part("benchmarks that run for minutes, however small their recordings", _benchmarks),
}
BY_HAND = ("benchmarks",)  # before a release, or when one of them was changed


def find_pythons() -> dict[tuple[int, int], str]:
    """Return the Pythons that bagassets runs with: version -> program.

    This one comes first, then those on the PATH; those of pyenv are found even if none of them is chosen.
    """
    minors = range(NEWEST_PYTHON[1], LOWEST_PYTHON[1] - 1, -1)
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    candidates = [sys.executable, *(f"python3.{minor}" for minor in minors), "python3"]
    candidates += [
        str(path) for minor in minors for path in sorted(pyenv.glob(f"versions/3.{minor}.*/bin/python"))
    ]
    found: dict[tuple[int, int], str] = {}
    for name in candidates:
        version = _version(name)
        if version is not None and LOWEST_PYTHON <= version <= NEWEST_PYTHON:
            found.setdefault(version, name)
    return found


def _version(python: str) -> tuple[int, int] | None:
    """Ask a program for its version; None if it is no Python that can make environments."""
    try:
        done = subprocess.run([python, "-c", _USABLE], capture_output=True, text=True, check=True, timeout=60)
        major, minor = done.stdout.split()
        return int(major), int(minor)
    except (OSError, subprocess.SubprocessError, ValueError):  # shims of pyenv run, and fail
        return None


def _python_of(name: str) -> str:
    return str(FOLDER / name / "bin" / "python")


def _make_environment(name: str, python: str, requirements: Iterable[str]) -> None:
    """Make an environment with these requirements and the checkout."""
    folder, inside = FOLDER / name, _python_of(name)
    shutil.rmtree(folder, ignore_errors=True)
    _run(python, "-m", "venv", str(folder))
    install = (inside, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
    _run(*install, *requirements)
    _run(*install, "--no-deps", "--editable", str(ROOT))
    # As the Makefile does for its environment: else each command of another Python compiles us where nobody keeps bytecode.
    _run(inside, "-m", "compileall", "-q", "bagassets")
    _run(inside, "--version")
    _run(
        inside,
        "-m",
        "pip",
        "freeze",
        "--exclude-editable",
        "--disable-pip-version-check",
        to=folder / "freeze.txt",
    )
    _say(f"   versions: {folder / 'freeze.txt'}")


def _requirements() -> list[str]:
    """Return all that pyproject.toml asks for, as it has it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    return [
        *project["project"]["dependencies"],
        *project["project"]["optional-dependencies"]["postgres"],
        *project["project"]["optional-dependencies"]["video"],
        *project["dependency-groups"]["dev"],
    ]


def _run(*command: str, to: Path | None = None) -> None:
    """Run a command in the checkout, and all that it starts no longer than a part may take.

    Raises:
        FailedError: it failed, or took too long.
    """
    shown = " ".join(part.replace(f"{ROOT}/", "") for part in command if len(part) < 200)
    started = time.monotonic()
    _say(f"-- {shown[:200]}")
    output = to.open("wb") if to else None
    try:
        process = subprocess.Popen(
            command, cwd=ROOT, start_new_session=True, stdout=output, stdin=subprocess.DEVNULL
        )
    finally:
        if output:
            output.close()
    try:
        status = process.wait(_AT_MOST_S)
    except subprocess.TimeoutExpired:
        raise FailedError(f"{shown[:60]} … took more than {_minutes(_AT_MOST_S)}") from None
    finally:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    _say(f"   {_minutes(time.monotonic() - started)}")
    if status:
        raise FailedError(f"{shown[:60]} … ended with exit status {status}")


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.1f} min" if seconds >= 60 else f"{seconds:.0f} s"


def _dotted(version: tuple[int, int]) -> str:
    return f"{version[0]}.{version[1]}"


def _say(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
