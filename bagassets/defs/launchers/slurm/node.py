"""What a job needs of its node, found out before it works."""

import platform
import sys
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from re import match

from bagassets.base.errors import RecordingError
from bagassets.defs.launchers.slurm.spool import JobSpec
from bagassets.recordings.discover import find_one
from bagassets.store.identity import id_of_store

_OURS = "bagassets"


@cache
def versions_here() -> dict[str, str]:
    """Return the version of Python, of this package, and of all that it requires."""
    found = {"Python": ".".join(platform.python_version_tuple()[:2]), _OURS: version(_OURS)}
    for requirement in requires(_OURS) or ():
        name = match(r"[A-Za-z0-9._-]+", requirement)
        if name is None or "extra ==" in requirement:
            continue
        try:
            found[name[0]] = version(name[0])
        except PackageNotFoundError:
            continue  # for another system
    return found


def problem_of_node(spec: JobSpec, node: str, sizes: Iterable[tuple[str, int]]) -> str | None:
    """Return why runs cannot be executed here: a folder that is missing or another one, other versions of libraries.

    Args:
        spec: what the runs need.
        node: name of this node.
        sizes: path and bytes of their recordings.
    """
    unseen = [path for path in spec.needs if not Path(path).exists()]
    if unseen:
        return f"Node {node} does not see {', '.join(unseen)}; mount it there, under this very path."
    # A folder on which nothing is mounted is there, too.
    for root, wanted in spec.stores.items():
        found = id_of_store(Path(root))
        if found != wanted:
            what = "nothing of the store" if found is None else "another store"
            return f"Node {node} sees {what} in {root}; mount it there, under this very path."
    if (problem := _problem_of_recordings(sizes)) is not None:
        return (
            f"Node {node} {problem}; mount the folder of recordings there, under this very path. If this recording has changed "
            "since the run was launched, build again."
        )
    here = versions_here()
    other = [
        f"{name} {here.get(name, 'not at all')} instead of {wanted}"
        for name, wanted in spec.versions.items()
        if here.get(name) != wanted
    ]
    if other:
        return (
            f"Node {node} has other versions of libraries, which may give other bytes: {', '.join(other)}; install there "
            f"({sys.executable}) what is installed on the machine that submits."
        )
    return None


def _problem_of_recordings(sizes: Iterable[tuple[str, int]]) -> str | None:
    """Return how the first recording differs, if none is as it should be: a single one may have changed meanwhile."""
    problem = None
    for path, size in sizes:
        try:
            seen = find_one(Path(path)).size
        except RecordingError:
            problem = problem or f"does not see {path}"
            continue
        if seen == size:
            return None
        problem = problem or f"sees {path} with {seen} bytes instead of {size}"
    return problem
