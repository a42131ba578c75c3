"""Velodyne data packets: telling them from others, and decoding a revolution of them into points.

A data packet is the 1206-byte UDP payload that all Velodyne spinning lidars send: twelve blocks
of flag, azimuth and 32 returns, a 32-bit time in microseconds since the top of the hour, the
return mode and the product id (VLP-16 User Manual 63-9243 Rev. E, section 9.3). It comes in
`velodyne_msgs/VelodyneScan` (many packets a message) or in messages that hold one payload, such
as `ethernet_msgs/Packet`.

The arithmetic is that of velodyne-decoder, which brings factory calibrations and firing times; where there is machine
code (`bagassets.geometry.kernels.returns`) it does the same in a tenth of the time. Both use times of our own: what the library
would make of the packets' microseconds and a floating-point host time is a quarter of a microsecond off, and follows the
lidar's clock instead of the recipe's. Its tables of sines are the C library's in single precision: the one thing here
that another library or processor might round differently.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import velodyne_decoder
from numpy.typing import NDArray
from velodyne_decoder.velodyne_decoder_pylib import TimePair

from bagassets.base.errors import DecodeError, RecipeError
from bagassets.decode.packets import PacketPoints, Packets
from bagassets.decode.velodyne_lasers import Head, all_azimuths, head_of
from bagassets.geometry.kernels.returns import ALL_AZIMUTHS, BANK_FLAGS, RETURNS, Angles, take_returns

POSITION_PACKET_SIZE = 512  # NMEA sentences and temperatures, sent to another port of the same host

# Packets decoded at a time: the times of their returns count from the first one, in single precision.
_CHUNK = 64

_Model = velodyne_decoder.Model
# Name without punctuation -> model, product id in its packets.
_MODELS: dict[str, tuple[object, int]] = {
    "HDL32E": (_Model.HDL32E, 0x21),
    "VLP16": (_Model.VLP16, 0x22),
    "PUCK": (_Model.VLP16, 0x22),
    "PUCKLITE": (_Model.VLP16, 0x22),
    "PUCKHIRES": (_Model.PuckHiRes, 0x24),
    "VLP16HIRES": (_Model.PuckHiRes, 0x24),
    "VLP32A": (_Model.VLP32A, 0x23),
    "VLP32B": (_Model.VLP32B, 0x23),
    "VLP32C": (_Model.VLP32C, 0x28),
    "VLS128": (_Model.VLS128, 0xA1),
    "ALPHAPRIME": (_Model.VLS128, 0xA1),
}
# Product id -> model, if there is one only; VLP-32A and VLP-32B share theirs.
_SELF_EXPLANATORY = {product: model for model, product in _MODELS.values() if product != 0x23}
MODEL_NAMES = "HDL-32E, VLP-16, Puck Hi-Res, VLP-32A, VLP-32B, VLP-32C, VLS-128"


class PacketFilter:
    """Tells what is no data packet of the lidar.

    Args:
        model: name of the model; None to go by the product id of the first packet.

    Raises:
        RecipeError: there is no such model.
    """

    def __init__(self, model: str | None) -> None:
        self._product = None if model is None else _model(model)[1]

    def refusals(self, data: NDArray[np.void]) -> dict[int, str]:
        """Return index -> reason of those of the (N,) `PACKET` that are no data packets of the lidar."""
        begins = data["blocks"][:, 0]
        reasons = dict.fromkeys(
            np.flatnonzero((begins["flag"] != BANK_FLAGS[0]) | (begins["azimuth"] >= ALL_AZIMUTHS)).tolist(),
            "its packet does not start with the flag and azimuth of a Velodyne block",
        )
        products = data["product"]
        if self._product is None:
            for index, product in enumerate(products.tolist()):
                if index in reasons:
                    continue
                if product in _SELF_EXPLANATORY:
                    self._product = product
                    break
                reasons[index] = (
                    f"its packet does not tell the model of the lidar; set `model` to one of {MODEL_NAMES}"
                )
        if self._product is not None:
            for index in np.flatnonzero(products != self._product).tolist():
                reasons.setdefault(index, "its packet is of another Velodyne model than the channel's")
        return reasons


class RevolutionDecoder:
    """Decodes packets into points. Use one per stream, because VLS-128 firing times are learnt from its packets.

    Args:
        model: as for `PacketFilter`.
    """

    def __init__(self, model: str | None) -> None:
        self._model = None if model is None else _model(model)[0]
        self._decoder: Callable[[NDArray[np.void], NDArray[np.int64], PacketPoints], int] | None = None
        self._room = PacketPoints.room(0)

    def decode(self, packets: Packets, times_ns: NDArray[np.int64]) -> PacketPoints:
        """Decode the returns in `packets`, whose first firings were at (M,) `times_ns`.

        Both returns of a dual-return lidar are points; equal ones count once. Intensity is the
        calibrated reflectivity, 0 to 255; rings count from the lowest laser.

        Returns:
            Points and times, which the next call writes over.

        Raises:
            DecodeError: the decoder refuses the packets.
        """
        if not len(packets):
            return PacketPoints.room(0)
        if self._decoder is None:
            turn, product = all_azimuths(), int(packets.data["product"][0])
            if turn is None:
                self._decoder = _Library(self._model).take
            else:
                head = head_of(self._model or _SELF_EXPLANATORY[product], product)
                self._decoder = partial(_take_by_machine_code, head, turn)
        if len(self._room.points) < len(packets) * RETURNS:
            self._room = PacketPoints.room(len(packets) * RETURNS)
        number = self._decoder(packets.data, times_ns, self._room)
        return PacketPoints(self._room.points[:number], self._room.times_ns[:number])


def _take_by_machine_code(
    head: Head, turn: Angles, packets: NDArray[np.void], times_ns: NDArray[np.int64], room: PacketPoints
) -> int:
    """As `_Library.take`, in a tenth of the time."""
    firsts_ns = np.repeat(times_ns[::_CHUNK], _CHUNK)[: len(packets)]
    since_s = ((times_ns - firsts_ns) * 1e-9).astype(np.float32)
    done = 0
    for part, lasers, rates in head.stretches(packets):
        done += take_returns(
            packets[part], since_s[part], firsts_ns[part], rates, lasers, turn,
            room.points[done:], room.times_ns[done:],
        )  # fmt: skip
    return done


class _Library:
    """velodyne-decoder itself."""

    def __init__(self, model: object) -> None:
        config = velodyne_decoder.Config(
            model=model,
            min_range=0.0,  # the step applies limits, and counts
            max_range=1e9,
            timestamp_first_packet=True,
        )
        self._decoder = velodyne_decoder.ScanDecoder(config)

    def take(self, packets: NDArray[np.void], times_ns: NDArray[np.int64], room: PacketPoints) -> int:
        """Fill in the first points of `room`, and their times; return their number.

        Args:
            packets: (M,) `PACKET`.
            times_ns: (M,)
            room: (N, 5) and (N,), for `RETURNS` of each packet, or more.
        """
        done = 0
        for first in range(0, len(packets), _CHUNK):
            part = slice(first, first + _CHUNK)
            cloud = self._decode(packets[part], times_ns[part] - times_ns[first])
            end = done + len(cloud)
            for column, name in enumerate(("x", "y", "z", "intensity", "ring")):
                room.points[done:end, column] = cloud[name]
            since_first_ns = np.rint(cloud["time"].astype(np.float64) * 1e9)
            room.times_ns[done:end] = since_first_ns.astype(np.int64) + times_ns[first]
            done = end
        return done

    def _decode(self, packets: NDArray[np.void], offsets_ns: NDArray[np.int64]) -> NDArray[np.void]:
        """Return the decoder's structured array, with times relative to the first packet."""
        vector = velodyne_decoder.PacketVector()
        for packet, offset_ns in zip(packets, offsets_ns.tolist(), strict=True):
            # The binding takes a list of (cached) integers faster than bytes, and 20 times faster
            # than an array.
            times = TimePair(0.0, offset_ns * 1e-9)
            vector.append(velodyne_decoder.VelodynePacket(times, list(packet.tobytes())))
        try:
            _, cloud = self._decoder.decode(vector, as_pcl_structs=True)
        except RuntimeError as err:
            raise DecodeError("velodyne-decoder refuses its packets") from err
        return np.asarray(cloud)


def _model(name: str) -> tuple[object, int]:
    plain = "".join(c for c in name.upper() if c.isalnum())
    if plain.startswith("HDL64"):
        raise RecipeError(
            f"model {name!r} cannot be read: its packets need the calibration of the single unit; record "
            "its point cloud, or convert the packets to PointCloud2."
        )
    try:
        return _MODELS[plain]
    except KeyError:
        raise RecipeError(
            f"model {name!r} is not a known Velodyne model; use one of {MODEL_NAMES}."
        ) from None
