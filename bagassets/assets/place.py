"""Where a recording was made, and whether by day: what its GNSS fixes say, but for strays."""

from collections.abc import Mapping, Sequence
from itertools import compress

import numpy as np

from bagassets.assets.pose_outliers import trusted_fixes
from bagassets.decode.navsat import FixReading
from bagassets.geometry.sun import daylight
from bagassets.json_types import JsonObject

__all__ = ["place_of"]


def place_of(fixes: Mapping[str, Sequence[tuple[int, FixReading]]]) -> tuple[JsonObject, list[str]]:
    """Return `gnss` and `daylight` in the form of `inventory.json`, and notes about strays.

    Args:
        fixes: topic -> log time in nanoseconds and content of each fix; header stamps may not be set.
    """
    good, notes = [], []
    for topic, read in sorted(fixes.items()):
        places = np.array([(fix.lat_deg, fix.lon_deg, fix.alt_m) for _, fix in read])
        trusted = trusted_fixes(np.array([at for at, _ in read], np.int64), *places.T)
        good += list(compress(read, trusted))
        strays = len(read) - int(np.count_nonzero(trusted))
        if strays:
            notes.append(
                f"{topic}: {strays} of {len(read)} fixes {'is' if strays == 1 else 'are'} out of reach from the others, "
                "which tell place and daylight."
            )
    if not good:
        return {"gnss": None, "daylight": None}, notes
    good.sort(key=lambda item: item[0])
    first, last = good[0][1], good[-1][1]
    gnss = {"first": _fix_json(first), "last": _fix_json(last)}
    return {"gnss": gnss, "daylight": daylight(first.lat_deg, first.lon_deg, first.stamp_ns)}, notes


def _fix_json(fix: FixReading) -> JsonObject:
    alt = None if fix.alt_m != fix.alt_m else fix.alt_m
    return {"lat": fix.lat_deg, "lon": fix.lon_deg, "alt": alt, "stamp_ns": fix.stamp_ns}
