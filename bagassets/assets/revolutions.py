"""Cutting a stream of packets of a Velodyne or Hesai into revolutions.

A packet belongs to the revolution in which its first block was fired: the cut is as fine as a
packet is long (0.6 degrees for a VLS-128 at 10 Hz, 5 for a VLP-16). Azimuth is the lidar's own,
clockwise from the x axis of a Velodyne's frame, the y axis of a Hesai's.

A lidar may be configured to report only a part of each turn; it then sends no packets for the rest. An arc that is
missing at the same place in most of the first turns is taken for such a *blind arc*: it does not count as missing,
and unless the recipe names an angle the cut is in its middle, so that a revolution is one sweep.

A revolution ends where the azimuth returns to the cut, whatever is missing there. It is complete if, apart from the
blind arc, no more than `MOST_MISSING_DEG` are missing in one piece, at its start, at its end or inside. So the first and
the last one of a recording count only if the recording started or ended close to the cut.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.decode.packets import Packets

MOST_MISSING_DEG = 20.0
# Packets follow each other within 2 ms. If 20 ms more have passed than the lidar needs from one azimuth to the
# next, whole turns may be missing, which azimuths do not show.
LONGEST_PAUSE_NS = 20_000_000
# A lidar at 5 Hz takes 0.2 s; after this long without passing the cut it is not spinning.
LONGEST_REVOLUTION_NS = 500_000_000
# Three times as many as the fastest lidar sends in that time: stamps may be made up.
MOST_PACKETS = 20_000

_TURN = 36_000  # hundredths of a degree
_HOUR_US = 3_600_000_000
_MOST_MISSING = round(MOST_MISSING_DEG * 100)
# Lidars turn at 5 to 20 Hz; an advance faster than 30 Hz is a step back.
_FASTEST_PER_NS = 30 * _TURN * 1e-9
_SLOWEST_TURN_NS = 200_000_000
# The spin is learnt from this many turns, or from this time if the lidar does not spin.
_LEARNT_TURNS = 3
_LEARNT_NS = 1_000_000_000


_Logged = tuple[Packets, NDArray[np.int64]]  # with the log times of their messages


@dataclass(frozen=True, slots=True, eq=False)
class Revolution:
    """Packets between two cuts.

    Attributes:
        packets: in the order in which they were recorded, at least one.
        azimuths: (N,) azimuth of each packet, hundredths of a degree after the cut.
        log_time_ns: log time of the last packet's message.
        next_packet: the packet after the cut; None if none followed without a pause.
        blind: the arc that the lidar does not report, hundredths of a degree after the cut; may reach beyond a turn.
    """

    packets: Packets
    azimuths: NDArray[np.int64]
    log_time_ns: int
    next_packet: Packets | None
    blind: tuple[int, int]

    @property
    def missing_deg(self) -> float:
        """The widest part that no packet covers, outside the blind arc, in degrees."""
        edges = np.concatenate([[0], self.azimuths, [_TURN]])
        steps = np.diff(edges)
        width = int(np.sort(steps[1:-1])[(len(steps) - 2) // 2]) if len(steps) > 2 else 0
        for turn in (0, _TURN):
            begin, end = (azimuth - turn for azimuth in self.blind)
            inside = np.minimum(edges[1:], end) - np.maximum(edges[:-1], begin)
            steps = steps - np.maximum(inside, 0)
        # A packet covers the step that follows it; nothing covers what is before the first.
        return max(int(steps[0]), int(steps[1:].max()) - width) / 100.0

    @property
    def complete(self) -> bool:
        """True if (nearly) everything outside the blind arc was recorded."""
        return self.missing_deg <= MOST_MISSING_DEG

    def times_ns(self) -> tuple[NDArray[np.int64], int]:
        """Return the time of each packet's first firing, and the time of the end of the turn.

        The end is when the next revolution starts, or one (median) packet after the last if none follows
        closely.
        """
        following = self.next_packet
        if following is not None and _forward(self.packets[-1:], following)[0] > _MOST_MISSING:
            following = None
        times = packet_times_ns(
            self.packets if following is None else Packets.joined([self.packets, following])
        )
        if following is not None:
            return times[:-1], int(times[-1])
        step = int(np.sort(np.diff(times))[(len(times) - 1) // 2]) if len(times) > 1 else 0
        return times, int(times[-1]) + step


def packet_times_ns(packets: Packets) -> NDArray[np.int64]:
    """Return (N,) times of consecutive packets, on the host's clock.

    The host's stamps have the jitter of network and driver, often a millisecond; the lidar's
    own microseconds do not. So differences come from the lidar, and the offset between both
    clocks is the median over the packets. If the lidar's clock does not run (as in synthetic
    data), the host's stamps are used.
    """
    host = packets.host_ns
    steps_ns = np.diff(packets.device_us) % _HOUR_US * 1000
    # Over a blind arc steps are long, by both clocks.
    runs = (steps_ns > 0) & (
        (steps_ns <= LONGEST_PAUSE_NS) | (abs(steps_ns - np.diff(host)) <= LONGEST_PAUSE_NS)
    )
    if not runs.all():
        return host
    since_first = np.concatenate([[0], np.cumsum(steps_ns)])
    offset = np.sort(host - since_first)[(len(host) - 1) // 2]
    return np.asarray(since_first + offset)


class RevolutionCutter:
    """Collects packets and returns revolutions as they end; the first ones once the spin of the lidar is known.

    Args:
        cut_angle_deg: azimuth at which revolutions begin; None for 0, or the middle of the blind arc if there is one.
    """

    def __init__(self, cut_angle_deg: float | None) -> None:
        self._angle = cut_angle_deg
        self._cut = 0
        self._blind = (0, 0)
        self._turn_ns: float | None = None  # duration of a turn, once the spin is known
        self._waiting: list[_Logged] = []  # until then
        self._current: list[_Logged] = []  # since the last cut
        self._last: Packets | None = None

    def push(self, packets: Packets, log_times_ns: NDArray[np.int64]) -> list[Revolution]:
        """Add the next packets; return the revolutions that are known to have ended.

        Args:
            packets: the packets.
            log_times_ns: (N,) log times of their messages.
        """
        if self._turn_ns is not None:
            return self._take(packets, log_times_ns, self._turn_ns)
        self._waiting.append((packets, log_times_ns))
        packets, log_times_ns = _joined(self._waiting)
        turned = np.cumsum(_advance(packets[:-1], packets[1:]))
        since_first_ns = packets.host_ns[1:] - packets.host_ns[:1]
        known = np.flatnonzero((turned >= _LEARNT_TURNS * _TURN) | (since_first_ns > _LEARNT_NS))
        if not len(known):
            return []
        return self._learn(packets, log_times_ns, int(known[0]) + 2)

    def flush(self) -> list[Revolution]:
        """Return the remaining revolutions, the last one as far as it was recorded."""
        revolutions = []
        if self._turn_ns is None:
            packets, log_times_ns = _joined(self._waiting)
            revolutions = self._learn(packets, log_times_ns, len(packets))
        return [*revolutions, self._end(None)] if self._current else revolutions

    def _learn(self, packets: Packets, log_times_ns: NDArray[np.int64], number: int) -> list[Revolution]:
        """Learn the spin from the first packets; return the revolutions that have ended by the last one."""
        self._turn_ns, blind = _spin(packets[:number])
        if self._angle is not None:
            self._cut = round(self._angle * 100) % _TURN
        elif blind is not None:
            self._cut = sum(blind) // 2 % _TURN
        if blind is not None:
            begin = (blind[0] - self._cut) % _TURN
            self._blind = (begin, begin + blind[1] - blind[0])
        self._waiting = []
        return self._take(packets, log_times_ns, self._turn_ns)

    def _take(self, packets: Packets, log_times_ns: NDArray[np.int64], turn_ns: float) -> list[Revolution]:
        if not len(packets):
            return []
        before = Packets.joined([packets[:1] if self._last is None else self._last, packets[:-1]])
        advance = _advance(before, packets)
        paused = _pause(before, packets, advance, turn_ns)
        returned = (before.azimuths - self._cut) % _TURN + advance >= _TURN
        if self._last is None:
            paused[0] = returned[0] = False
        self._last = packets[-1:]
        ended, begin = [], 0
        for end in [*np.flatnonzero(paused | returned).tolist(), len(packets)]:
            while (stuck := self._stuck(packets.host_ns, begin, end)) < end:
                self._add(packets[begin:stuck], log_times_ns[begin:stuck])
                ended.append(self._end(None))
                begin = stuck
            self._add(packets[begin:end], log_times_ns[begin:end])
            if end < len(packets):
                ended.append(self._end(packets[end : end + 1] if returned[end] and not paused[end] else None))
            begin = end
        return ended

    def _stuck(self, host_ns: NDArray[np.int64], begin: int, end: int) -> int:
        """Return the first of some packets that is too many for the current revolution, or comes too late; else the end."""
        first_ns = self._current[0][0].host_ns[0] if self._current else host_ns[begin]
        number = sum(len(packets) for packets, _ in self._current)
        late = np.flatnonzero(host_ns[begin:end] - first_ns > LONGEST_REVOLUTION_NS)
        return min(end, begin + MOST_PACKETS - number, begin + int(late[0]) if len(late) else end)

    def _add(self, packets: Packets, log_times_ns: NDArray[np.int64]) -> None:
        if len(packets):
            self._current.append((packets, log_times_ns))

    def _end(self, following: Packets | None) -> Revolution:
        (packets, log_times_ns), self._current = _joined(self._current), []
        azimuths = (packets.azimuths - self._cut) % _TURN
        return Revolution(packets, azimuths, int(log_times_ns[-1]), following, self._blind)


def _joined(parts: Sequence[_Logged]) -> _Logged:
    times_ns = [log_times_ns for _, log_times_ns in parts]
    joined_ns = np.concatenate(times_ns) if times_ns else np.empty(0, dtype=np.int64)
    return Packets.joined([packets for packets, _ in parts]), joined_ns


def _forward(before: Packets, after: Packets) -> NDArray[np.int64]:
    return (after.azimuths - before.azimuths) % _TURN


def _elapsed_ns(before: Packets, after: Packets) -> NDArray[np.int64]:
    """Return the time between packets by the lidar's clock or, if it does not run, the host's; maybe negative."""
    device_us = (after.device_us - before.device_us + _HOUR_US // 2) % _HOUR_US - _HOUR_US // 2
    return np.where(device_us != 0, device_us * 1000, after.host_ns - before.host_ns)


def _advance(before: Packets, after: Packets) -> NDArray[np.int64]:
    """Return how far the lidar turned, hundredths of a degree; negative for a late packet, or jitter."""
    forward = _forward(before, after)
    back = (forward > _TURN // 2) & (forward > _FASTEST_PER_NS * _elapsed_ns(before, after))
    return np.where(back, forward - _TURN, forward)


def _pause(before: Packets, after: Packets, advance: NDArray[np.int64], turn_ns: float) -> NDArray[np.bool_]:
    """Return whether more time has passed between packets than the lidar needed, by both clocks.

    Hosts stamp late in bursts, and the lidar's clock may jump: a pause shows in both.
    """
    needed_ns = np.maximum(0, advance) / _TURN * turn_ns
    device_ns = (after.device_us - before.device_us) % _HOUR_US * 1000
    host_ns = after.host_ns - before.host_ns
    soon = (device_ns > 0) & (device_ns <= needed_ns + LONGEST_PAUSE_NS)
    return (host_ns - needed_ns > LONGEST_PAUSE_NS) & ~soon


def _spin(packets: Packets) -> tuple[float, tuple[int, int] | None]:
    """Return how long a turn of the lidar takes that sent these consecutive packets, and the arc that it does not report.

    The latter is first and last azimuth, hundredths of a degree, the last maybe beyond a turn; None if it reports the
    whole turn.
    """
    before, after = packets[:-1], packets[1:]
    advance, elapsed_ns = _advance(before, after), _elapsed_ns(before, after)
    jumped = advance > _MOST_MISSING
    small = ~jumped & (advance > 0) & (elapsed_ns > 0) & (elapsed_ns <= LONGEST_PAUSE_NS)
    small_ns, small_turn = int(elapsed_ns[small].sum()), int(advance[small].sum())
    turn_ns = small_ns / small_turn * _TURN if small_turn else _SLOWEST_TURN_NS
    arcs = [
        (begin, width)
        for begin, width, lasted_ns in zip(
            before.azimuths[jumped].tolist(),
            advance[jumped].tolist(),
            elapsed_ns[jumped].tolist(),
            strict=True,
        )
        if abs(lasted_ns - width / _TURN * turn_ns) <= LONGEST_PAUSE_NS
    ]
    return turn_ns, _blind_arc(arcs, int(advance.sum()) / _TURN)


def _blind_arc(arcs: Sequence[tuple[int, int]], turns: float) -> tuple[int, int] | None:
    """Return the arc that is missing in most turns, or None; arcs lost by chance are elsewhere each time.

    Args:
        arcs: (begin, width) of each missing arc, hundredths of a degree.
        turns: number of turns.
    """
    for begin, width in arcs:
        middle = begin + width // 2
        # The same arc: the middle of each lies in the other.
        alike = [
            (other, wide)
            for other, wide in arcs
            if abs((other + wide // 2 - middle + _TURN // 2) % _TURN - _TURN // 2) <= min(width, wide) // 2
        ]
        if len(alike) >= max(2, turns / 2):
            begins = sorted((other - begin + _TURN // 2) % _TURN - _TURN // 2 for other, _ in alike)
            ends = sorted((other - begin + _TURN // 2) % _TURN - _TURN // 2 + wide for other, wide in alike)
            # Medians, so that packets lost beside the arc in a single turn do not widen it.
            first, last = begin + begins[len(begins) // 2], begin + ends[(len(ends) - 1) // 2]
            return first % _TURN, first % _TURN + last - first
    return None
