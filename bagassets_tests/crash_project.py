"""A small project whose commands are recorded, and repeated after crashes and failures: each in a process of its own.

Commands are executed whole, Dagster included, in forked processes that have imported everything; runs are executed at once in
the same process. Only the power is simulated: after a loss of it the machine seems to have booted again.
"""

import errno
import gc
import hashlib
import importlib
import io
import os
import pickle
import random
import shutil
import sys
import time
import traceback
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from itertools import product

import pytest

from bagassets.base import fingerprints
from bagassets.base.errors import BagAssetsError
from bagassets.cli.main import main, text_of_refusal
from bagassets.defs.graph.own_location import know_installed_modules
from bagassets.engine.freshness import decide
from bagassets.formats import after_crash
from bagassets.formats.dataset_integrity import find_damage
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets.store.store import Store
from bagassets_tests import arm_recordings, failing_reads
from bagassets_tests.crash_disk import (
    Disk,
    Node,
    Recording,
    crashed,
    databases,
    databases_at,
    lay_out,
    state_of,
    take,
)
from bagassets_tests.in_process import QUICK, build, load_definitions
from bagassets_tests.recorded_bags import write_mcap
from bagassets_tests.small_drive import write_drive
from bagassets_tests.store_check import check_store

STATE, DATASET, OTHER = ".bagassets", "dataset/nuscenes", "restored"
LEROBOT = "dataset/lerobot"
TREES = (STATE, "dataset", OTHER)
RECIPE = QUICK.replace("min_length_s: 0.5", "min_length_s: 0.05")
EDITED = RECIPE.replace("min_length_s: 0.05", "min_length_s: 0.05, keyframe_hz: 4")
RECIPES = {DATASET: RECIPE.format(name="test", root="bags"), LEROBOT: arm_recordings.RECIPE}
_WORTH_IMPORTING = {
    "av",
    "bagassets",
    "cv2",
    "dagster",
    "dagster_shared",
    "numpy",
    "pyarrow",
    "scipy",
    "sqlalchemy",
    "upath",
}


DIED = "the process died"


class DiedError(Exception):
    """A process ended without an answer."""


_modules = set()


def be_quiet():
    """Have this process print nothing."""
    quiet = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(quiet, descriptor)


def forked(function, *arguments):
    """Call a function in a forked process, without what it prints; return its result.

    Raises:
        DiedError: it was killed.
    """
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reading)
            be_quiet()
            try:
                answer = True, function(*arguments)
            except BaseException:
                answer = False, traceback.format_exc()
            with open(writing, "wb") as stream:
                pickle.dump((answer, set(sys.modules)), stream)
        finally:
            os._exit(1)
    os.close(writing)
    with open(reading, "rb") as stream:
        text = stream.read()
    os.waitpid(pid, 0)
    if not text:
        raise DiedError
    (is_answer, answer), modules = pickle.loads(text)
    _modules.update(modules)
    if not is_answer:
        raise AssertionError(answer)
    return answer


def import_what_was_needed():
    """Import what forked processes had to, so that the next ones begin with it."""
    for name in sorted(_modules - sys.modules.keys()):
        if name.partition(".")[0] in _WORTH_IMPORTING:
            with suppress(ImportError):
                importlib.import_module(name)
    know_installed_modules()


def warm_up(folder):
    """Build a project in this process, so that processes forked from it have compiled statements and definitions at hand."""
    project = Project(folder)
    project.put("a", 0)
    for number in range(2):
        project.put("b", number)
        assert project.build() == ""
    import_what_was_needed()
    gc.collect()
    gc.freeze()  # else whatever is looked at is copied in each process


