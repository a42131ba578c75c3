"""All oddities by name."""

from bagassets.sample.oddities import cameras, lidars, motion, radars, robots
from bagassets.sample.oddities.stream import Oddity

__all__ = ["ODDITIES"]

ODDITIES: dict[str, Oddity] = {
    **cameras.ODDITIES,
    **lidars.ODDITIES,
    **motion.ODDITIES,
    **radars.ODDITIES,
    **robots.ODDITIES,
}
