"""Packets of Ouster lidars: what the lidar's metadata says of them, and points from the packets of a revolution.

A packet holds some columns. A column is what all beams measured at one angle of the encoder: its time by the lidar's clock, the
number of that angle in the turn (the measurement id), and ranges and reflectivities. How many columns and beams there are, which
bits are what (the profile), and where the beams point is in the metadata, a JSON text that the driver gets from the lidar and
publishes beside the packets.

Layouts of packets, and the way from range to point: Ouster, "Firmware User Manual", sections "Lidar data packet format" and "Lidar
range to XYZ". Points are in the lidar frame, `os_lidar` of the driver: x points to where the first column is measured, z up.
Ouster's own library does not fit beside the versions of rosbags and click that this package needs.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.geometry.portable import sin_cos_deg
from bagassets.geometry.se3 import Floats
from bagassets.recordings.model import Message

_MOST_PIXELS = 4096 * 512
_LEGACY, _FUSA = "LEGACY", "FUSA"
# Firmware 1 does not say how far from the axis beams begin: as Ouster's own library has it, by model.
_ORIGIN_MM, _ORIGIN_OF_FIRST_MM = {"OS-0": 27.67, "OS-1": 15.806, "OS-2": 13.762}, 12.163


class _Return(NamedTuple):
    """Where in the bytes of a pixel a return is: a 32-bit word with its range in the lowest bits, and its reflectivity."""

    word: int
    reflectivity: int


class _Profile(NamedTuple):
    """What a pixel is like: its bytes, returns, bits of a range, and millimetres that the range counts."""

    size: int
    returns: tuple[_Return, ...]
    bits: int = 19
    unit_mm: int = 1


_ONE, _TWO = (_Return(0, 4),), (_Return(0, 3), _Return(4, 7))
_LOW_RATE, _TWO_LOW_RATE = (_Return(0, 2),), (_Return(0, 2), _Return(4, 6))
_PROFILES = {
    _LEGACY: _Profile(12, _ONE, 20),
    "RNG19_RFL8_SIG16_NIR16": _Profile(12, _ONE),
    "RNG19_RFL8_SIG16_NIR16_ZONE16": _Profile(12, _ONE),
    "RNG19_RFL8_SIG16_NIR16_RGB16": _Profile(16, _TWO[:1]),
    "RNG19_RFL8_SIG16_NIR16_DUAL": _Profile(16, _TWO),
    "RNG19_RFL8_SIG16_ZONE16_DUAL": _Profile(16, _TWO),
    "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL": _Profile(20, _TWO),
    "RNG15_RFL8_NIR8": _Profile(4, _LOW_RATE, 15, 8),
    "RNG15_RFL8_WIN8": _Profile(4, _LOW_RATE, 15, 8),
    "RNG15_RFL8_NIR8_ZONE16": _Profile(8, _LOW_RATE, 15, 8),
    "RNG15_RFL8_NIR8_DUAL": _Profile(8, _TWO_LOW_RATE, 15, 8),
    "FUSA_RNG15_RFL8_NIR8_DUAL": _Profile(8, _TWO_LOW_RATE, 15, 8),
}


def packet_in(message: Message) -> bytes:
    """Return the bytes of the packet in a `PacketMsg`.

    Raises:
        DecodeError: it has none.
    """
    try:
        return memoryview(message.buf).tobytes()  # `bytes` would make as many as a number says
    except (AttributeError, TypeError, ValueError) as err:
        raise DecodeError("it has no field buf with the bytes of a packet") from err


def metadata_beside(topic: str) -> str:
    """Return the topic on which drivers publish the metadata of the lidar whose packets are on another."""
    return f"{topic.rpartition('/')[0]}/metadata"


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Columns in the order in which they were measured.

    Attributes:
        numbers: (N,) measurement ids.
        times_ns: (N,) when they were measured, by the lidar's clock.
        points: (M, 5) float32, as in `CloudReading`.
        of_points: (M,) the column of each point.
        without_return: how many shots of a beam came back from nowhere.
    """

    numbers: NDArray[np.int64]
    times_ns: NDArray[np.int64]
    points: NDArray[np.float32]
    of_points: NDArray[np.intp]
    without_return: int


