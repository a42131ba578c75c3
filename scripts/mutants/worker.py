"""A process that has imported what tests import of others, and forks a child for each job.

Jobs come in as lines of JSON, answers go out so. A job names a changed file, the tests to run in order and how
long they may take; the first test that fails ends it. With `coverage`, tests of one file are run and what each
of them ran is written down.
"""

import contextlib
import ctypes
import importlib
import json
import os
import resource
import shutil
import signal
import sys
import time
import traceback
from pathlib import Path
from typing import Any

_OTHERS = (
    "pytest", "_pytest.assertion.rewrite", "hypothesis", "hypothesis.strategies", "hypothesis.extra.numpy", "numpy", "numpy.random", "numpy.testing",
    "cv2", "pyarrow", "pyarrow.parquet", "pyarrow.compute", "pydantic", "yaml", "click", "click.testing", "rich",
    "rich.table", "rich.console", "rich.progress", "blake3", "lz4.frame", "zstandard", "mcap.reader", "mcap.writer",
    "rosbags.highlevel", "rosbags.rosbag1", "rosbags.rosbag2", "rosbags.typesys", "velodyne_decoder", "dagster",
    "dagster._core.storage.event_log.sqlite", "sqlalchemy", "watchfiles", "folium", "coverage",
)  # fmt: skip
_MEMORY = 12 << 30
_PR_SET_CHILD_SUBREAPER = 36


