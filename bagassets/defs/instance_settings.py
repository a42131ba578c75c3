"""The settings of a Dagster instance: `dagster.yaml` in its home folder."""

import shlex
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from bagassets.defs.dagster_private import InstanceRef
from bagassets.errors import BagAssetsError

__all__ = ["read_settings"]


def read_settings(home: Path) -> InstanceRef:
    """Return the settings in a Dagster home folder; they are parsed again only if the text of the file has changed.

    Raises:
        BagAssetsError: they name modules of another version of bagassets.
    """
    config = home / "dagster.yaml"
    return _settings(str(home), config.read_bytes() if config.is_file() else b"")


@lru_cache(maxsize=8)
def _settings(home: str, _text: bytes) -> InstanceRef:
    settings = InstanceRef.from_dir(home)
    named = {str(getattr(part, "module_name", "")) for part in settings}
    for module in sorted(name for name in named if name.startswith("bagassets.") and not _exists(name)):
        raise BagAssetsError(
            f"{home}/dagster.yaml: there is no {module} in this version of bagassets, so another one wrote the file; use that, "
            f"or have this one write it anew: `bagassets init {shlex.quote(home)}`. Recipe and records stay."
        )
    return settings


def _exists(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # nor its package
        return False
