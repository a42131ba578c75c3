"""Decoders that installed packages add: which there are, without importing any of them.

A package announces a decoder as an entry point of the group `bagassets.decoders`, named
`<family>.<package>.<Type>`, as in `image.acme_msgs.Frame`. Names and versions are read from the
metadata of the installed distributions, so that planning never imports foreign code. In
`bagassets.decode.registry` they stand beside the decoders that bagassets has itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

from bagassets.extensions import DECODERS, announced

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
        family: what it makes of a message.
        msgtype: the type it decodes, `pkg/msg/Type`.
        distribution: name of the distribution.
        version: its version; a new one re-runs the actions that use the decoder, and no others.
        reference: where the decoder is, `module:object`.
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
        """Return what the key of an action that uses the decoder says of it."""
        return {"distribution": self.distribution, "version": self.version, "object": self.reference}

    def __str__(self) -> str:
        return f"decoder {self.name} of {self.distribution} {self.version}"


@dataclass(frozen=True)
class InstalledDecoders:
    """The decoder plug-ins of this Python environment.

    Attributes:
        plugins: all that are named properly, in order of name and distribution.
        unusable: a sentence for each that is not.
    """

    plugins: Sequence[DecoderPlugin]
    unusable: Sequence[str]

    def of_family(self, family: Family) -> list[DecoderPlugin]:
        """Return the plug-ins of one family."""
        return [plugin for plugin in self.plugins if plugin.family == family]


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
                f"Entry point {entry.name!r} of {owner} is no decoder: it must be named <family>.<package>.<Type>, "
                f"its family one of {', '.join(FAMILIES)}."
            )
            continue
        msgtype = f"{parts[1]}/msg/{parts[2]}"
        plugins.append(DecoderPlugin(family, msgtype, entry.dist.name, entry.dist.version, entry.value))
    plugins.sort(key=lambda plugin: (plugin.name, plugin.distribution))
    return InstalledDecoders(tuple(plugins), tuple(sorted(unusable)))
