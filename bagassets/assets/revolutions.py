"""Cutting a stream of Velodyne packets into revolutions.

A packet belongs to the revolution in which its first block was fired: the cut is as fine as a
packet is long (0.6 degrees for a VLS-128 at 10 Hz, 5 for a VLP-16). Azimuth is the lidar's own,
clockwise from the x axis of its frame.

A lidar may be configured to report only a part of each turn; it then sends no packets for the rest. An arc that is
missing at the same place in most of the first turns is taken for such a *blind arc*: it does not count as missing,
and unless the recipe names an angle the cut is in its middle, so that a revolution is one sweep.

A revolution ends where the azimuth returns to the cut, whatever is missing there. It is complete if, apart from the
blind arc, no more than `MOST_MISSING_DEG` are missing in one piece, at its start, at its end or inside. So the first and
the last one of a recording count only if the recording started or ended close to the cut.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bagassets.decode.velodyne import Packet

__all__ = ["Revolution", "RevolutionCutter", "packet_times_ns"]

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


@dataclass(frozen=True, slots=True)
class Spin:
    """The rotation of a lidar.

    Attributes:
        turn_ns: duration of a turn.
        blind: first and last azimuth of the arc that it does not report, hundredths of a degree; None if it
            reports the whole turn. The last may be beyond a turn.
    """

    turn_ns: float = _SLOWEST_TURN_NS
    blind: tuple[int, int] | None = None


@dataclass(slots=True)
class Revolution:
    """Packets between two cuts.

    Attributes:
        packets: in the order in which they were recorded.
        azimuths: azimuth of each packet, hundredths of a degree after the cut.
        log_times_ns: log time of each packet's message.
        next_packet: the packet after the cut; None if none followed without a pause.
        blind: the arc that the lidar does not report, hundredths of a degree after the cut; may reach beyond a turn.
    """

    packets: list[Packet] = field(default_factory=list)
    azimuths: list[int] = field(default_factory=list)
    log_times_ns: list[int] = field(default_factory=list)
    next_packet: Packet | None = None
    blind: tuple[int, int] = (0, 0)

    @property
    def missing_deg(self) -> float:
        """The widest part that no packet covers, outside the blind arc, in degrees."""
        edges = np.array([0, *self.azimuths, _TURN], dtype=np.int64)
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
        follows = (
            self.next_packet is not None and _forward(self.packets[-1], self.next_packet) <= _MOST_MISSING
        )
        times = packet_times_ns(
            [*self.packets, *([self.next_packet] if follows and self.next_packet else [])]
        )
        if follows:
            return times[:-1], int(times[-1])
        step = int(np.sort(np.diff(times))[(len(times) - 1) // 2]) if len(times) > 1 else 0
        return times, int(times[-1]) + step


def packet_times_ns(packets: Sequence[Packet]) -> NDArray[np.int64]:
    """Return (N,) times of consecutive packets, on the host's clock.

    The host's stamps have the jitter of network and driver, often a millisecond; the lidar's
    own microseconds do not. So differences come from the lidar, and the offset between both
    clocks is the median over the packets. If the lidar's clock does not run (as in synthetic
    data), the host's stamps are used.
    """
    host = np.array([packet.host_ns for packet in packets], dtype=np.int64)
    device = np.array([packet.device_us for packet in packets], dtype=np.int64)
    steps_ns = np.diff(device) % _HOUR_US * 1000
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
        self._current = Revolution()
        self._spin: Spin | None = None
        self._waiting: list[tuple[Packet, int]] = []
        self._turned = 0

    def push(self, packet: Packet, log_time_ns: int) -> list[Revolution]:
        """Add the next packet; return the revolutions that are known to have ended before it."""
        if self._spin is not None:
            ended = self._take(packet, log_time_ns, self._spin)
            return [] if ended is None else [ended]
        if self._waiting:
            self._turned += _advance(self._waiting[-1][0], packet)
        self._waiting.append((packet, log_time_ns))
        since_first_ns = packet.host_ns - self._waiting[0][0].host_ns
        if self._turned >= _LEARNT_TURNS * _TURN or since_first_ns > _LEARNT_NS:
            return self._learn()
        return []

    def flush(self) -> list[Revolution]:
        """Return the remaining revolutions, the last one as far as it was recorded."""
        revolutions = self._learn()
        last, self._current = self._current, Revolution()
        return [*revolutions, last] if last.packets else revolutions

    def _learn(self) -> list[Revolution]:
        """Return the revolutions that ended before the spin of the lidar was known."""
        if self._spin is None:
            self._spin = _spin([packet for packet, _ in self._waiting])
            blind = self._spin.blind
            if self._angle is not None:
                self._cut = round(self._angle * 100) % _TURN
            elif blind is not None:
                self._cut = sum(blind) // 2 % _TURN
        waiting, self._waiting = self._waiting, []
        taken = [self._take(packet, log_time_ns, self._spin) for packet, log_time_ns in waiting]
        return [revolution for revolution in taken if revolution is not None]

    def _take(self, packet: Packet, log_time_ns: int, spin: Spin) -> Revolution | None:
        ended = None
        current = self._current
        if current.packets:
            before = current.packets[-1]
            advance = _advance(before, packet)
            # Asked of each packet: most come sooner than any pause lasts.
            waited = packet.host_ns - before.host_ns > LONGEST_PAUSE_NS
            paused = waited and _pause(before, packet, advance, spin.turn_ns)
            returned = current.azimuths[-1] + advance >= _TURN
            lasts_ns = packet.host_ns - current.packets[0].host_ns
            stuck = lasts_ns > LONGEST_REVOLUTION_NS or len(current.packets) >= MOST_PACKETS
            if paused or returned or stuck:
                ended = current
                ended.next_packet = packet if returned and not paused else None
                current = self._current = Revolution()
        if not current.packets and spin.blind is not None:
            begin = (spin.blind[0] - self._cut) % _TURN
            current.blind = (begin, begin + spin.blind[1] - spin.blind[0])
        current.packets.append(packet)
        current.azimuths.append((packet.azimuth - self._cut) % _TURN)
        current.log_times_ns.append(log_time_ns)
        return ended


def _forward(before: Packet, after: Packet) -> int:
    return (after.azimuth - before.azimuth) % _TURN


def _elapsed_ns(before: Packet, after: Packet) -> int:
    """Return the time between two packets by the lidar's clock or, if it does not run, the host's; maybe negative."""
    device_us = (after.device_us - before.device_us + _HOUR_US // 2) % _HOUR_US - _HOUR_US // 2
    return device_us * 1000 if device_us else after.host_ns - before.host_ns


def _advance(before: Packet, after: Packet) -> int:
    """Return how far the lidar turned, hundredths of a degree; negative for a late packet, or jitter."""
    forward = _forward(before, after)
    back = forward > _TURN // 2 and forward > _FASTEST_PER_NS * _elapsed_ns(before, after)
    return forward - _TURN if back else forward


def _pause(before: Packet, after: Packet, advance: int, turn_ns: float) -> bool:
    """Return whether more time has passed between two packets than the lidar needed, by both clocks.

    Hosts stamp late in bursts, and the lidar's clock may jump: a pause shows in both.
    """
    needed_ns = max(0, advance) / _TURN * turn_ns
    device_ns = (after.device_us - before.device_us) % _HOUR_US * 1000
    host_ns = after.host_ns - before.host_ns
    return host_ns - needed_ns > LONGEST_PAUSE_NS and not 0 < device_ns <= needed_ns + LONGEST_PAUSE_NS


def _spin(packets: Sequence[Packet]) -> Spin:
    """Return the spin of the lidar that sent these consecutive packets."""
    small_ns = small = turned = 0
    jumps: list[tuple[int, int, int]] = []
    for before, after in pairwise(packets):
        advance, elapsed_ns = _advance(before, after), _elapsed_ns(before, after)
        turned += advance
        if advance > _MOST_MISSING:
            jumps.append((before.azimuth, advance, elapsed_ns))
        elif advance > 0 and 0 < elapsed_ns <= LONGEST_PAUSE_NS:
            small_ns, small = small_ns + elapsed_ns, small + advance
    turn_ns = small_ns / small * _TURN if small else _SLOWEST_TURN_NS
    arcs = [
        (begin, width)
        for begin, width, elapsed_ns in jumps
        if abs(elapsed_ns - width / _TURN * turn_ns) <= LONGEST_PAUSE_NS
    ]
    return Spin(turn_ns, _blind_arc(arcs, turned / _TURN))


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
