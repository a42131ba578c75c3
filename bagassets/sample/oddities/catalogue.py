"""All oddities by name."""

from bagassets.sample.oddities import cameras, radars
from bagassets.sample.oddities.stream import Oddity

__all__ = ["ODDITIES"]

ODDITIES: dict[str, Oddity] = {
    **cameras.ODDITIES,
    **radars.ODDITIES,
}
