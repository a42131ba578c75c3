"""Decoders that installed packages add: which there are, without importing any of them.

A package announces a decoder as an entry point of the group `bagassets.decoders`, named
`<family>.<package>.<Type>`, as in `image.acme_msgs.Frame`. Names and versions are read from the
metadata of the installed distributions, so that planning never imports foreign code;
`bagassets.decode.registry` loads a decoder when its first message comes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

from bagassets.errors import PluginError

__all__ = [
    "BUILT_IN",
    "FAMILIES",
    "GROUP",
    "DecoderPlugin",
    "Family",
    "InstalledDecoders",
    "installed_decoders",
]

GROUP = "bagassets.decoders"

Family = Literal["image", "cloud", "radar", "pose", "boxes"]
FAMILIES: tuple[Family, ...] = get_args(Family)

# Types that this package decodes itself; a plug-in for one of them would make results ambiguous.
# Any other type is open, also those of Velodyne packets and radar lists, which are told by structure.
BUILT_IN: Mapping[Family, frozenset[str]] = {
    "image": frozenset({"sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"}),
    "cloud": frozenset({"sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"}),
    "radar": frozenset({"sensor_msgs/msg/PointCloud2"}),
    "pose": frozenset(
        {
            "geometry_msgs/msg/PoseStamped",
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            "nav_msgs/msg/Odometry",
        }
    ),
    "boxes": frozenset(
        {
            "autoware_auto_perception_msgs/msg/DetectedObjects",
            "autoware_auto_perception_msgs/msg/TrackedObjects",
            "autoware_perception_msgs/msg/DetectedObjects",
            "autoware_perception_msgs/msg/TrackedObjects",
            "derived_object_msgs/msg/ObjectArray",
            "jsk_recognition_msgs/msg/BoundingBoxArray",
            "vision_msgs/msg/Detection3DArray",
            "visualization_msgs/msg/Marker",
            "visualization_msgs/msg/MarkerArray",
        }
    ),
}


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

    def find(self, family: Family, msgtype: str) -> DecoderPlugin | None:
        """Return the plug-in that decodes a type, or None if there is none.

        Raises:
            PluginError: there are several, or the type is decoded without a plug-in already.
        """
        found = [plugin for plugin in self.plugins if (plugin.family, plugin.msgtype) == (family, msgtype)]
        if not found:
            return None
        claims = [f"{plugin.distribution} {plugin.version}" for plugin in found]
        if msgtype in BUILT_IN[family]:
            raise PluginError(
                f"{msgtype}: {' and '.join(claims)} would replace the decoder that bagassets has for it; uninstall it, "
                "or let it decode a type of its own."
            )
        if len(found) > 1:
            raise PluginError(
                f"{msgtype}: decoders from {' and '.join(claims)} claim it ({found[0].name}); uninstall all but one."
            )
        return found[0]

    def of_family(self, family: Family) -> list[DecoderPlugin]:
        """Return the plug-ins of one family."""
        return [plugin for plugin in self.plugins if plugin.family == family]

    def families(self, msgtype: str) -> list[Family]:
        """Return what plug-ins make of a type; mostly nothing, or one thing."""
        return sorted({plugin.family for plugin in self.plugins if plugin.msgtype == msgtype})

    def advice(self, family: Family, msgtype: str) -> str:
        """Return what to do about a type that nothing decodes, to end a sentence with."""
        package, _, kind = msgtype.partition("/msg/")
        text = f"correct the topic in the recipe, or install a decoder plug-in ({family}.{package}.{kind})"
        return f"{text}. {' '.join(self.unusable)}" if self.unusable else f"{text}."


@cache
def installed_decoders() -> InstalledDecoders:
    """Return the decoder plug-ins that were installed when this process first asked."""
    from importlib.metadata import entry_points  # noqa: PLC0415  (50 ms, which `--help` should not pay)

    plugins, unusable = [], []
    for entry in entry_points(group=GROUP):
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
