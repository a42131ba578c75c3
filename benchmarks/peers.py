"""Builds compared with those of peers, in turn within one run: real Bazel with the rules of Bagzel, and its converter in a loop.

Nothing of theirs is part of this repository; those who want the comparison fetch it (docs/performance.md says how), and
without it only ours is measured::

    make bench-peers
    make bench-peers BAZEL=bazel BAGZEL=bagzel CONVERTER="PYTHON SCRIPT --input_bag {bag} --output_dir {out} --param_file {params}"

Bazel runs the converter as one action per recording. With BAGZEL (a checkout), the rule is that of Bagzel; else one of
our own that does the same. Bagzel's whole module asks for Bazel 8 and a network, so a small workspace is generated
that loads nothing but the rule, for Debian's Bazel 4 (later ones, to 7, know such workspaces, too). Cold is without server, results and digests for
both; before all other rows both have been up and done. The converter in a loop does everything again
whatever changed, so only cold is measured of it.
"""

import argparse
import json
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Those that are run as files find the package beside them.
sys.path.insert(0, str(Path(__file__).parents[1]))

from bagassets.sample.throughput import throughput_cameras
from bagassets.store.canonical import digest_file
from benchmarks.common import ROOT, Options, Project, converter_command, count_files, median, project, save
from benchmarks.drives import LEAST_BYTES, LIDAR_TOPIC, seconds_of

__all__ = ["BAGASSETS", "BAZEL", "LOOP", "main", "peers_table"]

BAGASSETS, BAZEL, LOOP = "bagassets", "Bazel", "converter in a loop"
COLD, LARGE = "{number} recordings of {mb:.0f} MB, cold", "one recording of {gb:.2f} GB, cold"
_NUMBER, _BYTES, _LARGE_BYTES = 8, 246e6, 1.9e9
_LONGEST_SCENE_S = 20.0
_BAZELRC = """\
# As in Bagzel's own, as far as Bazel 4 knows it.
build --noexperimental_check_output_files
build --incompatible_strict_action_env
build --sandbox_default_allow_network=false
"""
_OWN_RULE = """\
def _convert_impl(ctx):
    out = ctx.actions.declare_directory("out/" + ctx.label.name)
    ctx.actions.run_shell(
        inputs = [ctx.file.bag, ctx.file.params],
        tools = [ctx.file.tool],
        outputs = [out],
        command = "./%s --input_bag %s --output_dir %s --param_file %s" % (
            ctx.file.tool.path, ctx.file.bag.path, out.path, ctx.file.params.path),
    )
    return [DefaultInfo(files = depset([out]))]

_file = attr.label(allow_single_file = True)
convert = rule(implementation = _convert_impl, attrs = {"bag": _file, "params": _file, "tool": _file})
"""


@dataclass(frozen=True)
class Peers:
    """What is compared.

    Attributes:
        bazel: the program; None without it.
        converter: a command with `{bag}`, `{out}` and perhaps `{params}`; None without it.
        bagzel: a checkout of Bagzel, whose rule is used; None for one of our own.
    """

    bazel: str | None = None
    converter: str | None = None
    bagzel: Path | None = None


