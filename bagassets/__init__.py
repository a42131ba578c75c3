"""bagassets: robot recordings in, machine-learning datasets out, built like a program.

The library below this package imports no Dagster; `bagassets.defs` and
`bagassets.definitions` put it on a Dagster asset graph.

For notebooks and training:

- `bagassets.build(recipe)` brings the datasets of a recipe up to date and returns a `Report`;
- `bagassets.open_dataset(path)` reads a dataset.

`bagassets.RecordingDatasets` is a Dagster component: a project as YAML, in a code location that has others.

They are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bagassets.defs.component import RecordingDatasets
    from bagassets.notebook import Report, build
    from bagassets.reader.dataset import open_dataset

__all__ = ["RecordingDatasets", "Report", "__version__", "build", "open_dataset"]

__version__ = "0.2.0.dev0"

# `build` is the package of that name, which can be called.
_HOMES = {
    "RecordingDatasets": "bagassets.defs.component",
    "Report": "bagassets.notebook",
    "open_dataset": "bagassets.reader.dataset",
}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name == "build":
        return import_module("bagassets.build")
    raise AttributeError(f"module 'bagassets' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, "build"})
