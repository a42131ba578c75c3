"""All oddities by name."""

from bagassets.sample.oddities import cameras, robots, transforms
from bagassets.sample.oddities import cameras, lidars
from bagassets.sample.oddities.stream import Oddity

__all__ = ["ODDITIES"]

ODDITIES: dict[str, Oddity] = {
    **cameras.ODDITIES,
    **robots.ODDITIES,
    **transforms.ODDITIES,
    **lidars.ODDITIES,
}
