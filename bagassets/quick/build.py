"""`bagassets build` with nothing to do."""

import os

from bagassets.quick import snapshot
from bagassets.quick.looks import Doubt

__all__ = ["code_stamp", "nothing_to_do", "state_folder"]

_STATE = ".bagassets"
_PLAIN = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._/+-")


def nothing_to_do(arguments: list[str]) -> list[str] | None:
    """Return what to print if a build has nothing to do, or None if that is in doubt.

    Args:
        arguments: of the command line, without the program.
    """
    recipe = _recipe_of(arguments)
    if recipe is None:
        return None
    try:
        return _decide(os.path.abspath(recipe))  # noqa: PTH100  (no pathlib here: its import costs 5 ms)
    except (Doubt, KeyError, TypeError, ValueError, OSError):
        return None


def code_stamp(recipe: str) -> str:
    """Return the digest of interpreter, installed packages, our code, and the texts of recipe and `.env`.

    The environment does not count: no result depends on it.
    """
    from dataclasses import replace  # noqa: PLC0415  (only once there is a snapshot to compare with)
    from pathlib import Path  # noqa: PLC0415

    from bagassets.forkserver.spec import ServerSpec  # noqa: PLC0415

    spec = ServerSpec.of(Path(), Path(recipe), modules=("bagassets.definitions",))
    return replace(spec, environment={}, paths=(), recipe=Path(recipe)).stamp()


def _decide(recipe: str) -> list[str]:
    header, digests = snapshot.load(state_folder(recipe))
    if header["places"]["recipe"] != recipe:
        raise Doubt("the snapshot is of another recipe")
    snapshot.check(header, digests, snapshot.look_before(code_stamp(recipe), header["places"]))
    return header["lines"]


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


def state_folder(recipe: str) -> str:
    """Return the state folder that a recipe names, read without a YAML parser.

    Raises:
        Doubt: it is not written in the plainest way.
    """
    folder = os.path.dirname(recipe)  # noqa: PTH120
    state = _STATE
    with open(recipe, encoding="utf-8") as stream:  # noqa: PTH123
        for line in stream:
            if line.startswith("state"):
                name, _, value = line.partition(":")
                state = value.strip()
                if name != "state" or not state or not _PLAIN.issuperset(state):
                    raise Doubt("the state folder is not written plainly")
    return os.path.join(folder, state)  # noqa: PTH118