class Project:
    """A project in a folder, with a pool of recordings beside it: of a vehicle, or of an arm.

    Attributes:
        folder: its folder.
        dataset: its dataset, below that; `LEROBOT` for one of an arm.
    """

    def __init__(self, folder):
        self.dataset = DATASET
        self.folder, self.pool = folder / "project", folder / "pool"
        self.recipe_file = self.folder / "recipe.yaml"
        self._clock_s = 1_700_000_000
        for number in range(6):
            write_drive(self.pool / DATASET / f"{number}.mcap", "mcap", duration_s=0.3 + 0.1 * number)
            (self.pool / LEROBOT).mkdir(parents=True, exist_ok=True)
            messages = arm_recordings.arm_messages(0.2 + 0.1 * number, first=100 * number)
            write_mcap(self.pool / LEROBOT / f"{number}.mcap", messages)
        self.start_anew()

    def start_anew(self, dataset=DATASET):
        """Make the project without recordings, and nothing built."""
        self.dataset = dataset
        shutil.rmtree(self.folder, ignore_errors=True)
        (self.folder / "bags").mkdir(parents=True)
        write_project(self.folder, RECIPES[dataset])
        self.enter()

    def enter(self):
        """Have this process be about this project."""
        os.environ["BAGASSETS_RECIPE"] = str(self.recipe_file)
        load_definitions(self.recipe_file)

    def clear(self):
        """Remove all that was made, but neither recordings nor recipe."""
        self.lay_out(Node())
        write_project(self.folder, self.recipe_file.read_text("utf-8"))

    def lay_out(self, tree):
        """Replace all that was made; only this process believes in the times of the files."""
        for name in TREES:
            shutil.rmtree(self.folder / name, ignore_errors=True)
        lay_out(tree, self.folder)

    # --- what users do ---

    def put(self, name, number):
        """Put a recording of the pool below the bag root, with a time that no file had before."""
        self._clock_s += 10
        path = self.folder / "bags" / f"{name}.mcap"
        shutil.copyfile(self.pool / self.dataset / f"{number}.mcap", path)
        os.utime(path, (self._clock_s, self._clock_s))

    def touch(self, name):
        self._clock_s += 10
        os.utime(self.folder / "bags" / f"{name}.mcap", (self._clock_s, self._clock_s))

    def take_away(self, name):
        (self.folder / "bags" / f"{name}.mcap").unlink()

    def edit(self):
        is_edited = "keyframe_hz" in self.recipe_file.read_text("utf-8")
        self.recipe_file.write_text(
            (RECIPE if is_edited else EDITED).format(name="test", root="bags"), "utf-8"
        )

    # --- commands; each returns a text if it did not end well ---

    def build(self):
        with pytest.MonkeyPatch.context() as patched:
            report, _ = build(self.recipe_file, patched)
        failed = (one.reason for one in report.outcomes.values() if one.result == "failed")
        return "; ".join(filter(None, [report.dataset_problem, *failed]))

    def call(self, *arguments):
        """Call a command of the command line."""
        out = io.StringIO()
        with redirect_stdout(out), redirect_stderr(out):
            status = main([*arguments, "--recipe", str(self.recipe_file)])
        return f"{' '.join(arguments)} ended with {status}: {out.getvalue()}" if status else ""

    def gc(self):
        return self.call("gc", "--keep-days", "0")

    def restore(self, output=OTHER):
        (lock,) = (self.folder / STATE / "kept-locks").iterdir()
        return self.call("dataset", "restore", str(lock), "--output", str(self.folder / output))

    # --- what there is ---

    def keep_lock(self):
        (lock,) = (self.folder / self.dataset).glob("*/dataset.lock.json")
        kept = self.folder / STATE / "kept-locks"
        kept.mkdir(exist_ok=True)
        shutil.copyfile(lock, kept / "first.lock.json")

    def files_in(self, name=None):
        """Name -> digest of everything in a dataset, folders included; by default in the one that is built."""
        root = self.folder / (name or self.dataset)
        return {
            path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            if path.is_file()
            else ""
            for path in root.rglob("*")
            if path.name != ".bagassets.lock"
        }

    def damage(self):
        """What `verify` would name."""
        recipe = load_recipe(self.recipe_file)
        store = Store(recipe.store_path)
        return [str(one) for one in (*check_store(store), *find_damage(recipe, store))]

    def judge(self, expected, restored=None, *, leaves_rests=False):
        """Build; return what is not as it should be, else an empty text.

        Args:
            expected: the dataset.
            restored: the restored one; None if there is none.
            leaves_rests: what could not be removed may stay, until a build has something to do.
        """
        if problem := self.build():
            return f"the next build failed: {problem}"
        if damage := self.damage():
            return f"verify: {damage}"
        found = self.files_in()
        if differing := differing_in(without_rests(found) if leaves_rests else found, expected):
            return f"the dataset differs in {differing}"
        if restored is not None:
            if problem := self.restore():
                return problem
            if differing := differing_in(self.files_in(OTHER), restored):
                return f"the restored dataset differs in {differing}"
        report = self.folder / STATE / "report.html"
        if not report.read_bytes().rstrip().endswith(b"</html>"):
            return "the report is torn"
        return self.call("gc", "--dry-run")


def without_rests(found):
    """The files of a dataset without those of folders that could not be removed."""
    return {name: digest for name, digest in found.items() if ".tmp-" not in name.partition("/")[0]}


def differing_in(found, expected):
    return sorted(name for name in {*found, *expected} if found.get(name) != expected.get(name))[:5]


def boot_again():
    """After a loss of power, the machine has another boot id, and was booted just now."""
    boot, booted_s = f"boot-{time.time_ns()}", time.time()
    for module in (fingerprints, after_crash, decide):
        module.boot_id = lambda: boot
    after_crash.booted_at_s = lambda: booted_s


