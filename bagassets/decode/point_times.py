"""Times of the points of a cloud, in the various fields and units of drivers.

The field is found by name. What it counts, and from when, is one decision for all clouds of a topic (`survey`), made from
what most points of its first clouds say, from their header stamps, and from the time from one to the next.

* **Unit.** Integers count nanoseconds, or microseconds if the name ends in `us` or if only that makes a date of them: `t` of
  Ouster, `offset_time` of Livox, `time_stamp` of Nebula (all uint32 ns). Floats count whichever of seconds, milliseconds,
  microseconds and nanoseconds makes them a date since 1970 (`timestamp` of Hesai and RoboSense, float64 s, and of
  livox_ros_driver2, float64 ns); else the largest unit in which a cloud lasts no more than two seconds (`time` of
  velodyne_pointcloud, float32 s).
* **Origin.** Times that are small and do not go on from cloud to cloud count from the header stamp. All others are those of
  a clock: that of the header stamps if these are less than ten seconds away, even if it starts at 0 as in a simulator;
  else another one, such as time since boot.

Relative times count from the header stamp. If the recipe says that the header stamp means the end (middle) of a
revolution, and no time is negative, they count from the start instead, and are moved so that the last (the middle) falls
on the header stamp. Of another clock only differences are used: its times are moved likewise so that they agree with the
header stamp; unless the recipe says what that means, so that the revolution keeps it for its stamp.

The few points of a cloud whose times lie apart from those of the many have none: zeros among dates, or garbage. Times that do
not differ at all, spread over more than two seconds in most clouds, or are too large for single precision are not used.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import Column
from bagassets.geometry.se3 import Floats
from bagassets.recipe.model import PointTimes

Moment = Literal["start", "middle", "end"]
Unit = Literal["s", "ms", "us", "ns"]

_NAMES = """
t time timestamp time_stamp offset_time time_offset point_time_offset timestamp_offset relative_timestamp stamp
t_us time_us timestamp_us offset_time_us time_offset_us t_ns time_ns timestamp_ns time_offset_ns
"""
TIME_NAMES = tuple(_NAMES.split())
LONGEST_REVOLUTION_NS = 2_000_000_000
OTHER_CLOCK_NS = 10_000_000_000
MOST_APART = 0.05
"""Share of the points whose times may lie apart from those of the others without a question."""

_UNITS_NS: Mapping[Unit, int] = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
# Smallest time since 1970 in each unit; 1e8 s was in 1973.
_DATES: Mapping[Unit, float] = {"ns": 1e17, "us": 1e14, "ms": 1e11, "s": 1e8}
_LATEST_NS = 1 << 62  # beyond is garbage, which might not fit into 64 bits
_SURVEYED = 5  # clouds with points from which it is decided what times are
_PATIENCE = 15  # as many if these leave a doubt or cannot be used: sensors take time to start
_TAIL = 0.1  # share of the points, at either end, that the decision does not depend on
_LONGEST_PERIODS = 2.5  # from cloud to cloud, in which one may last without a question


@dataclass(frozen=True, slots=True, eq=False)
class RecordedTimes:
    """Times of the points of a cloud as recorded.

    Attributes:
        name: of the field.
        values: (N,) of those points that are measurements.
        header_ns: header stamp.
    """

    name: str
    values: Column
    header_ns: int


@dataclass(frozen=True, slots=True)
class PointClock:
    """What the times of the points of a topic count, and from when.

    Attributes:
        field: name of the field.
        unit: what they count.
        origin: whether they count from the header stamp, are those of a clock, or of one that is not that of header stamps.
        longest_ns: a longer cloud is looked at more closely.
        span_ns: how long a cloud lasts, about.
        ahead_ns: what the first point of the first cloud tells, less its header stamp, about.
        apart: share of the times in the first clouds that lie apart from the others.
        doubt: what is not sure about them, as a clause; "" if all is.
        problem: why they cannot be used, as a clause; "" if they can.
    """

    field: str = ""
    unit: Unit = "ns"
    origin: Literal["header", "clock", "other"] = "header"
    longest_ns: int = LONGEST_REVOLUTION_NS
    span_ns: float = 0.0
    ahead_ns: float = 0.0
    apart: float = 0.0
    doubt: str = ""
    problem: str = ""

    @property
    def is_of_headers(self) -> bool:
        """Whether they are of the clock of the header stamps, and so say what these mark."""
        return self.origin == "clock" and abs(self.ahead_ns) <= OTHER_CLOCK_NS

    def __str__(self) -> str:
        if self.problem:
            return f"the times of its points ({self.field}) cannot be used, as {self.problem}"
        since = "since the header stamp"
        if self.origin != "header":
            other = f"another clock ({self.ahead_ns / 1e9:+.1f} s), of which only differences are used"
            since = f"by {'the clock of the header stamps' if self.is_of_headers else other}"
        text = f"the times of its points ({self.field}) count {self.unit} {since}, {self.span_ns / 1e9:.3f} s a cloud"
        if self.apart:
            text += f"; {self.apart:.2%} lie apart and are left out"
        if self.doubt:
            text += f"; that is not sure, as {self.doubt}: say it in point_times of the recipe"
        return text


def time_of(moment: Moment, first_ns: int, last_ns: int) -> int:
    """Return the time of a moment of a revolution."""
    return {"start": first_ns, "middle": (first_ns + last_ns) // 2, "end": last_ns}[moment]


def recorded_times(
    fields: Mapping[str, Column], keep: NDArray[np.bool_] | None, header_ns: int
) -> RecordedTimes | None:
    """Return the times in (height, width) fields of those points of a cloud that are kept; None if no field is for them."""
    name = next((name for name in TIME_NAMES if name in fields), None)
    if name is None:
        return None
    values = fields[name].reshape(-1)
    return RecordedTimes(name, values.copy() if keep is None else values[keep], header_ns)


def suffice(clouds: Sequence[RecordedTimes], given: PointTimes | Literal["ignore"] | None = None) -> bool:
    """Tell whether so many first clouds suffice for `survey`; those of less than two points tell nothing."""
    telling = sum(len(cloud.values) > 1 for cloud in clouds)
    if telling != _SURVEYED or given is not None:
        return telling >= (_PATIENCE if given is None else _SURVEYED)
    clock = survey(clouds)
    return not (clock.doubt or clock.problem)


def survey(
    clouds: Sequence[RecordedTimes], given: PointTimes | Literal["ignore"] | None = None
) -> PointClock:
    """Decide what the times of a topic are from its first clouds, in the order in which they were recorded.

    Args:
        clouds: at least one.
        given: what the recipe says.
    """
    clock, dtype = PointClock(clouds[0].name), clouds[0].values.dtype
    if given == "ignore":
        return replace(clock, problem="the recipe ignores them")
    told = [(cloud.header_ns, *bulk) for cloud in clouds for bulk in _bulk(cloud.values)]
    if not told:
        return replace(clock, problem="no cloud has two of them")
    headers_ns, lows, highs = np.array(told).T
    low, high, span = (float(np.median(values)) for values in (lows, highs, highs - lows))
    if not span:
        return replace(clock, problem="they do not differ")
    if dtype.kind == "f" and dtype.itemsize == 4 and np.spacing(np.float32(high)) > span / 10:
        return replace(clock, problem="they are too large for single precision")
    unit = given.unit if given else _unit(clock.field, dtype.kind, low, span)
    if unit is None or span * _UNITS_NS[unit] > LONGEST_REVOLUTION_NS:
        return replace(clock, problem="those of one cloud spread over more than two seconds")
    if max(abs(low), abs(high)) * _UNITS_NS[unit] >= _LATEST_NS:
        return replace(clock, problem="they are later than any date")
    starts_ns, span_ns = lows * _UNITS_NS[unit], span * _UNITS_NS[unit]
    period_ns = float(np.diff(np.sort(headers_ns)).max(initial=0.0))
    origin = given.since if given else _origin(starts_ns, span_ns, headers_ns[0])
    longest_ns = 1.5 * period_ns if period_ns else LONGEST_REVOLUTION_NS
    clock = replace(
        clock,
        unit=unit,
        origin="other" if origin == "clock" and len(told) > 1 and not headers_ns.any() else origin,
        longest_ns=round(min(longest_ns, LONGEST_REVOLUTION_NS)),
        span_ns=span_ns,
        ahead_ns=float(starts_ns[0] - headers_ns[0]),
    )
    agreeing = [_agreeing(cloud.values, clock) for cloud in clouds]
    apart = sum(int((~kept).sum()) for kept in agreeing if kept is not None)
    clock = replace(clock, apart=apart / sum(len(cloud.values) for cloud in clouds))
    return clock if given else replace(clock, doubt=_doubt(clock, dtype.kind, period_ns))


def _bulk(values: Column) -> list[tuple[float, float]]:
    """Return about when most points of a cloud begin and end, in units of the field; nothing for less than two."""
    values = values[np.isfinite(values)]
    last = len(values) - 1
    if last < 1:
        return []
    tail = int(_TAIL * last)
    low, high = np.partition(values, (tail, last - tail))[[tail, last - tail]].astype(np.float64).tolist()
    if low == high:  # nearly all have one time; those of the rest may be right
        return [(float(values.min()), float(values.max()))]
    beyond = (high - low) * tail / (last - 2 * tail)
    return [(low - beyond, high + beyond)]


def _unit(name: str, kind: str, low: float, span: float) -> Unit | None:
    fitting = [unit for unit, unit_ns in _UNITS_NS.items() if span * unit_ns <= LONGEST_REVOLUTION_NS]
    date = next((unit for unit, least in _DATES.items() if low >= least and unit in fitting), None)
    if kind == "f":
        return date or next(iter(fitting), None)
    return "us" if name.endswith("us") or date == "us" else "ns"


def _origin(starts_ns: Floats, span_ns: float, header_ns: float) -> Literal["header", "clock"]:
    """Return what times count from: those of a clock are large, or go on from one cloud to the next."""
    start_ns = float(np.median(starts_ns))
    if not -1.1 * LONGEST_REVOLUTION_NS < start_ns < 1.1 * LONGEST_REVOLUTION_NS - span_ns:
        return "clock"
    if len(starts_ns) > 1:
        return "clock" if float(np.median(np.diff(starts_ns))) > span_ns / 4 else "header"
    middle_ns = start_ns + span_ns / 2
    return "clock" if abs(middle_ns - header_ns) < abs(middle_ns) else "header"


def _doubt(clock: PointClock, kind: str, period_ns: float) -> str:
    span_s, period_s = clock.span_ns / 1e9, period_ns / 1e9
    is_ns = kind == "f" or clock.unit != "ns" or clock.field.endswith("ns")
    if not is_ns and span_s < period_s / 200 and period_s / 4 <= 1000 * span_s <= 1.5 * period_s:
        return f"they last {span_s:.2g} s a cloud as nanoseconds, and {1000 * span_s:.2g} s as microseconds"
    if 0 < _LONGEST_PERIODS * period_s < span_s:
        return f"they last {span_s:.2g} s a cloud, but clouds come every {period_s:.2g} s"
    if clock.apart > MOST_APART:
        return f"{clock.apart:.0%} of them lie apart from the others of their clouds"
    return ""


def point_times_ns(
    raw: RecordedTimes, clock: PointClock, header_stamp_is: Moment | None, stamp: Moment = "end"
) -> tuple[NDArray[np.int64], NDArray[np.bool_] | None]:
    """Return the absolute time of each point that has one, (M,) nanoseconds on the clock of the header.

    Args:
        raw: at least one time.
        clock: what they are; one without a problem.
        header_stamp_is: the moment that the header stamp means; None if the recipe does not say.
        stamp: the moment of the revolution for its stamp.

    Returns:
        The times, and (N,) which points they belong to; None for all.

    Raises:
        DecodeError: the times of most points do not agree, or not with those of other clouds.
    """
    kept = _agreeing(raw.values, clock)
    values = raw.values if kept is None else raw.values[kept]
    if 2 * len(values) <= len(raw.values):
        raise DecodeError("the times of its points do not agree")
    unit_ns, header_ns = _UNITS_NS[clock.unit], raw.header_ns
    if values.dtype.kind in "iu":
        times_ns = values.astype(np.int64) * unit_ns
    else:
        # The whole part is converted separately, so that absolute times keep their precision.
        seconds = values.astype(np.float64)
        base = np.floor(float(seconds.min()))
        times_ns = np.rint((seconds - base) * float(unit_ns)).astype(np.int64) + int(base) * unit_ns
    first, last = int(times_ns.min()), int(times_ns.max())
    if clock.origin == "header":
        if max(abs(first), abs(last)) > 1.1 * LONGEST_REVOLUTION_NS:
            raise DecodeError(
                "the times of its points do not count from its stamp as those of other clouds do"
            )
        if header_stamp_is in {None, "start"} or first < 0:
            return times_ns + header_ns, kept
    elif clock.origin == "clock" and max(abs(first - header_ns), abs(last - header_ns)) <= OTHER_CLOCK_NS:
        return times_ns, kept
    return times_ns + (header_ns - time_of(header_stamp_is or stamp, first, last)), kept


def _agreeing(values: Column, clock: PointClock) -> NDArray[np.bool_] | None:
    """Return which of (N,) times are of one revolution; None for all. If that are few, none are to be relied on."""
    unit_ns = _UNITS_NS[clock.unit]
    low, high = (values.min().item(), values.max().item()) if len(values) else (0, 0)
    # Written so that it is false of numbers that are not finite, too.
    if (high - low) * unit_ns <= clock.longest_ns and max(abs(low), abs(high)) * unit_ns < _LATEST_NS:
        return None
    times = values.astype(np.float64)
    ordered = np.sort(times[np.abs(times) < _LATEST_NS / unit_ns])
    few = max(1, len(values) // 20)
    longest_ns = clock.longest_ns
    first, number = _densest(ordered, longest_ns / unit_ns)
    # A cloud that did take longer goes on beyond; of garbage there is little.
    while longest_ns < LONGEST_REVOLUTION_NS and number < len(ordered):
        wider_ns = min(2 * longest_ns, LONGEST_REVOLUTION_NS)
        wider = _densest(ordered, wider_ns / unit_ns)
        if wider[1] - number <= few:
            break
        longest_ns, (first, number) = wider_ns, wider
    return (times >= first) & (times <= first + longest_ns / unit_ns)


def _densest(ordered: Floats, length: float) -> tuple[float, int]:
    """Return where the stretch of a length begins that holds most of some (N,) ordered numbers, and how many it holds."""
    if not len(ordered):
        return np.inf, 0
    numbers = np.searchsorted(ordered, ordered + length, side="right") - np.arange(len(ordered))
    begin = int(np.argmax(numbers))
    return float(ordered[begin]), int(numbers[begin])
