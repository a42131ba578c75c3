"""What a job needs of its node, found out before it works."""

import platform
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from re import match

from bagassets.defs.slurm.spool import JobSpec

__all__ = ["problem_of_node", "versions_here"]

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


def problem_of_node(spec: JobSpec, node: str) -> str | None:
    """Return why runs cannot be executed here: a folder that is missing, other versions of libraries."""
    unseen = [path for path in spec.needs if not Path(path).exists()]
    if unseen:
        return f"Node {node} does not see {', '.join(unseen)}; mount it there, under this very path."
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
