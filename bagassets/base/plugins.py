"""Decoders that installed packages add, listed without importing any of them.

A package announces a decoder as an entry point of the group `bagassets.decoders`, named
`<family>.<package>.<Type>`, as in `image.acme_msgs.Frame`. Names and versions are read from the
metadata of the installed distributions, so that planning never imports foreign code.
`bagassets.decode.registry` combines them with the built-in decoders.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

from bagassets.base.extensions import DECODERS, announced

__all__ = [
    "FAMILIES",
    "DecoderPlugin",
    "Family",
    "InstalledDecoders",
    "installed_decoders",
]

Family = Literal["image", "cloud", "radar", "pose", "boxes"]
FAMILIES: tuple[Family, ...] = get_args(Family)


@dataclass(frozen=True, slots=True)
class DecoderPlugin:
    """A decoder that an installed distribution announces.

    Attributes:
        family: the kind of reading that it returns.
        msgtype: the message type that it decodes, `pkg/msg/Type`.
        distribution: name of the distribution.
        version: its version; a new one re-runs the actions that use the decoder, and no others.
        reference: the decoder, as `module:object`.
    """

    family: Family
    msgtype: str
    distribution: str
    version: str
    reference: str

    @property
    def name(self) -> str:
        """Name of the entry point."""
        package, _, kind = self.msgtype.partition("/msg/")
        return f"{self.family}.{package}.{kind}"

    def as_json(self) -> dict[str, str]:
        """Return the entry for the decoder in actions that use it."""
        return {"distribution": self.distribution, "version": self.version, "object": self.reference}

    def __str__(self) -> str:
        return f"decoder {self.name} of {self.distribution} {self.version}"


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
        msgtype = f"{parts[1]}/msg/{parts[2]}"
        plugins.append(DecoderPlugin(family, msgtype, entry.dist.name, entry.dist.version, entry.value))
    plugins.sort(key=lambda plugin: (plugin.name, plugin.distribution))
    return InstalledDecoders(tuple(plugins), tuple(sorted(unusable)))