# --- what is recorded ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Scenario:
    """A command: the state before it, as it was recorded, and the files of the datasets once all is done.

    Attributes:
        command: name of the method of the project.
        recording: its changes.
        expected: the dataset of a project that was built from nothing.
        restored: the same of the restored one; None if there is none.
        links: what files of the dataset may be; see `Disk`.
        dataset: which one the project makes.
    """

    command: str
    recording: Recording
    expected: dict[str, str]
    restored: dict[str, str] | None = None
    links: str = "hard"
    dataset: str = DATASET


SCENARIOS = (
    "first build", "change", "change, copies", "change, reflinks", "removal", "gc", "restore",
    "LeRobot: first build", "LeRobot: change", "LeRobot: removal",
)  # fmt: skip


def recorded(project, name):
    """Record a command in a project made for it; the project stays as the command found it, but for its trees."""
    dataset, what = (
        (LEROBOT, name.removeprefix("LeRobot: ")) if name.startswith("LeRobot") else (DATASET, name)
    )
    what, _, links = what.partition(", ")
    links, restored = links or "hard", None
    project.start_anew(dataset)
    project.put("a", 0)
    if what != "first build":
        project.put("b", 1)
        assert _built(project, links) == ""
        project.keep_lock()
        restored = project.files_in()
    if what in ("change", "gc"):
        project.put("b", 2)
    if what == "gc":
        assert _built(project) == ""
    if what == "removal":
        project.take_away("b")
    command = {"gc": "gc", "restore": "restore"}.get(what, "build")
    base = take(project.folder, TREES)
    recording = forked(_record, project, command, base, links)
    recording.base = base
    project.clear()
    assert _built(project, links) == ""
    expected = project.files_in()
    return Scenario(command, recording, expected, restored if command != "build" else None, links, dataset)


def _built(project, links="hard"):
    def run():
        Disk(project.folder, links=links).install()
        return project.build()

    return forked(run)


def _record(project, command, base, links):
    recording = Recording(None)
    Disk(project.folder, recording=recording, links=links).install()
    problem = getattr(project, command)()
    assert problem == "", problem
    recording.databases.append(databases(project.folder, STATE))
    return recording


@dataclass(frozen=True)
class Crash:
    """A crash before a change, and what is left of unsynced bytes; see `crashed`.

    Attributes:
        number: number of changes before it.
        power: True for a loss of power, after which the machine boots again; else a kill.
        how: what is left of new files.
        lost: changes that are lost.
        without: whose last commit is lost; see `crashed`.
        seed: of the dice.
    """

    number: int
    power: bool = False
    how: str = "whole"
    lost: tuple[int, ...] = ()
    without: str = ""
    seed: int = 0


def crashes(scenario, seed=0):
    """Yield all crashes of a scenario: killed before each change; and without power, new files empty, full of zeros, torn in the
    middle, or any of these, and once with one of the last changes lost; each with and without the last commit of Dagster, and
    then by dice without that of the caches."""
    dice, recording = random.Random(seed), scenario.recording
    for number in range(len(recording.changes) + 1):
        now = recording.databases[number]
        withouts = [""] + [dice.choice(["Dagster", "all"])] * (
            databases_at(recording, number, "Dagster") != now
        )
        is_between = number == 0 or now != recording.databases[number - 1]
        for without in withouts[
            : 1 + is_between
        ]:  # else the last commit was there before the last change of a file
            yield Crash(number, without=without and "Dagster")
        for how, without in product(("empty", "zeros", "half", "any"), withouts):
            yield Crash(number, True, how, (), without, dice.randrange(1 << 30))
        if number:
            lost = (dice.randrange(max(0, number - 12), number),)
            for without in withouts:
                yield Crash(number, True, "any", lost, without, dice.randrange(1 << 30))


def left_by(scenario, crash):
    """The tree that a crash leaves."""
    dice = random.Random(crash.seed)
    return crashed(
        scenario.recording, crash.number, how=crash.how, lost=crash.lost, dice=dice, without=crash.without
    )


def left_state(scenario, crash):
    """A digest of what a crash leaves: crashes that leave the same end in the same way."""
    return crash.power, state_of(left_by(scenario, crash))


def replay(project, scenario, crash):
    """Lay out what a crash leaves, build, and return what is wrong then."""

    def run():
        project.lay_out(left_by(scenario, crash))
        if crash.power:
            boot_again()
        Disk(project.folder, links=scenario.links).install()
        return project.judge(scenario.expected, scenario.restored)

    return _answer_of(run)


def failures(scenario):
    """Yield number and error: each change fails once, with either error."""
    # Files are created and written, which are two changes.
    total = sum(2 if change.kind == "write" else 1 for change in scenario.recording.changes)
    yield from product(range(1, total + 1), (errno.EIO, errno.ENOSPC))