def main() -> None:
    """Take jobs until there are no more."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    for name in _OTHERS:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        answers.write(json.dumps(_do(json.loads(line))) + "\n")
        answers.flush()


def _do(job: dict[str, Any]) -> dict[str, Any]:
    scratch = Path(job["scratch"])
    result = scratch / "result.json"
    changed = Path(job["path"]) if job.get("path") else None
    original = changed.read_bytes() if changed else b""
    stat = changed.stat() if changed else None
    if changed:
        changed.write_text(job["text"], "utf-8")
    began = time.monotonic()
    try:
        child = os.fork()
        if not child:
            _child(job, scratch, result, changed=changed is not None)
        ended = _wait(child, began, job["cpu_s"], job["wall_s"])
    finally:
        _end_descendants()
        if changed and stat:
            changed.write_bytes(original)
            os.utime(changed, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    answer = (
        json.loads(result.read_text())
        if result.exists()
        else {"outcome": "crashed", "killer": "", "why": ended}
    )
    if ended in {"busy", "stuck"}:
        answer |= {"outcome": "hung", "why": ended}
    if not job.get("keep"):
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
    return answer | {"seconds": round(time.monotonic() - began, 2)}


def _wait(child: int, began: float, cpu_s: float, wall_s: float) -> str:
    """Wait for the child; return how it ended, `busy` or `stuck` if it had to be killed."""
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return f"exit {os.waitstatus_to_exitcode(status)}"
        used, waited = _cpu_seconds(child), time.monotonic() - began
        if used > cpu_s or waited > wall_s:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "busy" if used > cpu_s else "stuck"
        time.sleep(0.02)


def _cpu_seconds(pid: int) -> float:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(int(value) for value in fields[11:15]) / os.sysconf("SC_CLK_TCK")


def _end_descendants() -> None:
    """Kill what the child left: orphans become children of this process."""
    while True:
        parents: dict[int, int] = {}
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):
                fields = stat.read_text().rpartition(")")[2].split()
                parents[int(stat.parent.name)] = int(fields[1])
        found, grown = {os.getpid()}, True
        while grown:
            more = {pid for pid, parent in parents.items() if parent in found} - found
            found, grown = found | more, bool(more)
        left = found - {os.getpid()}
        if not left:
            return
        for pid in left:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(-1, 0)


def _child(job: dict[str, Any], scratch: Path, result: Path, *, changed: bool) -> None:
    code = 3
    try:
        os.setsid()
        log = os.open(scratch / "log.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.chdir(job["tree"])
        sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
        sys.argv = ["pytest"]
        if changed:
            # What is compiled of the unchanged files stays; times tell that the changed one is another.
            sys.dont_write_bytecode = True
            os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        os.environ["TMPDIR"] = str(scratch)
        answer = _run(job, scratch)
        result.write_text(json.dumps(answer))
        code = 0
    except BaseException:  # noqa: BLE001  (the log has it)
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


class _Chosen:
    """Keeps the tests that are asked for, in that order, and remembers the first that fails and all times."""

    def __init__(self, wanted: list[str] | None, coverage: Any) -> None:
        self.place = {name: number for number, name in enumerate(wanted)} if wanted is not None else None
        self.coverage = coverage
        self.killer = ""
        self.why = ""
        self.failed: list[str] = []
        self.seconds: dict[str, float] = {}

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        if self.place is not None:
            items[:] = sorted(
                (item for item in items if item.nodeid in self.place),
                key=lambda item: self.place[item.nodeid],
            )

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        os.environ["MUTANTS_TEST"] = nodeid
        self._context(f"setup|{nodeid}")

    def pytest_runtest_call(self, item: Any) -> None:
        self._context(f"call|{item.nodeid}")

    def pytest_runtest_teardown(self, item: Any) -> None:
        self._context(f"setup|{item.nodeid}")

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if report.failed:
            self._fail(report)

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed:
            self._fail(report)

    def _fail(self, report: Any) -> None:
        self.failed.append(report.nodeid)
        if not self.killer:
            self.killer = report.nodeid
            self.why = str(report.longrepr)[-400:]

    def _context(self, name: str) -> None:
        if self.coverage is not None:
            self.coverage.switch_context(name)


def _run(job: dict[str, Any], scratch: Path) -> dict[str, Any]:
    import pytest
    from hypothesis import settings

    settings.register_profile("mutants", derandomize=True, database=None, deadline=None)
    settings.load_profile("mutants")
    coverage = _begin_coverage(job, scratch) if job.get("coverage") else None
    chosen = _Chosen(job["tests"], coverage)
    args = [
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "-p",
        "no:anyio",
        "--basetemp",
        str(scratch / "t"),
    ]
    code = pytest.main([*args, *(["-x"] if not coverage else []), *job["files"]], plugins=[chosen])
    answer: dict[str, Any] = {
        "outcome": "killed" if chosen.killer else "survived" if code in {0, 5} else "crashed",
        "killer": chosen.killer, "why": chosen.why, "times": chosen.seconds, "failed": chosen.failed,
    }  # fmt: skip
    if coverage is not None:
        coverage.stop()
        coverage.save()
        answer["lines"] = _lines(scratch, Path(job["tree"]))
    return answer


def _begin_coverage(job: dict[str, Any], scratch: Path) -> Any:
    import coverage

    config = scratch / "coveragerc"
    config.write_text(
        f"[run]\nsource = {job['tree']}/bagassets\nparallel = true\ndata_file = {scratch}/cov/data\n"
        "context = process|${MUTANTS_TEST}\npatch = _exit\nsigterm = true\n"
    )
    (scratch / "cov").mkdir()
    os.environ["MUTANTS_TEST"] = ""
    measured = coverage.Coverage(
        data_file=str(scratch / "cov" / "main"), source=[f"{job['tree']}/bagassets"], config_file=False
    )
    measured.start()
    os.environ["COVERAGE_PROCESS_START"] = str(config)
    return measured


def _lines(scratch: Path, tree: Path) -> dict[str, dict[str, list[int]]]:
    """Return file -> context -> lines that ran."""
    import coverage

    found: dict[str, dict[str, set[int]]] = {}
    for data in sorted((scratch / "cov").iterdir()):
        try:
            store = coverage.CoverageData(str(data))
            store.read()
        except coverage.CoverageException:
            continue
        for file in store.measured_files():
            relative = Path(file).relative_to(tree).as_posix()
            for line, contexts in store.contexts_by_lineno(file).items():
                for context in contexts:
                    found.setdefault(relative, {}).setdefault(context, set()).add(line)
    return {file: {context: sorted(lines) for context, lines in of.items()} for file, of in found.items()}


if __name__ == "__main__":
    main()
