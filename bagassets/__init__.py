"""bagassets: robot recordings in, machine-learning datasets out, built like a program.

The library below this package imports no Dagster; `bagassets.defs` and
`bagassets.definitions` put it on a Dagster asset graph.

For notebooks and training:

- `bagassets.build(recipe)` brings the datasets of a recipe up to date and returns a `Report`;
- `bagassets.open_dataset(path)` reads a dataset.

`bagassets.RecordingDatasets` is a Dagster component: a project as YAML, in a code location that has others.

They are imported when they are first used.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from importlib.abc import Loader

    from bagassets.defs.graph.component import RecordingDatasets
    from bagassets.formats.reader.dataset import open_dataset
    from bagassets.notebook import Report, build

__all__ = ["RecordingDatasets", "Report", "__version__", "build", "open_dataset"]

__version__ = "0.2.0.dev0"

_HOMES = {
    "RecordingDatasets": "bagassets.defs.graph.component",
    "Report": "bagassets.notebook",
    "build": "bagassets.notebook",
    "open_dataset": "bagassets.formats.reader.dataset",
}

# Former names of modules and packages, which `dagster.yaml`, units of systemd and users' code have -> names.
_MOVED = {
    "bagassets.defs.launcher": "bagassets.defs.launchers.launcher",
    "bagassets.defs.services": "bagassets.defs.ui.services",
    "bagassets.defs.slurm": "bagassets.defs.launchers.slurm",
    "bagassets.defs.sqlite_storage": "bagassets.defs.records.sqlite_storage",
    "bagassets.errors": "bagassets.base.errors",
    "bagassets.quality": "bagassets.assets.quality",
    "bagassets.reader": "bagassets.formats.reader",
    "bagassets.splits": "bagassets.engine.splits",
}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'bagassets' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})


class _Moved:
    """Finds what has moved by its former name, too: the same module, no copy.

    A finder and loader as of `importlib.abc`, which is not imported at run time: it costs the shortest build two milliseconds.
    """

    def find_spec(
        self, name: str, _path: Sequence[str] | None = None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return ModuleSpec(name, cast("Loader", self)) if _name_now(name) != name else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module itself: with another one in its place, a thread could not find what is in a package."""
        module = import_module(_name_now(spec.name))
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module back what Python has replaced by the spec of the former name."""
        if module.__spec__ is not None and module.__spec__.loader_state is not None:
            module.__spec__ = module.__spec__.loader_state


def _name_now(name: str) -> str:
    for former, now in _MOVED.items():
        if name == former or name.startswith(f"{former}."):
            return now + name[len(former) :]
    return name


sys.meta_path.insert(0, _Moved())
