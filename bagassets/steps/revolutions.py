"""Cutting a stream of Velodyne packets into revolutions.

A packet belongs to the revolution in which its first block was fired: the cut is as fine as a
packet is long (0.6 degrees for a VLS-128 at 10 Hz, 5 for a VLP-16). Azimuth is the lidar's own,
clockwise from the x axis of its frame.

A revolution is complete if no more than `MOST_MISSING_DEG` of it are missing in one piece, at
its begin, at its end or inside. The first and the last one of a recording therefore count only
if the recording started or ended close to the cut.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bagassets.decode.velodyne import Packet

__all__ = ["Revolution", "RevolutionCutter", "packet_times_ns"]

MOST_MISSING_DEG = 20.0
# Packets follow each other within 2 ms. After a pause of 20 ms (36 degrees at 5 Hz, the slowest
# speed) a revolution has a hole; and whole ones may be missing that azimuth cannot tell.
LONGEST_PAUSE_NS = 20_000_000
# A lidar at 5 Hz takes 0.2 s; after this long without passing the cut it does not spin.
LONGEST_REVOLUTION_NS = 500_000_000

_TURN = 36_000  # hundredths of a degree
_HOUR_US = 3_600_000_000


@dataclass(slots=True)
class Revolution:
    """Packets between two cuts.

    Attributes:
        packets: in the order in which they were recorded.
        azimuths: of each packet, hundredths of a degree after the cut.
        log_times_ns: of the message that brought each packet.
        next_packet: the packet after the cut; None if none followed without a pause.
    """

    packets: list[Packet] = field(default_factory=list)
    azimuths: list[int] = field(default_factory=list)
    log_times_ns: list[int] = field(default_factory=list)
    next_packet: Packet | None = None

    @property
    def missing_deg(self) -> float:
        """The widest part of the turn that no packet covers, in degrees."""
        edges = np.array([0, *self.azimuths, _TURN], dtype=np.int64)
        steps = np.diff(edges)
        width = int(np.sort(steps[1:-1])[(len(steps) - 2) // 2]) if len(steps) > 2 else 0
        # A packet covers the step that follows it; nothing covers what is before the first.
        return max(int(steps[0]), int(steps[1:].max()) - width) / 100.0

    @property
    def complete(self) -> bool:
        """Tell whether (nearly) the whole turn was recorded."""
        return self.missing_deg <= MOST_MISSING_DEG

    def times_ns(self) -> tuple[NDArray[np.int64], int]:
        """Return the time of each packet's first firing, and the time of the end of the turn.

        The end is when the next revolution starts, or one (median) packet after the last.
        """
        following = [] if self.next_packet is None else [self.next_packet]
        times = packet_times_ns([*self.packets, *following])
        if self.next_packet is not None:
            return times[:-1], int(times[-1])
        step = int(np.sort(np.diff(times))[(len(times) - 1) // 2]) if len(times) > 1 else 0
        return times, int(times[-1]) + step


def packet_times_ns(packets: Sequence[Packet]) -> NDArray[np.int64]:
    """Return when each of some consecutive packets was measured, (N,) on the host's clock.

    The host's stamps carry the jitter of network and driver, often a millisecond; the lidar's
    own microseconds do not. So differences come from the lidar, and the offset between both
    clocks is the median over the packets. Where the lidar's clock does not run (as in
    data that were made up), the host's stamps stand for themselves.
    """
    host = np.array([packet.host_ns for packet in packets], dtype=np.int64)
    device = np.array([packet.device_us for packet in packets], dtype=np.int64)
    steps_us = np.diff(device) % _HOUR_US
    if not ((steps_us > 0) & (steps_us * 1000 <= LONGEST_PAUSE_NS)).all():
        return host
    since_first = np.concatenate([[0], np.cumsum(steps_us) * 1000])
    offset = np.sort(host - since_first)[(len(host) - 1) // 2]
    return np.asarray(since_first + offset)


class RevolutionCutter:
    """Collects packets and hands out a revolution whenever one ends.

    Args:
        cut_angle_deg: azimuth at which revolutions begin.
    """

    def __init__(self, cut_angle_deg: float) -> None:
        self._cut = round(cut_angle_deg * 100) % _TURN
        self._current = Revolution()

    def push(self, packet: Packet, log_time_ns: int) -> Revolution | None:
        """Take the next packet; return the revolution that ended before it, if one did."""
        azimuth = (packet.azimuth - self._cut) % _TURN
        ended = None
        current = self._current
        if current.packets:
            paused = _pause(current.packets[-1], packet)
            wrapped = current.azimuths[-1] - azimuth > _TURN // 2
            stuck = packet.host_ns - current.packets[0].host_ns > LONGEST_REVOLUTION_NS
            if paused or wrapped or stuck:
                ended = current
                ended.next_packet = packet if wrapped and not paused else None
                current = self._current = Revolution()
        current.packets.append(packet)
        current.azimuths.append(azimuth)
        current.log_times_ns.append(log_time_ns)
        return ended

    def flush(self) -> Revolution | None:
        """Return what has been collected since the last cut, if anything."""
        ended, self._current = self._current, Revolution()
        return ended if ended.packets else None


def _pause(before: Packet, after: Packet) -> bool:
    """Tell whether packets are missing between two, by either clock.

    Hosts stamp late in bursts, and the lidar's clock may jump: a pause is what both show.
    """
    device_ns = (after.device_us - before.device_us) % _HOUR_US * 1000
    host_ns = after.host_ns - before.host_ns
    return host_ns > LONGEST_PAUSE_NS and not 0 < device_ns <= LONGEST_PAUSE_NS
