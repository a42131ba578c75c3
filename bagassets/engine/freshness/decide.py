"""Whether `bagassets build` has anything to do, decided from fingerprints alone.

A build that finds nothing to do notes the fingerprints taken before it planned, the artifacts and datasets that it
rests on, and what to print. The next one checks, in this order: the last build ran to its end, in this boot of the
machine; code, recipe and the files that it names; what its paths resolve to; other files; Dagster's records; everything
below the bag root; the datasets; the artifacts. Where there are many artifacts, a second process checks them meanwhile.
If anything differs, the build plans in full. So this can be slow, but not wrong.
"""

import json
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypedDict

from bagassets.base.cache import Cache, Changes
from bagassets.base.fingerprints import (
    PlanNeeded,
    Signature,
    boot_id,
    code_fingerprint,
    contents_fingerprint,
    digest_lines,
    files_fingerprint,
    paths_fingerprint,
    project_fingerprint,
    recipe_fingerprint,
    records_fingerprint,
    tree_lines,
)
from bagassets.engine.freshness.artifacts import SIZE, are_unchanged, each_once, folders_of, groups_to_check
from bagassets.engine.freshness.published import Publication

RECORDS, RECORDINGS = "a record", "a recording"
"""Names of the fingerprints of Dagster's records, and of what is below the bag root."""

_STATE = ".bagassets"
_WORTH_A_FORK = 1000  # artifacts
_SETTLED, _ARTIFACTS, _BUILD, _LAST = "settled", "artifacts", "build", "last"


class Places(TypedDict):
    """The files, folders and the database that a plan depends on.

    Attributes:
        recipe: the recipe file.
        written: paths as the recipe writes them, made absolute; links on the way are not followed.
        files: files that the recipe names.
        folders: folders that it names; everything in them counts.
        beside: label files of recordings, paths where they might be, and Dagster's configuration.
        bag_root: folder of the recordings.
        database: the database of Dagster's event log, an SQLite file or the URL of a PostgreSQL database.
        partitions: name of the dynamic partitions.
        artifacts: folder of the artifacts in the store.
    """

    recipe: str
    written: list[str]
    files: list[str]
    folders: list[str]
    beside: list[str]
    bag_root: str
    database: str
    partitions: str
    artifacts: str


class _Settled(TypedDict):
    """The note of a build with nothing to do.

    Attributes:
        places: what the plan depended on.
        marks: fingerprints, in the order of `fingerprints_of`.
        folders: signatures of the folders of artifacts in the store.
        published: names of the datasets.
        lines: what to print.
    """

    places: Places
    marks: list[str]
    folders: dict[str, Signature]
    published: list[str]
    lines: list[str]


# --- the command -------------------------------------------------------------------------


def nothing_to_do(arguments: list[str]) -> list[str] | None:
    """Return what to print if a build has nothing to do, or None if only a full plan can tell.

    Args:
        arguments: arguments of the command line, without the program.
    """
    asked = plain_build(arguments)
    if asked is None:
        return None
    try:
        return _decide(os.path.abspath(asked[0]))
    except (PlanNeeded, OSError):
        return None


def plain_build(arguments: list[str]) -> tuple[str, int | None] | None:
    """Return recipe and number of jobs of a plain `build`; None for another command, or one with more options."""
    recipe, jobs = "recipe.yaml", None
    rest = iter(arguments)
    if next(rest, None) != "build":
        return None
    for argument in rest:
        if argument == "--recipe":
            recipe = next(rest, "")
        elif argument.startswith("--recipe="):
            recipe = argument.removeprefix("--recipe=")
        elif argument in {"--jobs", "-j"}:
            text = next(rest, "")
            if not text.isdecimal() or int(text) == 0:
                return None
            jobs = int(text)
        else:
            return None
    return (recipe, jobs) if recipe else None


