"""Whether `bagassets build` has anything to do, decided from marks alone.

A build that finds nothing to do leaves what it decided from: the marks taken before it looked, the artifacts and
datasets that it rests on, and what to print. The next one compares, in this order: the last build got to its end, in
this boot of the machine; code, recipe and the files that it names; where its paths lead; other files; Dagster's records;
everything below the bag root; the datasets; the artifacts. Whatever differs is a doubt, and a doubt takes the full
path, which decides anew. So this can be slow, but not wrong.
"""

import json
import os
from collections.abc import Iterable, Iterator
from typing import TypedDict

from bagassets.freshness.artifacts import Group, check_groups, groups_of, packed
from bagassets.freshness.cache import Cache, Changes
from bagassets.freshness.marks import (
    Doubt,
    boot,
    code_mark,
    files_mark,
    places_mark,
    project_mark,
    recipe_mark,
    records_mark,
    texts_mark,
    tree_mark,
)
from bagassets.freshness.published import Publication

__all__ = ["Builds", "Places", "forget", "leave", "look", "nothing_to_do", "state_folder"]

_STATE = ".bagassets"
_SETTLED, _ARTIFACTS, _BUILD, _LAST = "settled", "artifacts", "build", "last"


class Places(TypedDict):
    """Where to look.

    Attributes:
        recipe: the recipe file.
        written: paths as the recipe writes them, made absolute; links on the way are not followed.
        files: files that the recipe names.
        folders: folders that it names, for all that is in them.
        beside: label files of recordings, places where they might be, and Dagster's configuration.
        bag_root: folder of the recordings.
        database: the database of Dagster's event log, a file of SQLite or a URL of PostgreSQL.
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
    """What a build with nothing to do left: marks in order, groups of artifacts, names of datasets, lines to print."""

    places: Places
    marks: list[str]
    groups: list[Group]
    published: list[str]
    lines: list[str]


# --- the command -------------------------------------------------------------------------


def nothing_to_do(arguments: list[str]) -> list[str] | None:
    """Return what to print if a build has nothing to do, or None if that is in doubt.

    Args:
        arguments: of the command line, without the program.
    """
    recipe = _recipe_of(arguments)
    if recipe is None:
        return None
    try:
        return _decide(os.path.abspath(recipe))
    except (Doubt, OSError):
        return None


def _recipe_of(arguments: list[str]) -> str | None:
    """Return the recipe of a plain `build`; None for another command, or one with more options."""
    recipe = "recipe.yaml"
    rest = iter(arguments)
    if next(rest, None) != "build":
        return None
    for argument in rest:
        if argument == "--recipe":
            recipe = next(rest, "")
        elif argument.startswith("--recipe="):
            recipe = argument.removeprefix("--recipe=")
        elif argument in {"--jobs", "-j"}:
            if not next(rest, "").isdecimal():
                return None
        else:
            return None
    return recipe or None


def _decide(recipe: str) -> list[str]:
    state = state_folder(recipe)
    cache = Cache(state)
    builds = Builds(state)
    if builds.last_boot() != boot() or builds.unfinished():
        raise Doubt("the last build did not get to its end, or the machine was started anew")
    settled: _Settled = json.loads(cache.get(_SETTLED, "")[0])
    places = settled["places"]
    if places["recipe"] != recipe:
        raise Doubt("another recipe was built last")
    project = project_mark(code_mark(), recipe_mark(recipe), places["files"], places["folders"])
    for before, (name, mark) in zip(settled["marks"], _marks(places, project), strict=True):
        if before != mark:
            raise Doubt(f"{name} changed")
    for dataset in settled["published"]:
        Publication(state, dataset).check()
    check_groups(places["artifacts"], cache.get(_ARTIFACTS, "")[0], settled["groups"])
    return settled["lines"]


def _marks(places: Places, project: str) -> Iterator[tuple[str, str]]:
    """Yield name and mark of everything that a plan is decided from, but store and datasets; the cheap ones first.

    Raises:
        Doubt: something cannot be seen.
    """
    yield "the project", project
    yield "a link", places_mark(places["written"])
    yield "a file", files_mark(places["beside"])
    yield "a record", records_mark(places["database"], places["partitions"])
    yield "a recording", tree_mark(places["bag_root"])


# --- the build that found nothing to do --------------------------------------------------


def look(places: Places, project: str) -> list[str]:
    """Return the marks of everything that a plan is decided from; to be taken before it is made.

    What changes while the plan is made then differs from them, and the next build looks closer.

    Args:
        places: where to look.
        project: mark of code, recipe and the files that it names.

    Raises:
        Doubt: something cannot be seen.
    """
    return [mark for _, mark in _marks(places, project)]


def leave(
    state: str | os.PathLike[str],
    places: Places,
    marks: list[str],
    *,
    artifacts: Iterable[str],
    published: list[str],
    lines: list[str],
) -> None:
    """Leave a note for the next build that there is nothing to do; where that cannot be, leave none.

    Args:
        state: the state folder.
        places: where `look` looked.
        marks: what it saw before the plan was made.
        artifacts: digests of the artifacts that the plan rests on.
        published: datasets that are as they should be.
        lines: what a build with nothing to do prints.
    """
    digests = packed(sorted(artifacts))
    changes = Changes()
    try:
        for dataset in published:
            Publication(state, dataset).check()
        settled = _Settled(
            places=places,
            marks=marks,
            groups=groups_of(places["artifacts"], digests),
            published=published,
            lines=lines,
        )
    except Doubt:
        forget(state)
        return
    changes.put(_SETTLED, "", json.dumps(settled).encode())
    changes.put(_ARTIFACTS, "", digests)
    Cache(state).write(changes)


def forget(state: str | os.PathLike[str]) -> None:
    """Leave no note, and remove one that is there."""
    changes = Changes()
    changes.drop(_SETTLED, "")
    changes.drop(_ARTIFACTS, "")
    Cache(state).write(changes)


# --- builds ------------------------------------------------------------------------------


class Builds:
    """What is on record of the builds of a state folder: the boot that the last one began in, and those without an end.

    Args:
        state: the state folder.
    """

    def __init__(self, state: str | os.PathLike[str]) -> None:
        self._cache = Cache(state)

    def last_boot(self) -> str:
        """Return the boot of the machine that the last build began in.

        Raises:
            Doubt: there was none yet, or its note is lost.
        """
        return str(self._last()[0])

    def unfinished(self) -> list[str]:
        """Return the processes of builds that are at work, or were killed.

        Raises:
            Doubt: nothing is on record.
        """
        return list(self._cache.all(_BUILD))

    def begin(self, process: str, recipe: str | os.PathLike[str], *, over: Iterable[str] = ()) -> None:
        """Note that a build is at work.

        Args:
            process: what tells its process from all others.
            recipe: its recipe file.
            over: processes of builds that are not at work any more.
        """
        changes = Changes()
        for other in over:
            changes.drop(_BUILD, other)
        changes.put(_BUILD, process, b"")
        changes.put(_LAST, "", json.dumps([boot(), texts_mark([os.path.abspath(recipe)])]).encode())
        self._cache.write(changes)

    def end(self, process: str) -> None:
        """Note that a build is over."""
        changes = Changes()
        changes.drop(_BUILD, process)
        self._cache.write(changes)

    def knows(self, recipe: str) -> bool:
        """Tell whether the last build was of just this recipe file with just this text."""
        try:
            return bool(self._last()[1] == texts_mark([recipe]))
        except Doubt:
            return False

    def _last(self) -> list[str]:
        last: list[str] = json.loads(self._cache.get(_LAST, "")[0])
        return last


def state_folder(recipe: str) -> str:
    """Return the state folder that a recipe names; YAML, which takes long to import, is only read where it is another one.

    Args:
        recipe: the recipe file, absolute.

    Raises:
        Doubt: the recipe does not say.
        OSError: the recipe cannot be read.
    """
    folder = os.path.dirname(recipe)
    usual = os.path.join(folder, _STATE)
    return usual if Builds(usual).knows(recipe) else os.path.join(folder, _named_state(recipe))


def _named_state(recipe: str) -> str:
    """Return the field `state` of a recipe."""
    import yaml

    with open(recipe, "rb") as stream:
        try:
            root = yaml.compose(stream, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        except (yaml.YAMLError, ValueError) as err:
            raise Doubt(f"{recipe}: {err}") from err
    if not isinstance(root, yaml.MappingNode):
        raise Doubt(f"{recipe}: no mapping")
    values = [value for key, value in root.value if key.value == "state"]
    if not all(isinstance(value, yaml.ScalarNode) for value in values):
        raise Doubt(f"{recipe}: its state is no text")
    return str(values[0].value) if values else _STATE
