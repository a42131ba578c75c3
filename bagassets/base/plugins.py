"""What installed packages add: entry points, listed without importing any of them, so that planning never imports foreign code.

A package announces a dataset format in the group `bagassets.formats`, and an asset of recordings in the group
`bagassets.assets`; the entry point has the name of the format or asset. A decoder, in the group `bagassets.decoders`, is
named `<family>.<package>.<Type>`, as in `image.acme_msgs.Frame`; `bagassets.decode.registry` combines them with the
built-in ones. Names and versions are read from the metadata of the installed distributions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Literal, get_args

from bagassets.base.errors import PluginError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

ASSETS, DECODERS, FORMATS = "bagassets.assets", "bagassets.decoders", "bagassets.formats"

Family = Literal["image", "cloud", "radar", "pose", "boxes"]
FAMILIES: tuple[Family, ...] = get_args(Family)


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


@dataclass(frozen=True, slots=True)
class DecoderPlugin(Extension):
    """A decoder that an installed distribution announces; a new version of that re-runs the actions that use it, and no others.

    Attributes:
        family: the kind of reading that it returns.
    """

    family: Family

    @property
    def msgtype(self) -> str:
        """The message type that it decodes, `pkg/msg/Type`."""
        _, package, kind = self.name.split(".")
        return f"{package}/msg/{kind}"

    def as_json(self) -> dict[str, str]:
        """Return the entry for the decoder in actions that use it."""
        return {"distribution": self.package, "version": self.version, "object": self.reference}

    def __str__(self) -> str:
        return f"decoder {self.name} of {self.distribution}"


@dataclass(frozen=True)
class InstalledDecoders:
    """The decoder plug-ins of this Python environment.

    Attributes:
        plugins: all plug-ins with a valid name, in order of name and distribution.
        unusable: a sentence for each entry point with an invalid name.
    """

    plugins: Sequence[DecoderPlugin]
    unusable: Sequence[str]


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


@cache
def installed_decoders() -> InstalledDecoders:
    """Return the decoder plug-ins that were installed when this process first asked."""
    plugins, unusable = [], []
    for entry in announced()[DECODERS]:
        owner = "an unnamed distribution" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"
        family = next((name for name in FAMILIES if entry.name.startswith(f"{name}.")), None)
        parts = entry.name.split(".")
        if family is None or len(parts) != 3 or not all(parts) or entry.dist is None:
            unusable.append(
                f"Entry point {entry.name!r} of {owner} is not a decoder: it must be named <family>.<package>.<Type>, "
                f"with one of the families {', '.join(FAMILIES)}."
            )
            continue
        plugins.append(DecoderPlugin(entry.name, entry.dist.name, entry.dist.version, entry.value, family))
    plugins.sort(key=lambda plugin: (plugin.name, plugin.package))
    return InstalledDecoders(tuple(plugins), tuple(sorted(unusable)))
