"""Formats and assets that installed packages add: entry points, found without importing anything.

A package announces a dataset format in the group `bagassets.formats`, and an asset of recordings in the group
`bagassets.assets`; the entry point has the name of the format or asset. Names and versions are read from the
metadata of installed distributions.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from bagassets.base.errors import PluginError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = ["ASSETS", "DECODERS", "FORMATS", "Extension", "announced", "installed_extensions"]

ASSETS, DECODERS, FORMATS = "bagassets.assets", "bagassets.decoders", "bagassets.formats"


@dataclass(frozen=True, slots=True)
class Extension:
    """An entry point of an installed distribution.

    Attributes:
        name: name of the entry point.
        package: name of the distribution.
        version: version of the distribution.
        reference: the object, as `module:object`.
    """

    name: str
    package: str
    version: str
    reference: str

    @property
    def distribution(self) -> str:
        """Name and version of the distribution."""
        return f"{self.package} {self.version}"

    def load(self) -> object:
        """Return the object.

        Raises:
            PluginError: it cannot be imported; the message names the package.
        """
        module, _, path = self.reference.partition(":")
        try:
            loaded: object = import_module(module)
            for part in path.split(".") if path else ():
                loaded = getattr(loaded, part)
        except (Exception, SystemExit) as err:
            what = f"{type(err).__name__}: {err}" if str(err) else type(err).__name__
            raise self.problem(f"importing {self.reference} raised {what}") from err
        return loaded

    def problem(self, what: str) -> PluginError:
        """Return an error that says why the object cannot be used."""
        return PluginError(
            f"{self.name} of {self.distribution} cannot be used: {what}; fix, upgrade or uninstall that package."
        )


@cache
def announced() -> "Mapping[str, tuple[EntryPoint, ...]]":
    """Return group -> entry points of the packages that were installed at the first call.

    Finding those of one group takes as long as finding all.
    """
    from importlib.metadata import entry_points  # noqa: PLC0415  (50 ms, which `--help` should not pay)

    found = entry_points()
    return {group: tuple(found.select(group=group)) for group in (ASSETS, DECODERS, FORMATS)}


@cache
def installed_extensions(group: str) -> tuple[Extension, ...]:
    """Return the entry points in a group, by name, of the packages that were installed at the first call."""
    extensions = [
        Extension(entry.name, entry.dist.name, entry.dist.version, entry.value)
        for entry in announced()[group]
        if entry.dist is not None
    ]
    return tuple(sorted(extensions, key=lambda extension: (extension.name, extension.distribution)))
