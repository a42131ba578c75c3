"""Times of the points of a cloud, in the various fields and units of drivers.

The field is found by name. Its unit and its zero follow from its type and values:

* **integers** count nanoseconds, or microseconds if the name ends in `us`. As time since the
  header stamp: `t` of Ouster (uint32 ns), `offset_time` of Livox (uint32 ns), `time_stamp` of
  Nebula (uint32 ns). Numbers so large that they can only be a time of day since 1970 are
  absolute: nanoseconds from 1e17, microseconds from 1e14.
* **floats** since 1970 are absolute: seconds from 1e8 (`timestamp` of Hesai and RoboSense,
  float64), milliseconds from 1e11, microseconds from 1e14, nanoseconds from 1e17 (`timestamp` of
  livox_ros_driver2, nanoseconds in a float64). Other floats are relative, and a revolution does
  not last longer than two seconds: a span up to 2 counts seconds (`time` of velodyne_pointcloud,
  float32 seconds since the header stamp, negative where the header means the end), up to 2e3
  milliseconds, up to 2e6 microseconds (`time` in many simulated and converted data sets), above
  nanoseconds.

Relative times count from the header stamp. If the recipe says that the header stamp means the
end (middle) of a revolution, and no time is negative, they count from the start instead, and are
moved so that the last (the middle) falls on the header stamp. Absolute times that are more than
ten seconds away from the header stamp come from another clock, such as time since boot: only
their differences are used, and they are moved likewise so that they agree with the header stamp;
unless the recipe says what that means, they are moved so that the revolution keeps it for its stamp.

Times that do not differ at all, or that span more than two seconds, are taken for not recorded.
"""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bagassets.decode.fields import Column
from bagassets.errors import DecodeError

__all__ = ["LONGEST_REVOLUTION_NS", "Moment", "point_times_ns"]

Moment = Literal["start", "middle", "end"]

TIME_NAMES = (
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "offset_time",
    "time_offset",
    "point_time_offset",
    "timestamp_offset",
    "relative_timestamp",
    "stamp",
    "t_us",
    "time_us",
    "timestamp_us",
    "offset_time_us",
    "time_offset_us",
    "t_ns",
    "time_ns",
    "timestamp_ns",
    "time_offset_ns",
)
LONGEST_REVOLUTION_NS = 2_000_000_000
OTHER_CLOCK_NS = 10_000_000_000

# Smallest absolute time since 1970 -> nanoseconds per unit; 1e8 s was in 1973.
_ABSOLUTE = ((1e17, 1), (1e14, 1_000), (1e11, 1_000_000), (1e8, 1_000_000_000))
# Longest span of a revolution -> nanoseconds per unit.
_RELATIVE = ((2.0, 1_000_000_000), (2e3, 1_000_000), (2e6, 1_000), (2e9, 1))


def point_times_ns(
    fields: Mapping[str, Column],
    keep: NDArray[np.bool_] | None,
    header_ns: int,
    header_stamp_is: Moment | None,
    stamp: Moment = "end",
) -> NDArray[np.int64] | None:
    """Return the absolute time of each point, (N,) nanoseconds on the clock of the header.

    Args:
        fields: field name -> (height, width) values.
        keep: (height * width,) which points to keep; None for all.
        header_ns: header stamp.
        header_stamp_is: the moment that the header stamp means; None if the recipe does not say.
        stamp: the moment of the revolution for its stamp.

    Returns:
        None if the cloud has no usable point times.

    Raises:
        DecodeError: the time of a wanted point is not finite.
    """
    name = next((name for name in TIME_NAMES if name in fields), None)
    if name is None:
        return None
    values = fields[name].reshape(-1)
    if keep is not None:
        values = values[keep]
    if not len(values):
        return None
    scaled = _integer_ns(name, values) if values.dtype.kind in "iu" else _float_ns(name, values)
    if scaled is None:
        return None
    times_ns, absolute = scaled
    first, last = int(times_ns.min()), int(times_ns.max())
    if not 0 < last - first <= LONGEST_REVOLUTION_NS:
        return None
    if absolute and max(abs(first - header_ns), abs(last - header_ns)) <= OTHER_CLOCK_NS:
        return times_ns
    relative = not absolute and max(abs(first), abs(last)) <= LONGEST_REVOLUTION_NS
    if relative and (header_stamp_is in {None, "start"} or first < 0):
        return times_ns + header_ns
    anchor = {"start": first, "middle": (first + last) // 2, "end": last}[header_stamp_is or stamp]
    return times_ns + (header_ns - anchor)


def _integer_ns(name: str, values: Column) -> tuple[NDArray[np.int64], bool]:
    smallest = int(values.min())
    unit = 1_000 if name.endswith("us") or 1e14 <= smallest < 1e17 else 1
    return values.astype(np.int64) * unit, smallest * unit >= 1e17


def _float_ns(name: str, values: Column) -> tuple[NDArray[np.int64], bool] | None:
    seconds = values.astype(np.float64)
    low, high = float(seconds.min()), float(seconds.max())
    if not np.isfinite(high - low):
        raise DecodeError(f"its field {name} is not finite for a point")
    absolute = next((unit for least, unit in _ABSOLUTE if low >= least), None)
    if absolute is not None and values.dtype.itemsize < 8:
        return None  # a time since 1970 in single precision is accurate to two minutes only
    unit = absolute or next((unit for longest, unit in _RELATIVE if high - low <= longest), None)
    if unit is None:
        return None
    # The whole part is converted separately, so that absolute times keep their precision.
    base = np.floor(low)
    offsets_ns = np.rint((seconds - base) * float(unit)).astype(np.int64)
    return offsets_ns + int(base) * unit, absolute is not None
