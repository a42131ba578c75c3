"""The lasers of each Velodyne model as tables, and how fast its head turns, as velodyne-decoder has them.

Angles come from its factory calibrations. When each laser fires, and which ring it is, is seen in a packet that it
decodes.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import velodyne_decoder
import yaml
from numpy.typing import NDArray
from velodyne_decoder.velodyne_decoder_pylib import TimePair

from bagassets.geometry.kernels.returns import (
    ALL_AZIMUTHS,
    BANK_FLAGS,
    DUAL,
    LASERS,
    PACKET,
    Angles,
    Floats,
    Lasers,
)

_Stretch = tuple[slice, Lasers, Floats]
"""Packets, their lasers, and for each one how fast the head turned, in hundredths of a degree a second."""

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_CORRECTIONS = ("rot_correction", "vert_correction", "vert_offset_correction")
_STRONGEST = 0x37  # a return mode

_ALPHA_PRIME = velodyne_decoder.Model.VLS128
# Seconds from one group of lasers to the next, since firmware 5.2.3.0 and before, as in VeloView. Packets that are 153 to
# 180 us apart tell which it is.
_GROUP_S, _OLD_GROUP_S = 2.89 * 1e-6, 8.0 / 3.0 * 1e-6
_LEAST_US, _OLD_US, _MOST_US = 153, 167, 180
_MOST_FASTER = np.float32(1.8)  # than in the packet before; else packets were lost in between


@cache
def all_azimuths() -> Angles | None:
    """Return cosines and sines of each hundredth of a degree; None if there is no machine code."""
    turn = np.arange(ALL_AZIMUTHS, dtype=np.float32)
    return Angles.of(np.float32(0.01) * turn * np.float32(np.pi / 180.0))


class Head:
    """The turning head of a lidar with up to 32 lasers.

    Args:
        lasers: of its model.
    """

    def __init__(self, lasers: Lasers) -> None:
        self.lasers = lasers

    def stretches(self, packets: NDArray[np.void]) -> Iterator[_Stretch]:
        """Return the next (M,) `PACKET`, in runs during which the lasers fire alike."""
        azimuths, times_s = packets["blocks"]["azimuth"], self.lasers.times_s
        last = np.where(packets["mode"] == DUAL, 5, 11)
        lasts_s = times_s[last, 0] - times_s[0, 0]
        yield slice(0, len(packets)), self.lasers, _turned(azimuths[:, 0], azimuths[:, 11]) / lasts_s


class _AlphaPrimeHead(Head):
    """The head of a VLS-128: its firing times depend on the firmware, and a packet is too short to show how fast it turns.

    Both are learnt from packets that follow each other.
    """

    def __init__(self, lasers: Lasers) -> None:
        super().__init__(lasers)
        self._knows_firmware = False
        self._last: tuple[np.uint32, np.uint16] | None = None  # time and azimuth of the last packet
        self._rate = np.float32(0)

    def stretches(self, packets: NDArray[np.void]) -> Iterator[_Stretch]:
        """Return the next packets, in runs during which the lasers fire alike."""
        times_us, azimuths = packets["us"], packets["blocks"]["azimuth"][:, 0].copy()
        last_us, last_azimuth = self._last or (times_us[0], azimuths[0])
        self._last = times_us[-1], azimuths[-1]
        turned = _turned(np.append(last_azimuth, azimuths[:-1]), azimuths)
        dual = packets["mode"] == DUAL  # three times as many packets
        learnt = 0
        if not self._knows_firmware:
            apart_us = np.diff(times_us, prepend=last_us) * np.where(dual, 3, 1).astype(np.uint32)
            telling = np.flatnonzero((apart_us > _LEAST_US) & (apart_us < _MOST_US))
            learnt = int(telling[0]) if len(telling) else len(packets)
            yield self._stretch(slice(0, learnt), turned, dual)
            if len(telling):
                self._learn_firmware(int(apart_us[learnt]))
        yield self._stretch(slice(learnt, len(packets)), turned, dual)

    def _learn_firmware(self, apart_us: int) -> None:
        self._knows_firmware = True
        group_s = _OLD_GROUP_S if apart_us < _OLD_US else _GROUP_S
        times_s = self.lasers.times_s * np.float32(group_s / _GROUP_S)
        self.lasers = replace(
            self.lasers, times_s=times_s, turning_s=times_s - _firings_s(times_s, len(BANK_FLAGS))
        )

    def _stretch(self, part: slice, turned: Floats, dual: NDArray[np.bool_]) -> _Stretch:
        times_s = self.lasers.times_s
        firing_s = times_s[4, 0] - times_s[0, 0]
        rates = turned[part] / np.where(dual[part], firing_s, np.float32(3) * firing_s)
        limits = np.append(self._rate, rates[:-1]) * _MOST_FASTER
        if np.any((limits > 0) & (rates > limits)):
            # Packets were lost: the head goes on as before.
            for index, rate in enumerate(rates):
                if self._rate > 0 and rate > self._rate * _MOST_FASTER:
                    rates[index] = self._rate
                self._rate = rates[index]
        elif len(rates):
            self._rate = rates[-1]
        return part, self.lasers, rates


def head_of(model: object, product: int) -> Head:
    """Return the head of a lidar before its first packet.

    Args:
        model: its `velodyne_decoder.Model`.
        product: its product id in packets.

    Raises:
        RuntimeError: there is no machine code.
    """
    lasers = _lasers(model, product)
    return _AlphaPrimeHead(lasers) if model == _ALPHA_PRIME else Head(lasers)


@cache
def _lasers(model: object, product: int) -> Lasers:
    banks = len(BANK_FLAGS) if model == _ALPHA_PRIME else 1
    calibration = yaml.load(velodyne_decoder.Calibration.default_calibs[model].to_string(), Loader=_LOADER)  # noqa: S506  (a safe one)
    found = [[laser[name] for name in _CORRECTIONS] for laser in calibration["lasers"]]
    # A block has two firings of a lidar with 16 lasers.
    azimuths, elevations, heights_m = np.resize(np.array(found, dtype=np.float32), (banks * LASERS, 3)).T
    turned, raised = Angles.of(azimuths), Angles.of(elevations)
    if turned is None or raised is None:
        raise RuntimeError("there is no machine code, so no head is needed")
    times_s, rings = _seen(model, product, banks)
    traits = (
        turned.cosines,
        turned.sines,
        raised.cosines,
        raised.sines,
        heights_m,
        rings.ravel()[: banks * LASERS],
    )
    return Lasers(
        traits=np.ascontiguousarray(np.stack(traits, axis=1).reshape(banks, LASERS, len(traits))),
        times_s=times_s,
        turning_s=times_s - _firings_s(times_s, banks),
        unit_m=np.full(1, calibration["distance_resolution"], dtype=np.float32),
        blocks_if_dual=8 if banks > 1 else 12,
        most_azimuth=ALL_AZIMUTHS if banks > 1 else 0xFFFF,
    )


def _seen(model: object, product: int, banks: int) -> tuple[Floats, Floats]:
    """Return (12, 32) times and rings of the returns of a packet of which each one measured something."""
    packet = np.zeros(1, dtype=PACKET)
    packet["blocks"]["flag"] = np.resize(BANK_FLAGS[:banks], 12)
    packet["blocks"]["returns"]["distance"] = 1
    packet["mode"], packet["product"] = _STRONGEST, product
    decoder = velodyne_decoder.ScanDecoder(velodyne_decoder.Config(model=model, min_range=0.0))
    sent = velodyne_decoder.VelodynePacket(TimePair(0.0, 0.0), list(packet.tobytes()))
    _, cloud = decoder.decode(velodyne_decoder.PacketVector([sent]), as_pcl_structs=True)
    found = np.asarray(cloud)
    return found["time"].reshape(12, LASERS).copy(), found["ring"].reshape(12, LASERS).astype(np.float32)


def _firings_s(times_s: Floats, banks: int) -> Floats:
    """Return (12, 1) when the firing of each block begins, of which a block has the returns of one bank."""
    return times_s[np.arange(12) // banks * banks, :1]


def _turned(before: NDArray[np.uint16], after: NDArray[np.uint16]) -> Floats:
    """Return how far the head turned between azimuths."""
    return ((after.astype(np.int32) - before + ALL_AZIMUTHS) % ALL_AZIMUTHS).astype(np.float32)