class BazelWorkspace:
    """A workspace with one target per recording of a project.

    Args:
        folder: where it is written, and Bazel's output.
        made: the project.
        peers: Bazel and converter.
        params: settings of the converter.
    """

    def __init__(self, folder: Path, made: Project, peers: Peers, params: Path) -> None:
        self._bazel, self._root, self._home = str(peers.bazel), folder / "workspace", folder / "bazel"
        shutil.rmtree(self._root, ignore_errors=True)
        self._root.mkdir(parents=True)
        (self._root / "bags").symlink_to(made.bags)
        shutil.copy(params, self._root / "params.json")
        convert = self._root / "convert.sh"
        # Called as Bagzel's rule calls its own tool: --input_bag BAG --output_dir OUT --param_file PARAMS.
        places = {"{bag}": '"$2"', "{out}": '"$4"', "{params}": '"$6"'}
        words = [
            "".join(places.get(part) or shlex.quote(part) for part in re.split(r"({\w+})", word) if part)
            for word in shlex.split(str(peers.converter))
        ]
        convert.write_text(f"#!/bin/sh\nexec {' '.join(words)}\n", "utf-8")
        convert.chmod(0o755)
        names = sorted(path.name for path in made.bags.iterdir())
        self._recordings = len(names)
        (self._root / ".bazelrc").write_text(_BAZELRC, "utf-8")
        (self._root / "WORKSPACE").write_text(_workspace(peers.bagzel), "utf-8")
        (self._root / "rules.bzl").write_text(_OWN_RULE, "utf-8")
        (self._root / "BUILD").write_text(_targets(names, bagzel=peers.bagzel is not None), "utf-8")

    def build(self) -> float:
        """Return the wall time of a build of all targets."""
        began = time.perf_counter()
        self._run("build", "//:all", "--noshow_progress", "--ui_event_filters=-info")
        return time.perf_counter() - began

    def start_over(self) -> None:
        """Keep nothing, and no server."""
        self._run("clean")
        self.stop()

    def stop(self) -> None:
        """End the server."""
        self._run("shutdown")

    def files(self) -> int:
        """Return how many files the last build left; 0 if it left none of some recording."""
        made = [count_files(folder) for folder in (self._root / "bazel-bin" / "out").iterdir()]
        return sum(made) if len(made) == self._recordings and all(made) else 0

    def _run(self, *arguments: str) -> None:
        command = [self._bazel, f"--output_user_root={self._home}", *arguments]
        done = subprocess.run(command, cwd=self._root, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{shlex.join(command)} ended with {done.returncode}:\n{done.stderr[-3000:]}")


def _workspace(bagzel: Path | None) -> str:
    if bagzel is None:
        return ""
    path = json.dumps(str(bagzel.absolute()))
    return f'new_local_repository(name = "bagzel", path = {path}, build_file_content = "")\n'


def _targets(names: list[str], *, bagzel: bool) -> str:
    if not bagzel:
        rows = [
            f'convert(name = "{name}_", bag = "bags/{name}", params = "params.json", tool = "convert.sh")'
            for name in names
        ]
        return "\n".join(['load("//:rules.bzl", "convert")', *rows]) + "\n"
    macro = "@bagzel//processing_edges/rosbag_to_nuscenes:rosbag_to_nuscenes_macro.bzl"
    rows = [
        f'single_rosbag_to_nuscenes("bags/{name}", "out", "{Path(name).stem}", tool = "convert.sh", param_file = "params.json")'
        for name in names
    ]
    return "\n".join([f'load("{macro}", "single_rosbag_to_nuscenes")', *rows]) + "\n"


def params_of(seconds: float) -> dict[str, Any]:
    """Return the settings of Bagzel's converter for drives of the profile `tas`: one scene as long as a drive."""
    sensors = {
        camera.channel: (f"/{camera.name}/image_raw", camera.frame)
        for camera in throughput_cameras(1920, 1080)
    }
    sensors["LIDAR_TOP"] = (LIDAR_TOPIC, "lidar_top")
    length_s = min(_LONGEST_SCENE_S, round(0.9 * seconds, 2))
    return {
        "BAG_INFO": {"VEHICLE": "car", "DESCRIPTION": "sample", "ODOM_TOPIC": "/odom", "TRACK": "sample"},
        "SENSOR_INFO": {
            name: {"TOPIC": topic, "FRAME": frame, "TOKEN": f"a{number:031x}"}
            for number, (name, (topic, frame)) in enumerate(sensors.items())
        },
        "EXTRACTION": {"min_bag_duration_sec": 0.1, "scene_length_sec": length_s},
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bazel", help="the program")
    parser.add_argument("--converter", metavar="CMD", help="with {bag}, {out} and perhaps {params}")
    parser.add_argument("--bagzel", type=Path, help="a checkout of Bagzel, whose rule is used")
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--tiny", action="store_true", help="small recordings, one trial; needs --results")
    parser.add_argument("--folder", type=Path, help="where to work; what is there is used again")
    parser.add_argument("--results", type=Path, help="where the table goes; default: benchmarks/results")
    chosen = parser.parse_args()
    if chosen.tiny and chosen.results is None:
        parser.error("--tiny needs --results: its figures say nothing, and must not replace others")
    if chosen.converter and not ("{bag}" in chosen.converter and "{out}" in chosen.converter):
        parser.error("--converter must say where {bag} and {out} go")
    if chosen.bazel and not chosen.converter:
        parser.error("--bazel needs --converter: it runs the converter, once per recording")
    if chosen.bazel and shutil.which(chosen.bazel) is None:
        parser.error(f"--bazel: there is no program {chosen.bazel}")
    converter = chosen.converter and _absolute(chosen.converter)
    peers = Peers(chosen.bazel, converter, chosen.bagzel)
    for peer, option in (("Bazel", peers.bazel), ("converter", peers.converter)):
        if not option:
            print(f"No {peer} was given, so it is not measured.", flush=True)
    with tempfile.TemporaryDirectory(prefix="bagassets-peers-", ignore_cleanup_errors=True) as temporary:
        folder = (chosen.folder or Path(temporary)).absolute()
        folder.mkdir(parents=True, exist_ok=True)
        trials = 1 if chosen.tiny else chosen.trials
        results = chosen.results or Path(__file__).parent / "results"
        options = Options(folder, results, trials, 0.0, 0, converter, chosen.tiny)
        number, size, large = (
            (2, LEAST_BYTES, LEAST_BYTES) if chosen.tiny else (_NUMBER, _BYTES, _LARGE_BYTES)
        )
        rows: dict[str, dict[str, list[dict[str, Any]]]] = {}
        files: dict[str, int] = {}
        hashing_s: list[float] = []
        made = project(folder / "peers", [size] * number, trials, first_seed=400, formats=("ros1",))
        with _methods(folder / "peers-bazel", made, peers, size) as methods:
            _measure(made, methods, options, number, rows, files, hashing_s)
        made = project(folder / "cold-one", [large], trials, formats=("ros1",))
        with _methods(folder / "large-bazel", made, peers, large) as methods:
            _cold(made, methods, options, rows, LARGE.format(gb=made.size_gb), {})
    figures = {
        "bazel": _bazel_version(peers),
        "rule": _rule(peers),
        "rows": rows,
        "files": files,
        "hashing_s": hashing_s,
    }
    save(options, "peers", figures, peers_table({"trials": trials, **figures}))


def peers_table(found: dict[str, Any]) -> str:
    """Return the table of `peers.json`: medians of seconds, and of the ratio to Bazel within each turn."""
    methods = list(found["files"])
    titles = [*_titles(found, methods), *(["ours / Bazel"] if BAZEL in methods else [])]
    lines = [f"| | {' | '.join(titles)} |", "|---|" + "--:|" * len(titles)]
    for row, by_method in found["rows"].items():
        cells = [
            f"{median([one['seconds'] for one in by_method[method]]):.2f} s"
            if method in by_method
            else "everything again"
            for method in methods
        ]
        if BAZEL in by_method:
            turns = zip(by_method[BAGASSETS], by_method[BAZEL], strict=True)
            cells.append(
                f"{100 * median([ours['seconds'] / other['seconds'] for ours, other in turns]):.0f} %"
            )
        lines.append(f"| {row} | {' | '.join(cells)} |")
    files = "; ".join(f"{method}: {number} files" for method, number in found["files"].items())
    hashing = f"Hashing the touched recordings alone: {median(found['hashing_s']):.2f} s."
    return (
        "\n".join(lines)
        + f"\n\nMedians of {found['trials']}; percentages are medians of the ratio within each turn. {hashing} Cold, of all recordings: {files}.\n"
    )


def _titles(found: dict[str, Any], methods: list[str]) -> list[str]:
    titles = {BAZEL: f"Bazel {found['bazel']}, {found['rule']}", LOOP: "Bagzel's converter in a loop"}
    return [titles.get(method, method) for method in methods]


Methods = dict[str, tuple[Callable[[], None], Callable[[], float], Callable[[], int]]]
"""Method -> what it does before a cold build, the build itself, and how many files it left."""


@contextmanager
def _methods(folder: Path, made: Project, peers: Peers, size: float) -> Iterator[Methods]:
    """Yield what is measured with a project; servers end with the block."""
    folder.mkdir(parents=True, exist_ok=True)
    params = folder / "params.json"
    params.write_text(json.dumps(params_of(seconds_of(size))), "utf-8")
    methods: Methods = {
        BAGASSETS: (lambda: _start_over(made), lambda: _build(made), lambda: _dataset_files(made))
    }
    workspace = None
    if peers.bazel:
        workspace = BazelWorkspace(folder, made, peers, params)
        methods[BAZEL] = (workspace.start_over, workspace.build, workspace.files)
    if peers.converter:
        command = peers.converter.replace("{params}", str(params))
        out = folder / "loop"
        methods[LOOP] = (lambda: _empty(out), lambda: _loop(made, command, out), lambda: count_files(out))
    try:
        yield methods
    finally:
        made.stop_server()
        if workspace is not None:
            workspace.stop()


def _measure(
    made: Project,
    methods: Methods,
    options: Options,
    number: int,
    rows: dict[str, dict[str, list[dict[str, Any]]]],
    files: dict[str, int],
    hashing_s: list[float],
) -> None:
    """Measure all rows of several recordings."""
    mb = 1000 * made.size_gb / number
    _cold(made, methods, options, rows, COLD.format(number=number, mb=mb), files)
    changes: dict[str, Callable[[], Any]] = {
        "nothing changed": lambda: None,
        f"content of one of {number} changed": made.change_content,
        "one camera of one changed": made.change_camera,
        "metadata of one changed": made.change_metadata,
        f"all {number} touched, content the same": made.touch_all,
    }
    for _ in range(options.trials):
        for row, change in changes.items():
            change()
            for name, (_, build, _) in methods.items():
                if name != LOOP:
                    made.settle()
                    rows.setdefault(row, {}).setdefault(name, []).append({"seconds": build()})
        hashing_s.append(_hash_alone(made))


def _hash_alone(made: Project) -> float:
    """Hash all recordings as a build does, which it has to where they were touched, and return the seconds."""
    made.settle()
    begun = time.monotonic()
    with ThreadPoolExecutor() as pool:
        list(pool.map(digest_file, made.files()))
    return time.monotonic() - begun


def _cold(
    made: Project,
    methods: Methods,
    options: Options,
    rows: dict[str, dict[str, list[dict[str, Any]]]],
    row: str,
    files: dict[str, int],
) -> None:
    for _ in range(options.trials):
        for name, (start_over, build, count) in methods.items():
            start_over()
            made.settle()
            rows.setdefault(row, {}).setdefault(name, []).append({"seconds": build()})
            files[name] = count()
            if not files[name]:
                sys.exit(f"{name} left no files of some recording")


def _start_over(made: Project) -> None:
    made.start_over()
    made.hash_at_client()


def _build(made: Project) -> float:
    return _timed([sys.executable, "-m", "bagassets", "build", "--recipe", str(made.recipe)])


def _timed(command: Sequence[str]) -> float:
    """Return the wall time of a command. Nothing watches it: Bazel is not watched either, and watching takes 4 % of two processors."""
    began = time.perf_counter()
    done = subprocess.run(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    seconds = time.perf_counter() - began
    if done.returncode:
        sys.exit(f"{shlex.join(command)} ended with {done.returncode}:\n{done.stdout[-3000:]}")
    return seconds


def _loop(made: Project, command: str, out: Path) -> float:
    """Run the converter on one recording after the other."""
    from bagassets.recipe import load_recipe
    from bagassets.recordings.discover import discover

    total_s = 0.0
    for recording in discover(load_recipe(made.recipe).bags).recordings.values():
        target = out / recording.key
        target.mkdir(parents=True)
        total_s += _timed(converter_command(command, recording, target))
        if not count_files(target):
            sys.exit(f"the converter left no files of {recording.key}")
    return total_s


def _dataset_files(made: Project) -> int:
    return count_files(made.recipe.parent / "nuscenes")


def _empty(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)


def _absolute(command: str) -> str:
    """Return a command with the paths of files that exist made absolute: it is run in other folders."""
    # Not resolved: the Python of an environment is a link, and known by its own path.
    words = [str(Path(word).absolute()) if Path(word).exists() else word for word in shlex.split(command)]
    return " ".join(word if "{" in word else shlex.quote(word) for word in words)


def _bazel_version(peers: Peers) -> str:
    """Return the version of Bazel; Debian's own says "no_version", so its package is asked."""
    if not peers.bazel:
        return ""
    command = [[peers.bazel, "--version"], ["dpkg-query", "-W", "-f=${Version} (Debian)", "bazel-bootstrap"]]
    for one in command:
        done = subprocess.run(one, capture_output=True, text=True, check=False)
        version = done.stdout.strip().removeprefix("bazel ")
        if version and not done.returncode and version != "no_version":
            return version
    return "of unknown version"


def _rule(peers: Peers) -> str:
    if not peers.bazel:
        return ""
    if peers.bagzel is None:
        return "a rule of ours"
    done = subprocess.run(
        ["git", "-C", str(peers.bagzel), "rev-parse", "--short", "HEAD"],
        capture_output=True,
        text=True,
        check=False,
    )
    return f"Bagzel's rule ({done.stdout.strip() or 'no commit'})"


if __name__ == "__main__":
    main()