def fail(project, scenario, failure):
    """Have a change fail, once; return what is wrong with how the command ended, or with the next build.

    Returns:
        An empty text if all is well; None if the command made fewer changes.
    """

    def run():
        project.lay_out(scenario.recording.base)
        number, error = failure
        disk = Disk(project.folder, fails_at=number, error=error, links=scenario.links).install()
        said = _said_by(project, scenario)
        return disk.failed, _puzzling(said)

    return _then_built(project, scenario, run)


def reads(project, scenario):
    """Yield the number of each read of a command."""

    def run():
        project.lay_out(scenario.recording.base)
        Disk(project.folder, links=scenario.links).install()
        failing_reads.begin(project.folder)
        _said_by(project, scenario)
        return failing_reads.number()

    yield from range(1, forked(run) + 1)


def fail_read(project, scenario, number):
    """Have a read fail, once; return what is wrong, as `fail` does: a command that says nothing must have done all."""

    def run():
        project.lay_out(scenario.recording.base)
        Disk(project.folder, links=scenario.links).install()
        failing_reads.begin(project.folder, number)
        said = _said_by(project, scenario)
        failed = failing_reads.failed()
        failing_reads.begin("/nowhere")
        if said or scenario.command == "gc":
            return failed, _puzzling(said)
        found, expected = project.files_in(), scenario.expected
        if scenario.command == "restore":
            found, expected = project.files_in(OTHER), scenario.restored
        differing = differing_in(without_rests(found), expected)
        return failed, f"nothing was said, and the dataset differs in {differing}" if differing else ""

    return _then_built(project, scenario, run)


def _said_by(project, scenario):
    """Run the command; return what it says, which is a sentence if `main` makes one of it."""
    try:
        return getattr(project, scenario.command)()
    except BagAssetsError as err:
        return str(err)
    except OSError as err:
        return text_of_refusal(err) or traceback.format_exc()


def _puzzling(said):
    """Return what a command said if no user could know what to do then."""
    words = ("Traceback", "defect", "was not made for", "unexpected", "Error:")
    return said if any(word in said for word in words) else ""


def _then_built(project, scenario, run):
    def build_again():
        Disk(project.folder, links=scenario.links).install()
        return project.judge(scenario.expected, scenario.restored, leaves_rests=True)

    found = _answer_of(run)
    if isinstance(found, str):
        return found
    failed, problem = found
    if not failed or problem:
        return f"{failed}: {problem}" if failed else None
    problem = _answer_of(build_again)
    return problem and f"after {failed}: {problem}"


def _answer_of(run):
    try:
        return forked(run)
    except AssertionError as err:
        return str(err)
    except DiedError:
        return DIED


# --- histories ----------------------------------------------------------------------------------

STEPS = ("add", "change", "touch", "remove", "edit", "gc", "restore", "kill")


class Histories:
    """Histories of a project that begins with three recordings, each compared with one built from nothing."""

    def __init__(self, folder):
        self.project, self._other = Project(folder / "lived"), Project(folder / "anew")
        self._begin()
        assert _built(self.project) == ""
        self.project.keep_lock()
        self._base = take(self.project.folder, TREES)
        self._anew = {}

    def _begin(self):
        self.project.start_anew()
        there = {"a": 0, "b": 1, "c": 2}
        for name, number in there.items():
            self.project.put(name, number)
        return there

    def run(self, steps, seed=0):
        """Return what is wrong in the end."""
        project, dice, there = self.project, random.Random(f"{seed} {steps}"), self._begin()
        forked(project.lay_out, self._base)
        for number, step in enumerate(steps):
            last = max(there)
            if step in ("add", "change", "kill"):
                name = f"d{number}" if step == "add" else last
                there[name] = 3 + number
                project.put(name, there[name])
            elif step == "touch":
                project.touch(last)
            elif step == "remove" and len(there) > 1:
                project.take_away(last)
                del there[last]
            elif step == "edit":
                project.edit()
            if problem := self._end(step, dice.randrange(1, 150)):
                return f"{step}: {problem}"
        return _answer_of(lambda expected=self._built_from_nothing(there): project.judge(expected))

    def _end(self, step, dies_at):
        """Run the command that belongs to a step."""
        project = self.project

        def killed():
            Disk(project.folder, dies_at=dies_at).install()
            return project.build()

        def restored():
            return project.restore(DATASET)

        found = _answer_of({"gc": project.gc, "restore": restored, "kill": killed}.get(step, project.build))
        return "" if step == "kill" and found == DIED else found

    def _built_from_nothing(self, there):
        text = self.project.recipe_file.read_text("utf-8")
        state = (text, *sorted(there.items()))
        if state not in self._anew:
            other = self._other
            other.start_anew()
            other.recipe_file.write_text(text, "utf-8")
            for name, number in there.items():
                other.put(name, number)
            assert _built(other) == ""
            self._anew[state] = other.files_in()
        return self._anew[state]