def _decide(recipe: str) -> list[str]:
    state = state_folder(recipe)
    cache = Cache(state)
    builds = BuildLog(state)
    if builds.last_boot_id() != boot_id() or builds.unfinished():
        raise PlanNeeded("the last build did not finish, or the machine was restarted")
    settled: _Settled = json.loads(cache.get(_SETTLED, "")[0])
    places = settled["places"]
    if places["recipe"] != recipe:
        raise PlanNeeded("another recipe was built last")
    project = project_fingerprint(
        code_fingerprint(), recipe_fingerprint(recipe), places["files"], places["folders"]
    )
    artifacts, root = cache.get(_ARTIFACTS, "")[0], places["artifacts"]
    total = len(artifacts) // SIZE

    def check_artifacts() -> None:
        if not are_unchanged(root, artifacts, groups_to_check(settled["folders"], folders_of(root), total)):
            raise PlanNeeded(f"{root}: an artifact has changed")

    with _checked_beside(check_artifacts, is_long=total >= _WORTH_A_FORK):
        for before, (name, now) in zip(settled["marks"], fingerprints_of(places, project), strict=True):
            if before != now:
                raise PlanNeeded(f"{name} changed")
        for dataset in settled["published"]:
            Publication(state, dataset).check()
    return settled["lines"]


@contextmanager
def _checked_beside(check: Callable[[], None], *, is_long: bool) -> Iterator[None]:
    """Check while the body runs, in a child process; afterwards if it takes less time than a fork.

    Raises:
        PlanNeeded: see `check`, or something has changed.
    """
    if not is_long:
        yield
        check()
        return
    child = os.fork()
    if child == 0:
        try:
            check()
            os._exit(0)
        finally:
            os._exit(1)
    try:
        yield
    except BaseException:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        raise
    if os.waitpid(child, 0)[1]:
        raise PlanNeeded("an artifact has changed")


def fingerprints_of(places: Places, project: str, tree: list[str] | None = None) -> Iterator[tuple[str, str]]:
    """Yield name and fingerprint of everything that a plan depends on, except store and datasets; cheap ones first.

    They are noted as they were before the plan was made: a change made during planning then differs from them, and the
    next build plans in full.

    Args:
        places: what the plan depends on.
        project: fingerprint of the code, the recipe and the files that it names.
        tree: `tree_lines` of the bag root; default: as they are.

    Raises:
        PlanNeeded: something cannot be read.
    """
    yield "the project", project
    yield "a link", paths_fingerprint(places["written"])
    yield "a file", files_fingerprint(places["beside"])
    yield RECORDS, records_fingerprint(places["database"], places["partitions"])
    yield RECORDINGS, digest_lines(tree_lines(places["bag_root"]) if tree is None else tree)


# --- the build that found nothing to do --------------------------------------------------


def note_nothing_to_do(
    state: str | os.PathLike[str],
    places: Places,
    fingerprints: list[str],
    *,
    folders: dict[str, Signature],
    made: Iterable[bytes],
    published: list[str],
    lines: list[str],
) -> None:
    """Note for the next build that there is nothing to do; if a dataset changed meanwhile, remove the note.

    Args:
        state: the state folder.
        places: what the plan depends on.
        fingerprints: of `fingerprints_of`, taken before the plan was made.
        folders: signatures of the folders of artifacts, likewise.
        made: what was noted of the artifacts that the plan rests on (`freshness.artifacts.note_of`).
        published: names of the datasets, which are up to date.
        lines: what a build with nothing to do prints.
    """
    changes = Changes()
    try:
        for dataset in published:
            Publication(state, dataset).check()
        settled = _Settled(
            places=places, marks=fingerprints, folders=folders, published=published, lines=lines
        )
        changes.put(_ARTIFACTS, "", each_once(b"".join(made)))
    except PlanNeeded:
        forget_note(state)
        return
    changes.put(_SETTLED, "", json.dumps(settled).encode())
    Cache(state).write(changes)


