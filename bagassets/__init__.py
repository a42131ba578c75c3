"""bagassets: robot recordings in, machine-learning datasets out, built like a program.

The library below this package imports no Dagster; `bagassets.defs` and
`bagassets.definitions` put it on a Dagster asset graph.

For notebooks and training:

- `bagassets.open_dataset(path)` reads a dataset.

They are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bagassets.reader.dataset import open_dataset

__all__ = ["__version__", "open_dataset"]

__version__ = "0.1.0"

_HOMES = {"open_dataset": "bagassets.reader.dataset"}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'bagassets' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
