"""All oddities by name."""

from bagassets.sample.oddities import cameras, motion
from bagassets.sample.oddities.stream import Oddity

__all__ = ["ODDITIES"]

ODDITIES: dict[str, Oddity] = {
    **cameras.ODDITIES,
    **motion.ODDITIES,
}