def forget_note(state: str | os.PathLike[str]) -> None:
    """Remove the note of an earlier build, if there is one."""
    changes = Changes()
    changes.drop(_SETTLED, "")
    changes.drop(_ARTIFACTS, "")
    Cache(state).write(changes)


# --- builds ------------------------------------------------------------------------------


class BuildLog:
    """The record of a state folder's builds: the boot in which the last one began, and those that did not finish.

    Args:
        state: the state folder.
    """

    def __init__(self, state: str | os.PathLike[str]) -> None:
        self._cache = Cache(state)

    def last_boot_id(self) -> str:
        """Return the id of the boot in which the last build began.

        Raises:
            PlanNeeded: there was no build yet, or its record is lost.
        """
        return str(self._last()[0])

    def unfinished(self) -> list[str]:
        """Return the processes of builds that are running or were killed.

        Raises:
            PlanNeeded: nothing is on record.
        """
        return list(self._cache.all(_BUILD))

    def begin(self, process: str, recipe: str | os.PathLike[str], *, over: Iterable[str] = ()) -> None:
        """Record that a build is running.

        Args:
            process: unique text for its process.
            recipe: its recipe file.
            over: processes of builds that have ended.
        """
        changes = Changes()
        for other in over:
            changes.drop(_BUILD, other)
        changes.put(_BUILD, process, b"")
        last = [boot_id(), contents_fingerprint([os.path.abspath(recipe)])]
        changes.put(_LAST, "", json.dumps(last).encode())
        self._cache.write(changes)

    def end(self, process: str) -> None:
        """Record that a build has ended."""
        changes = Changes()
        changes.drop(_BUILD, process)
        self._cache.write(changes)

    def is_last_recipe(self, recipe: str) -> bool:
        """Return whether the last build used a recipe with this very text."""
        try:
            return bool(self._last()[1] == contents_fingerprint([recipe]))
        except PlanNeeded:
            return False

    def _last(self) -> list[str]:
        last: list[str] = json.loads(self._cache.get(_LAST, "")[0])
        return last


def state_folder(recipe: str) -> str:
    """Return the state folder that a recipe names.

    YAML, which takes long to import, is parsed only if the last build in the default folder had another recipe.

    Args:
        recipe: the recipe file, absolute.

    Raises:
        PlanNeeded: the recipe cannot be parsed.
        OSError: the recipe cannot be read.
    """
    folder = os.path.dirname(recipe)
    usual = os.path.join(folder, _STATE)
    return usual if BuildLog(usual).is_last_recipe(recipe) else os.path.join(folder, _named_state(recipe))


def _named_state(recipe: str) -> str:
    """Return the field `state` of a recipe.

    Nodes are not composed: what is nested too deeply would overflow the stack of the parser.
    """
    import yaml

    depth, nodes = 0, []  # the root, then keys and values by turns
    try:
        with open(recipe, "rb") as stream:
            for event in yaml.parse(stream, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
                if isinstance(event, yaml.CollectionEndEvent):
                    depth -= 1
                elif isinstance(event, yaml.NodeEvent):
                    nodes += [event] if depth < 2 else []
                    depth += isinstance(event, yaml.CollectionStartEvent)
        entries = list(zip(nodes[1::2], nodes[2::2], strict=True))
    except (yaml.YAMLError, ValueError) as err:
        raise PlanNeeded(f"{recipe}: {err}") from err
    if not isinstance(next(iter(nodes), None), yaml.MappingStartEvent):
        raise PlanNeeded(f"{recipe}: not a mapping")
    if not all(isinstance(key, yaml.ScalarEvent) for key, _ in entries):
        raise PlanNeeded(f"{recipe}: a key is not text")
    values = [value for key, value in entries if isinstance(key, yaml.ScalarEvent) and key.value == "state"]
    paths = [one.value for one in values if isinstance(one, yaml.ScalarEvent) and "\0" not in one.value]
    if len(paths) < len(values):
        raise PlanNeeded(f"{recipe}: state is not a path")
    return str(paths[0]) if paths else _STATE
