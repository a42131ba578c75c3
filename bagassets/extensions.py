"""What installed packages add to bagassets: entry points, found without importing anything, and loaded with care.

A package announces a dataset format in the group `bagassets.formats`, and an asset of recordings in the group
`bagassets.assets`; the name of the entry point is that of the format or asset. Names and versions are read from the
metadata of installed distributions.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from bagassets.errors import PluginError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = ["ASSETS", "DECODERS", "FORMATS", "Extension", "announced", "installed_extensions"]

ASSETS, DECODERS, FORMATS = "bagassets.assets", "bagassets.decoders", "bagassets.formats"


@dataclass(frozen=True, slots=True)
class Extension:
    """Something that an installed distribution announces.

    Attributes:
        name: of the entry point.
        package: name of the distribution.
        version: its version.
        reference: where the object is, `module:object`.
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
            PluginError: it cannot be imported; the text names the package.
        """
        module, _, path = self.reference.partition(":")
        try:
            found: object = import_module(module)
            for part in path.split(".") if path else ():
                found = getattr(found, part)
        except (Exception, SystemExit) as err:
            what = f"{type(err).__name__}: {err}" if str(err) else type(err).__name__
            raise self.problem(f"importing {self.reference} raised {what}") from err
        return found

    def problem(self, what: str) -> PluginError:
        """Return an error that says why this cannot be used."""
        return PluginError(
            f"{self.name} of {self.distribution} cannot be used: {what}; mend, upgrade or uninstall that package."
        )


@cache
def announced() -> "Mapping[str, tuple[EntryPoint, ...]]":
    """Return group -> the entry points of packages that were installed when this process first asked.

    To look for those of one group takes as long as for all.
    """
    from importlib.metadata import entry_points  # noqa: PLC0415  (50 ms, which `--help` should not pay)

    found = entry_points()
    return {group: tuple(found.select(group=group)) for group in (ASSETS, DECODERS, FORMATS)}


@cache
def installed_extensions(group: str) -> tuple[Extension, ...]:
    """Return what packages that were installed when this process first asked announce in a group, by name."""
    found = [
        Extension(entry.name, entry.dist.name, entry.dist.version, entry.value)
        for entry in announced()[group]
        if entry.dist is not None
    ]
    return tuple(sorted(found, key=lambda extension: (extension.name, extension.distribution)))
