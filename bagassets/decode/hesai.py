"""Packets of Hesai lidars: which model sent them, what their correction file says, and points from their packets.

A packet holds some blocks. A block is what each channel measured once: an azimuth in hundredths of a degree, clockwise from
the y axis of the lidar's frame, and distances and reflectivities. With several returns, as many blocks that follow each other
are of one firing. Where the channels point is in the correction file of each lidar, a table of elevations and azimuths.

Layouts and firing times: Hesai's user manuals and the tables of its SDK, which applies no parallax and no turning within a
block unless told to; neither do we.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.packets import PacketPoints, Packets
from bagassets.geometry.kernels.returns import ALL_AZIMUTHS
from bagassets.geometry.portable import sin_cos_deg

_Times = NDArray[np.int64]

_MOST_TRAILING = 36  # bytes after a packet: its number, and a signature
_HOUR_US = 3_600_000_000
_40P_UNIT_MM = 4
# Return mode -> returns of a firing.
_RETURNS = {0x33: 1, 0x34: 1, 0x37: 1, 0x38: 1, 0x39: 2, 0x3A: 2, 0x3B: 2, 0x3C: 2, 0x3D: 3, 0x3E: 2}
_Fields = list[tuple[str, str] | tuple[str, str, int]]

# Before the blocks, by number of bytes, and where in it the numbers of channels and blocks are.
_HEADS: Mapping[int, _Fields] = {
    0: [],
    8: [("", "V5"), ("unit_mm", "u1"), ("", "V2")],
    12: [("", "V9"), ("unit_mm", "u1"), ("", "V2")],
}
_NUMBERS_AT = {8: 2, 12: 6}
# After the blocks; a second follows its minute.
_TAIL: _Fields = [("", "V10"), ("us", "<u4"), ("mode", "u1"), ("", "V5"), ("minute", "u1", 2)]
_QT_TAIL: _Fields = [("", "V12"), *_TAIL[1:]]
_XT_TAIL: _Fields = [
    ("", "V10"), ("mode", "u1"), ("", "V6"), ("minute", "u1", 2), ("us", "<u4"), ("", "V1")
]  # fmt: skip
_QT128_TAIL: _Fields = [
    ("", "V26"), ("loop", "u1"), ("", "V6"), ("mode", "u1"), ("", "V6"), ("minute", "u1", 2), ("us", "<u4"), ("", "V9")
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class HesaiModel:
    """What the packets of a model are like.

    Attributes:
        name: of the model.
        head: bytes before the blocks.
        blocks: in a packet.
        return_size: bytes of a return.
        tail: what follows the blocks.
        block_ns: from the time of a packet to its last firing, or its first one; and from one firing to the next.
        from_last: its last one.
        channels_ns: (L, C) when each channel fires after that, in each loop of firings.
    """

    name: str
    head: int
    blocks: int
    return_size: int
    tail: _Fields
    block_ns: tuple[int, int]
    from_last: bool
    channels_ns: _Times

    @property
    def channels(self) -> int:
        """How many there are."""
        return int(self.channels_ns.shape[1])

    @cached_property
    def packet(self) -> np.dtype[np.void]:
        """The layout of a packet."""
        one_return = [("distance", "<u2"), ("reflectivity", "u1"), ("", f"V{self.return_size - 3}")]
        mark = [] if self.head else [("", "V2")]
        block = [*mark, ("azimuth", "<u2"), ("returns", one_return, self.channels)]
        return np.dtype([*_HEADS[self.head], ("blocks", block, self.blocks), *self.tail])

    def packet_in(self, payload: bytes) -> bytes | None:
        """Return the packet of this model in a payload; None if there is none."""
        size, at = self.packet.itemsize, _NUMBERS_AT.get(self.head)
        begin = b"\xff\xee" if at is None else b"\xee\xff"
        fits = at is None or payload[at : at + 2] == bytes([self.channels, self.blocks])
        fits &= payload[:2] == begin and 0 <= len(payload) - size <= _MOST_TRAILING
        return payload[:size] if fits else None

    def firings_ns(self, returns: int) -> _Times:
        """Return (L, F, C) when the channels fire in each firing of a packet, after the time of the packet."""
        first_ns, step_ns = self.block_ns
        number = np.arange(self.blocks // returns)
        turns_ns = first_ns + step_ns * (number - number[-1] if self.from_last else number)
        loops = np.arange(len(self.channels_ns))
        loop = (loops[:, None] + number) % len(loops)  # they follow each other
        return np.asarray(self.channels_ns[loop] + turns_ns[:, None])


def _us(times_us: str) -> _Times:
    """Return (1, C) of so many times of firing."""
    return np.rint(np.array([times_us.split()], dtype=np.float64) * 1000).astype(np.int64)


def _steps(number: int, step_ns: int) -> _Times:
    return step_ns * np.arange(number)[None, :]


def _qt128() -> _Times:
    """Return (2, 128) times of a QT128: 32 times three channels fire, 32 to 127 in the first loop, all but 32 to 63 in the other.

    Channels that do not fire have a time of 0.
    """
    pairs = np.array([[0, 7], [2, 5], [3, 4], [1, 6]])
    order = [
        [pair + 8 * four for two in which for four in range(4) for pair in pairs[two]]
        for which in ([0, 1, 2, 3], [1, 0, 3, 2])
    ]
    one, other = np.array(order)
    found = np.zeros((2, 128), dtype=np.int64)
    begins_ns = 600 + 3168 * np.arange(32)
    for loop, channels in enumerate(([96 + other, 64 + one, 32 + other], [64 + one, 96 + other, one])):
        for number, which in enumerate(channels):
            found[loop, which] = begins_ns + 856 * number
    return found


_40P_US = """-42.22 -28.47 -16.04 -3.62 -45.49 -31.74 -47.46 -54.67 -20.62 -33.71 -40.91 -8.19 -20.62 -27.16 -50.73 -8.19 -14.74
-36.98 -45.49 -52.7 -23.89 -31.74 -38.95 -11.47 -18.65 -25.19 -48.76 -6.23 -12.77 -35.01 -21.92 -9.5 -43.52 -29.77 -17.35 -4.92
-42.22 -28.47 -16.04 -3.62"""
_64_US = """-23.18 -21.876 -20.572 -19.268 -17.964 -16.66 -11.444 -46.796 -7.532 -36.956 -50.732 -54.668 -40.892 -44.828 -31.052
-34.988 -48.764 -52.7 -38.924 -42.86 -29.084 -33.02 -46.796 -25.148 -36.956 -50.732 -27.116 -40.892 -44.828 -31.052 -34.988
-48.764 -25.148 -38.924 -42.86 -29.084 -33.02 -52.7 -6.228 -54.668 -15.356 -27.116 -10.14 -23.18 -4.924 -21.876 -14.052 -17.964
-8.836 -19.268 -3.62 -20.572 -12.748 -16.66 -7.532 -11.444 -6.228 -15.356 -10.14 -4.924 -3.62 -14.052 -8.836 -12.748"""
_QT64_US = """2.31 4.37 6.43 8.49 10.54 12.6 14.66 16.71 19.16 21.22 23.28 25.34 27.39 29.45 31.5 33.56 36.61 38.67 40.73 42.78 44.84
46.9 48.95 51.01 53.45 55.52 57.58 59.63 61.69 63.74 65.8 67.86 70.9 72.97 75.02 77.08 79.14 81.19 83.25 85.3 87.75 89.82 91.87
93.93 95.98 98.04 100.1 102.15 105.2 107.26 109.32 111.38 113.43 115.49 117.54 119.6 122.05 124.11 126.17 128.22 130.28 132.34
134.39 136.45"""
MODELS = (
    HesaiModel("Pandar40P", 0, 10, 3, _TAIL, (-28_580, 55_560), True, _us(_40P_US)),
    HesaiModel("Pandar64", 8, 6, 3, _TAIL, (-42_580, 55_560), True, _us(_64_US)),
    HesaiModel("QT64", 12, 4, 4, _QT_TAIL, (25_710, 166_667), False, _us(_QT64_US)),
    HesaiModel("XT16", 12, 8, 4, _XT_TAIL, (6_000, 50_000), True, _steps(16, 3_024)),
    HesaiModel("XT32", 12, 8, 4, _XT_TAIL, (6_000, 50_000), True, _steps(32, 1_512)),
    HesaiModel("XT32M2X", 12, 6, 4, _XT_TAIL, (6_000, 50_000), True, np.tile(_steps(16, 2_888), 2)),
    HesaiModel("QT128", 12, 2, 4, _QT128_TAIL, (9_000, 111_110), False, _qt128()),
)
MODEL_NAMES = ", ".join(model.name for model in MODELS)


def packet_and_model(payload: bytes) -> tuple[bytes, HesaiModel] | None:
    """Return the data packet in a payload, and the model that sent it; None if there is none of a known model."""
    found = ((model.packet_in(payload), model) for model in MODELS)
    return next(((packet, model) for packet, model in found if packet is not None), None)


def corrections_beside(topic: str) -> str:
    """Return the topic on which Hesai's driver publishes the correction file of the lidar whose packets are on another."""
    return f"{topic.rpartition('/')[0]}/lidar_corrections"


