"""The spec of a server, and the stamp that shows whether a running server still matches it.

The stamp is a digest of the interpreter, the installed distributions, the source of this
package and of the modules that the server imports, the recipe and the relevant environment
variables. A client computes it from file stats in a few milliseconds, without importing
anything heavy, and the server computes it again to notice that it is outdated.
"""

import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib.machinery import PathFinder
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, Self

import bagassets
from bagassets.base.errors import BagAssetsError
from bagassets.base.fingerprints import code_fingerprint, digest_lines, recipe_fingerprint, site_folders
from bagassets.base.json_types import JsonObject

IDLE_TIMEOUT_S = 900.0
SOURCE_CHANGED = 75  # exit status of a server whose stamp was outdated before it could serve

# Read only when Python or a library is loaded, so they cannot be changed in a worker.
_STARTUP_VARIABLES = ("PYTHONHASHSEED", "PYTHONHOME", "PYTHONOPTIMIZE", "PYTHONPATH", "PYTHONUTF8",
                      "LD_LIBRARY_PATH", "LD_PRELOAD")  # fmt: skip
_STARTUP_PREFIXES = ("BLIS_", "MALLOC_", "MKL_", "OMP_", "OPENBLAS_", "OPENCV_")


class ServerSpec(NamedTuple):
    """The spec of a server.

    Attributes:
        state_folder: folder of its socket and logs.
        recipe: recipe file that the modules read, if any.
        recipes: further ones that they read, of other projects.
        modules: modules that it imports before it serves.
        paths: folders put on the module search path, for modules that are not installed.
        preload: `module:function` called with the names of the modules before the server serves; may
            return an iterator of more to prepare, which is advanced later while there is no request; once it has yielded
            True, only while no job is at work.
        environment: relevant variables, except those that the recipe's `.env` sets anyway.
        sources: files and folders of source code that the stamp covers.
        idle_timeout_s: seconds without a job or client after which the server ends.
    """

    state_folder: Path
    recipe: Path | None = None
    modules: tuple[str, ...] = ()
    paths: tuple[str, ...] = ()
    preload: str = ""
    environment: Mapping[str, str] = MappingProxyType({})
    sources: tuple[str, ...] = ()
    idle_timeout_s: float = IDLE_TIMEOUT_S
    recipes: tuple[Path, ...] = ()

    def located(self) -> Self:
        """Return it as a server for this process: its paths absolute, with the sources of the modules and this environment.

        Raises:
            BagAssetsError: a module cannot be found.
        """
        recipe = None if self.recipe is None else self.recipe.expanduser().resolve()
        sources, folders = _locate((bagassets.__name__, *self.modules), self.paths)
        return self._replace(
            state_folder=self.state_folder.expanduser().resolve(),
            recipe=recipe,
            paths=folders,
            environment=_environment(recipe),
            sources=sources,
        )

    @classmethod
    def from_json(cls, value: JsonObject) -> Self:
        """Return the spec in the JSON that starts a server."""
        recipe = value["recipe"]
        typed = {
            "state_folder": Path(value["state_folder"]),
            "recipe": None if recipe is None else Path(recipe),
            "recipes": tuple(map(Path, value["recipes"])),
            **{name: tuple(value[name]) for name in ("modules", "paths", "sources")},
        }
        return cls(**value | typed)

    def stamp(self) -> str:
        """Return the digest of everything that determines what a worker of this server does."""
        recipe = "" if self.recipe is None else recipe_fingerprint(self.recipe)
        others = [recipe_fingerprint(path) for path in self.recipes]
        asked = [list(self.modules), list(self.paths), self.preload, sorted(self.environment.items())]
        return digest_lines([code_fingerprint(self.sources), recipe, *others, repr(asked)])


def _locate(modules: tuple[str, ...], paths: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the source of each module's top package, and the folders to search for them."""
    sources: list[str] = []
    folders: list[str] = []
    for name in modules:
        top = name.partition(".")[0]
        root = _source_root(top, paths)
        if root is None:
            raise BagAssetsError(
                f"module {name}: not found by {sys.executable}; install the package that contains it, or set "
                "PYTHONPATH to its folder."
            )
        if str(root) not in sources:
            sources.append(str(root))
        if str(root.parent) not in site_folders() and str(root.parent) not in folders:
            folders.append(str(root.parent))
    return tuple(sources), tuple(folders)


@cache
def _source_root(top: str, paths: tuple[str, ...]) -> Path | None:
    """Return the folder of a package or the file of a module, without importing it."""
    loaded = getattr(sys.modules.get(top), "__file__", None)
    spec = PathFinder.find_spec(top, [*sys.path, *paths])
    origin = loaded or (spec.origin if spec is not None else None)
    if origin is None:
        return None
    file = Path(origin).resolve()
    return file.parent if file.stem == "__init__" else file


def _environment(recipe: Path | None) -> dict[str, str]:
    """Return the relevant variables; the definitions read no other but the recipe's, which is in the spec."""
    names = {name for name in os.environ if name in _STARTUP_VARIABLES or name.startswith(_STARTUP_PREFIXES)}
    if recipe is not None:
        with suppress(OSError):
            for line in recipe.with_name(".env").read_text("utf-8", "replace").splitlines():
                names.discard(line.strip().removeprefix("export ").partition("=")[0].strip())
    values = {name: _as_given(os.environ[name]) for name in sorted(names)}
    return {name: value for name, value in values.items() if value}


def _as_given(value: str) -> str:
    """Return a variable without the folders that `import cv2` adds for its subprocesses."""
    return os.pathsep.join(part for part in value.split(os.pathsep) if f"{os.sep}cv2{os.sep}" not in part)
