"""Radar readings become `.pcd` files: one per message, or one per cycle of single tracks."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.asset import inlined, omitted
from bagassets.assets.radar_file import radar_bytes
from bagassets.assets.sweep_files import Motion, SensorSettings, SensorUse, SweepFiles
from bagassets.base.errors import DecodeError
from bagassets.decode.loading import keyed_decoder
from bagassets.decode.model import RadarReading
from bagassets.decode.radar import is_single_track, track_number
from bagassets.decode.radar_fields import Side
from bagassets.geometry.radar_motion import sensor_velocities
from bagassets.recordings.model import Message, RawMessage

Targets = dict[str, NDArray[np.float64]]

# An ESR sends its 64 tracks, one message each, every 50 ms; slower radars every 100 ms.
LONGEST_CYCLE_NS = 100_000_000


@dataclass(frozen=True, kw_only=True)
class RadarSettings(SensorSettings):
    """Settings of a radar in the recipe.

    Attributes:
        azimuth_positive: side on which recorded azimuths are positive; None for the side that the message type defines.
        velocities: what recorded velocities are; None as the message type defines it.
    """

    azimuth_positive: Side | None
    velocities: Literal["relative", "over_ground"] | None = omitted()


@dataclass(frozen=True, kw_only=True)
class RadarUse(SensorUse):
    """Everything besides its messages that shapes the files of a radar.

    Attributes:
        settings: its settings in the recipe.
    """

    modality: Literal["radar"] = "radar"
    # What the velocities are shows in whether there is a mount.
    settings: RadarSettings = inlined(without={"velocities"})


@dataclass(slots=True)
class _Sweep:
    """Targets of one or several messages that belong together."""

    stamp_ns: int
    log_time_ns: int
    radial: bool
    parts: int = 0
    targets: list[Targets] = field(default_factory=list)

    def add(self, targets: Targets, log_time_ns: int) -> None:
        self.parts += 1
        self.log_time_ns = log_time_ns
        if len(targets["x"]):
            self.targets.append(targets)

    @property
    def number(self) -> int:
        return sum(len(targets["x"]) for targets in self.targets)

    def joined(self) -> Targets:
        if not self.targets:
            return {"x": np.zeros(0), "y": np.zeros(0)}
        return {name: np.concatenate([part[name] for part in self.targets]) for name in self.targets[0]}


class RadarSweeps:
    """Writes radar readings; a message without targets makes a file without targets.

    Single tracks are collected into cycles: a new cycle begins with a track whose number is not
    greater than the one before, or 0.1 s after the first. A cycle has the stamp of its first track.

    Some drivers publish the same reading repeatedly while they fill it. Of consecutive readings with
    the same stamp, the one with most targets is kept (of equal ones the first); the others are counted
    as duplicates.

    Velocities relative to the radar are compensated for its motion at the stamp of the file. Without an ego pose there,
    the reading is counted as lost.

    Args:
        use: everything that shapes the files.
        files: writes them.
        motion: what velocities are compensated with; None if they are not.
    """

    def __init__(self, use: RadarUse, files: SweepFiles, motion: Motion | None) -> None:
        self._files = files
        self._motion = motion
        self._by_log_time = use.settings.clock == "log"
        self._side = use.settings.azimuth_positive
        self._decode = keyed_decoder("radar", use.msgtype, use.decoder)
        self._by_plugin = use.decoder is not None
        self._pending: _Sweep | None = None
        self._cycle: _Sweep | None = None
        self._last_number = -1.0

    def add(self, message: Message, raw: RawMessage) -> str:
        """Add one message; return its frame.

        Raises:
            DecodeError: the message is not a usable radar reading.
        """
        reading: RadarReading = self._decode(message, raw.msgtype, self._side)
        if self._by_plugin and not reading.stamp_ns and not self._by_log_time:
            raise DecodeError("its stamp is zero; set clock: log in the recipe")
        self._files.counts.read += 1
        self._files.points.read += len(reading.targets["x"]) + reading.dropped
        self._files.points.lose("no measurement", reading.dropped)
        stamp = raw.log_time_ns if self._by_log_time else reading.stamp_ns
        sweep = _Sweep(stamp, raw.log_time_ns, reading.radial)
        if not self._by_plugin and is_single_track(message):
            self._collect(sweep, reading.targets, track_number(message))
        else:
            sweep.add(reading.targets, raw.log_time_ns)
            self._offer(sweep)
        return reading.frame_id

    def finish(self) -> None:
        """Write pending targets."""
        if self._cycle is not None:
            self._offer(self._cycle)
        if self._pending is not None:
            self._write(self._pending)

    def _collect(self, sweep: _Sweep, targets: Targets, number: float | None) -> None:
        """Add a single track, which came with `sweep`, to its cycle; without track numbers, time decides."""
        cycle = self._cycle
        number = self._last_number + 1.0 if number is None else number
        if cycle is not None and not (
            number > self._last_number and sweep.stamp_ns - cycle.stamp_ns <= LONGEST_CYCLE_NS
        ):
            self._offer(cycle)
            cycle = None
        self._cycle = cycle or sweep
        self._cycle.add(targets, sweep.log_time_ns)
        self._last_number = number

    def _offer(self, sweep: _Sweep) -> None:
        """Write the previous sweep, unless this one replaces it."""
        before = self._pending
        self._pending = sweep
        if before is None:
            return
        if before.stamp_ns // 1000 != sweep.stamp_ns // 1000:
            self._write(before)
            return
        if before.number >= sweep.number:
            before, self._pending = sweep, before
        self._files.lose("duplicate stamp", before.parts, before.number)

    def _write(self, sweep: _Sweep) -> None:
        targets = sweep.joined()
        if self._motion is not None and "vx" in targets:
            (own_mps,) = sensor_velocities(*self._motion, np.array([sweep.stamp_ns]))
            if np.isnan(own_mps).any():
                self._files.lose("no ego pose to compensate with", sweep.parts, sweep.number)
                return
            vx, vy = own_mps[0], own_mps[1]
            if sweep.radial:  # only what the radar's own velocity has along each ray, laid along it
                x, y, z = (targets[axis] for axis in "xyz")
                along = (x * vx + y * vy + z * own_mps[2]) / np.maximum(x * x + y * y + z * z, 1e-6)
                vx, vy = along * x, along * y
            targets |= {"vx_comp": targets["vx"] + vx, "vy_comp": targets["vy"] + vy}
        data = radar_bytes(targets)
        self._files.write(sweep.stamp_ns, sweep.log_time_ns, data, sweep.number, parts=sweep.parts)