class HesaiPackets(Packets):
    """Packets of one model."""

    @cached_property
    def device_us(self) -> NDArray[np.int64]:
        """The lidar's own times (N,), microseconds since the top of the hour."""
        minutes, seconds = self.data["minute"].astype(np.int64).T
        return np.asarray((60 * minutes + seconds) * 1_000_000 + self.data["us"])

    @classmethod
    def of(cls, host_ns: NDArray[np.int64], data: NDArray[np.void], *, by_log_time: bool) -> Self:
        """Return packets, of which those of one message may have one time: that of the first, or of the last by log time."""
        packets = cls(host_ns, data)
        firsts = np.flatnonzero(np.diff(host_ns, prepend=-1))
        message = np.repeat(np.arange(len(firsts)), np.diff(firsts, append=len(host_ns)))
        marks = np.append(firsts[1:], len(host_ns)) - 1 if by_log_time else firsts
        apart_us = packets.device_us - packets.device_us[marks[message]] + _HOUR_US // 2
        return cls(host_ns + (apart_us % _HOUR_US - _HOUR_US // 2) * 1000, data)


@dataclass(frozen=True)
class HesaiLidar:
    """A lidar whose packets can be decoded.

    Attributes:
        model: which one it is.
        angles_deg: elevation and azimuth of each channel.
    """

    model: HesaiModel
    angles_deg: tuple[tuple[float, float], ...]

    @classmethod
    def parse(cls, model: HesaiModel, text: bytes) -> Self:
        """Read a correction file: lines of a channel, its elevation and its azimuth in degrees; other lines are left out.

        Raises:
            DecodeError: it does not have one such line for each channel.
        """
        found: dict[int, tuple[float, float]] = {}
        lines = text.decode("utf-8-sig", "replace").splitlines()
        for fields in (line.split(",") for line in lines):
            try:
                channel, elevation_deg, azimuth_deg = int(fields[0]), float(fields[1]), float(fields[2])
            except (IndexError, ValueError) as err:  # titles, a checksum
                if "elevation" in ",".join(fields[2:]).lower():
                    raise DecodeError(f"its second column is not the elevation: {','.join(fields)}") from err
                continue
            if channel in found:
                raise DecodeError(f"it has channel {channel} twice")
            found[channel] = (elevation_deg, azimuth_deg)
        if sorted(found) != list(range(1, model.channels + 1)):
            raise DecodeError(f"it lacks channel,elevation,azimuth of each of {model.channels} channels")
        if not (np.abs([*found.values()]) <= 360).all():
            raise DecodeError("its angles are not degrees")
        return cls(model, tuple(found[channel] for channel in sorted(found)))

    def refusals(self, data: NDArray[np.void]) -> Mapping[int, str]:
        """Return index -> reason of those of the (N,) packets that cannot be decoded."""
        returns = _returns(data)
        faults = {
            "its packet has azimuths beyond a turn": (data["blocks"]["azimuth"] >= ALL_AZIMUTHS).any(axis=1),
            "its packet has an unknown return mode": (returns == 0)
            | (self.model.blocks % np.maximum(returns, 1) != 0),
            "its packet has no unit of distances": data["unit_mm"] == 0 if self.model.head else returns < 0,
        }
        return {index: why for why, found in faults.items() for index in np.flatnonzero(found).tolist()}

    def decode(self, packets: Packets, times_ns: NDArray[np.int64]) -> PacketPoints:
        """Decode the returns in `packets`, whose times were (N,) `times_ns`.

        All returns of a firing are points; equal ones count once. Intensity is the reflectivity; rings count from the lowest
        channel.
        """
        returns = _returns(packets.data)
        parts = []
        for number in np.unique(returns).tolist():
            which = returns == number
            parts.append(self._decode(packets.data[which], times_ns[which], number))
        points, found_ns = zip(*parts, strict=True)
        begin_ns = int(self.model.firings_ns(int(returns[0]))[:, 0].min())
        return PacketPoints(np.concatenate(points), np.concatenate(found_ns), begin_ns)

    def _decode(
        self, data: NDArray[np.void], times_ns: _Times, returns: int
    ) -> tuple[NDArray[np.float32], _Times]:
        """Return the points of packets with so many returns of a firing, and their times."""
        angles_deg = np.array(self.angles_deg)
        order = angles_deg[:, 0].argsort(kind="stable")  # from the lowest channel
        firings = data["blocks"].reshape(len(data), -1, returns)
        # All of a firing follow each other, the lowest channel first, and all returns of a channel.
        raw = firings["returns"][..., order].swapaxes(2, 3)
        distances, reflectivities = raw["distance"], raw["reflectivity"]
        hit = distances > 0
        for late in range(1, returns):
            for early in range(late):
                alike = distances[..., early] == distances[..., late]
                hit[..., late] &= ~(alike & (reflectivities[..., early] == reflectivities[..., late]))
        packet, firing, channel, _ = hit.nonzero()
        sin_block, cos_block = sin_cos_deg(firings["azimuth"][..., 0] * 0.01)
        (sin_up, cos_up), (sin_beside, cos_beside) = (sin_cos_deg(one) for one in angles_deg[order].T)
        sin_b, cos_b = sin_block[packet, firing], cos_block[packet, firing]
        sin_c, cos_c = sin_beside[channel], cos_beside[channel]
        unit_mm = data["unit_mm"][packet].astype(np.float64) if self.model.head else _40P_UNIT_MM
        distances_m = distances[hit] * unit_mm * 0.001
        flat_m = distances_m * cos_up[channel]
        points = np.empty((len(packet), 5), dtype=np.float32)
        points[:, 0] = flat_m * (sin_b * cos_c + cos_b * sin_c)
        points[:, 1] = flat_m * (cos_b * cos_c - sin_b * sin_c)
        points[:, 2] = distances_m * sin_up[channel]
        points[:, 3] = reflectivities[hit]
        points[:, 4] = channel
        firings_ns = self.model.firings_ns(returns)[..., order]
        loops = len(firings_ns)
        loop = (data["loop"][packet] + 1) % loops if loops > 1 else 0
        return points, times_ns[packet] + firings_ns[loop, firing, channel]


def _returns(data: NDArray[np.void]) -> NDArray[np.int64]:
    """Return (N,) returns of a firing, 0 if not known."""
    table = np.zeros(256, dtype=np.int64)
    table[list(_RETURNS)] = list(_RETURNS.values())
    return np.asarray(table[data["mode"]])