@dataclass(frozen=True)
class OusterLidar:
    """What the metadata of an Ouster says.

    Attributes:
        profile: name of the profile, which says what is where in a pixel.
        columns: columns of a whole turn.
        columns_per_packet: of them, in each packet.
        window: first and last column that it reports; the first may come after the last.
        is_fusa: packets have the header for functional safety.
        altitudes_deg: of each beam, from the highest.
        azimuths_deg: of each beam, beside the angle of the encoder.
        origin_mm: where the beams begin: outwards from the lidar's axis, and up.
    """

    profile: str
    columns: int
    columns_per_packet: int
    window: tuple[int, int]
    is_fusa: bool
    altitudes_deg: tuple[float, ...]
    azimuths_deg: tuple[float, ...]
    origin_mm: tuple[float, float]

    @classmethod
    def parse(cls, text: str | bytes) -> Self:
        """Read metadata, in any form that drivers have written it.

        Raises:
            DecodeError: it is no metadata of a lidar whose packets can be read.
        """
        try:
            whole = json.loads(text)
            formats = (whole.get("lidar_data_format"), whole.get("data_format"))
            data: Mapping[str, Any] = next((one for one in formats if isinstance(one, dict)), {})
            beams: Mapping[str, Any] = whole.get("beam_intrinsics") or whole
            mode = (whole.get("config_params") or whole).get("lidar_mode") or "0x0"
            columns = int(data.get("columns_per_frame") or mode.split("x")[0])
            first, last = data.get("column_window") or (0, columns - 1)
            profile = str(data.get("udp_profile_lidar") or _LEGACY)
            altitudes = tuple(map(float, beams["beam_altitude_angles"]))
            azimuths = tuple(map(float, beams["beam_azimuth_angles"]))
            number = int(data.get("pixels_per_column") or len(altitudes))
            lidar = cls(
                profile,
                columns,
                int(data.get("columns_per_packet") or 16),
                (int(first), int(last)),
                profile.startswith(_FUSA) or (profile != _LEGACY and data.get("header_type") == _FUSA),
                altitudes,
                azimuths,
                _origin_mm(beams, (whole.get("sensor_info") or whole).get("prod_line")),
            )
        except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as err:
            raise DecodeError(f"it is no metadata of an Ouster ({type(err).__name__}: {err})") from err
        lidar._check(number)
        return lidar

    def _check(self, number: int) -> None:
        if self.profile not in _PROFILES:
            raise DecodeError(f"the profile {self.profile} of its packets cannot be read")
        if not len(self.altitudes_deg) == len(self.azimuths_deg) == number > 0:
            raise DecodeError(f"it does not have one altitude and one azimuth for each of {number} beams")
        pixels = self.columns * len(self.altitudes_deg)
        sizes_fit = 0 < self.columns_per_packet <= self.columns and pixels <= _MOST_PIXELS
        if not sizes_fit or not all(0 <= edge < self.columns for edge in self.window):
            raise DecodeError("its numbers of columns do not fit each other")
        if not np.isfinite([*self.altitudes_deg, *self.azimuths_deg, *self.origin_mm]).all():
            raise DecodeError("its angles are not finite")

    @cached_property
    def packet(self) -> np.dtype[np.void]:
        """The layout of a packet."""
        pixels = ("pixels", f"V{_PROFILES[self.profile].size}", (len(self.altitudes_deg),))
        if self.profile == _LEGACY:
            fields = [("time_ns", "<u8"), ("number", "<u2"), ("frame", "<u2"), ("encoder", "<u4"), pixels]
            return np.dtype([("columns", [*fields, ("status", "<u4")], (self.columns_per_packet,))])
        header = (
            [("", "V4"), ("frame", "<u4")] if self.is_fusa else [("", "V2"), ("frame", "<u2"), ("", "V4")]
        )
        fields = [("time_ns", "<u8"), ("number", "<u2"), ("status", "<u2"), pixels]
        columns = ("columns", fields, (self.columns_per_packet,))
        return np.dtype([*header, ("", "V24"), columns, ("", "V32")])

    def read(self, data: bytes) -> NDArray[np.void]:
        """Return a packet, of type `packet`.

        Raises:
            DecodeError: it is none of this lidar.
        """
        if len(data) - self.packet.itemsize not in (0, 1):  # drivers before 2023 send a byte too many
            raise DecodeError(
                f"its packet has {len(data)} bytes, those of the metadata {self.packet.itemsize}; name the metadata of this lidar"
            )
        packet: NDArray[np.void] = np.frombuffer(data, self.packet, 1)[0]
        if packet["columns"]["number"][0] >= self.columns:
            raise DecodeError(f"its packet is of a lidar with more than {self.columns} columns")
        return packet

    @property
    def frames(self) -> int:
        """After so many turns their numbers begin again."""
        return 1 << (32 if self.is_fusa else 16)

    def frame_of(self, packet: NDArray[np.void]) -> int:
        """Return the number of the turn of a packet."""
        return int(packet["columns"]["frame"][0] if self.profile == _LEGACY else packet["frame"])

    def decode(self, packets: NDArray[np.void]) -> Columns:
        """Return what is in (N,) `packet`, without columns that the lidar marks as invalid; a column counts once."""
        columns = packets["columns"].reshape(-1)
        valid = columns["status"] == 0xFFFFFFFF if self.profile == _LEGACY else columns["status"] & 1 == 1
        columns = columns[valid & (columns["number"] < self.columns)]
        _, firsts = np.unique(columns["number"], return_index=True)
        columns = columns[np.sort(firsts)]
        columns = columns[np.argsort(columns["time_ns"], kind="stable")]
        numbers = columns["number"].astype(np.int64)
        size, returns, bits, unit_mm = _PROFILES[self.profile]
        shape = (*columns["pixels"].shape, size)
        pixels = np.ascontiguousarray(columns["pixels"]).view(np.uint8).reshape(shape)
        words = [pixels[..., one.word : one.word + 4].copy().view("<u4")[..., 0] for one in returns]
        # All of a column follow each other, the lowest beam first, and both returns of a beam.
        ranges = np.stack([word & ((1 << bits) - 1) for word in words], axis=-1)[:, ::-1] * np.uint32(unit_mm)
        reflectivities = np.stack([pixels[..., one.reflectivity] for one in returns], axis=-1)[:, ::-1]
        hit = ranges > 0
        hit[..., 1:] &= ranges[..., 1:] != ranges[..., :1]  # the same return twice
        column, beam, _ = np.nonzero(hit)
        points = np.empty((len(column), 5), dtype=np.float32)
        points[:, :3] = self._places(ranges[hit], numbers[column], beam)
        points[:, 3] = reflectivities[hit]
        points[:, 4] = beam
        without_return = int((~ranges.any(axis=-1)).sum())
        return Columns(numbers, columns["time_ns"].astype(np.int64), points, column, without_return)

    def _places(
        self, ranges_mm: NDArray[np.uint32], columns: NDArray[np.int64], beams: NDArray[np.intp]
    ) -> Floats:
        """Return (N, 3) places in the lidar frame, metres; beams count from the lowest."""
        cos_column, sin_column, cos_beam, sin_beam, cos_altitude, sin_altitude = self._angles
        out_mm, up_mm = self.origin_mm
        distance_mm = ranges_mm - sqrt(out_mm * out_mm + up_mm * up_mm)
        cos_c, sin_c = cos_column[columns], sin_column[columns]
        cos_b, sin_b = cos_beam[beams], sin_beam[beams]
        flat_mm = distance_mm * cos_altitude[beams]
        places_mm = [
            flat_mm * (cos_c * cos_b - sin_c * sin_b) + out_mm * cos_c,
            flat_mm * (sin_c * cos_b + cos_c * sin_b) + out_mm * sin_c,
            distance_mm * sin_altitude[beams] + up_mm,
        ]
        return np.stack(places_mm, axis=1) * 0.001

    @cached_property
    def _angles(self) -> tuple[Floats, ...]:
        """Cosines and sines of each column's angle, of the beams' azimuths, and of their altitudes; the lidar turns clockwise."""
        turned_deg = np.arange(self.columns, dtype=np.float64) * (360.0 / self.columns)
        sin_column, cos_column = sin_cos_deg(-turned_deg)
        sin_beam, cos_beam = sin_cos_deg(-np.array(self.azimuths_deg[::-1]))
        sin_altitude, cos_altitude = sin_cos_deg(np.array(self.altitudes_deg[::-1]))
        return cos_column, sin_column, cos_beam, sin_beam, cos_altitude, sin_altitude


def _origin_mm(beams: Mapping[str, Any], model: str | None) -> tuple[float, float]:
    transform: Sequence[float] | None = beams.get("beam_to_lidar_transform")
    if transform is not None:  # row by row
        return float(transform[3]), float(transform[11])
    default_mm = _ORIGIN_MM.get(str(model)[:4], _ORIGIN_OF_FIRST_MM)
    return float(beams.get("lidar_origin_to_beam_origin_mm", default_mm)), 0.0
