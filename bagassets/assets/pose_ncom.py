"""Ego poses from OxTS NCOM packets, projected to local metres."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bagassets.assets.pose_outliers import trusted_fixes
from bagassets.assets.pose_samples import MovingRig, PoseSamples, mounted, stamp_of, wgs84_origin
from bagassets.assets.transform_logs import RigFrames
from bagassets.base.errors import DecodeError
from bagassets.decode.fields import stamp_ns
from bagassets.decode.ncom import PACKET_SIZE, NcomReading, decode_ncom
from bagassets.decode.packets import payload, sender
from bagassets.geometry.euler import quaternions_from_rpy
from bagassets.geometry.wgs84 import LocalFrame
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_poses import NcomSource
from bagassets.recordings.recording import Recording

GPS_EPOCH_S = 315_964_800  # 1980-01-06 00:00 UTC
MINUTE_MS = 60_000
# A step back by more than half a minute is the start of a new minute.
HALF_MINUTE_MS = MINUTE_MS // 2
# After a longer pause, the milliseconds do not show how many minutes have passed.
LONGEST_PAUSE_NS = 20_000_000_000


@dataclass(frozen=True, slots=True)
class _Packet:
    """A packet with the stamp and the log time of its message."""

    stamp_ns: int
    log_time_ns: int
    reading: NcomReading


def poses_from_ncom(
    source: NcomSource, rig: MovingRig, recording: Recording, frames: RigFrames
) -> PoseSamples:
    """Return a pose for each packet that has one; the origin of the global frame is the first that is in reach of the others.

    Packets of other senders, and packets that never have a pose (status, triggers), are counted as merged.
    """
    samples = PoseSamples(global_frame="enu")
    packets = _packets(source, rig.clock, recording, samples)
    if source.stamp == "packet":
        stamps = _gps_stamps_ns(packets, source.leap_seconds)
    else:
        stamps = [packet.stamp_ns for packet in packets]
    usable = []
    for packet, time_ns in zip(packets, stamps, strict=True):
        if packet.reading.pose is None:
            if packet.reading.initialising:
                samples.counts.lose("the navigation system has no solution yet")
            else:
                samples.counts.merged += 1
        elif time_ns is None:
            samples.counts.lose("no packet near it tells the GPS minute")
        else:
            usable.append((time_ns, packet.reading.pose))
    if not usable:
        return samples
    usable.sort(key=lambda item: item[0])
    stamps_ns = np.array([time_ns for time_ns, _ in usable], dtype=np.int64)
    lat_deg, lon_deg, alt_m = (
        np.array([getattr(pose, name) for _, pose in usable]) for name in ("lat_deg", "lon_deg", "alt_m")
    )
    trusted = trusted_fixes(stamps_ns, lat_deg, lon_deg, alt_m)
    samples.lose_strays(trusted)
    lat_deg, lon_deg, alt_m = (values[trusted] for values in (lat_deg, lon_deg, alt_m))
    origin = LocalFrame(float(lat_deg[0]), float(lon_deg[0]), float(alt_m[0]))
    samples.origin = wgs84_origin(origin)
    enu_Q_body = quaternions_from_rpy(np.array([pose.enu_rpy_rad for _, pose in usable])[trusted])
    sensor = source.frame or rig.ego_frame
    samples.add_mounted(
        stamps_ns[trusted].tolist(),
        origin.to_local(lat_deg, lon_deg, alt_m),
        origin.rotations_to_local(lat_deg, lon_deg, enu_Q_body),
        mounted(frames, sensor, rig.ego_frame, "navigation system", samples),
    )
    return samples


def _packets(source: NcomSource, clock: Clock, recording: Recording, samples: PoseSamples) -> list[_Packet]:
    """Return the packets of the wanted sender in the order read; count all others."""
    packets: list[_Packet] = []
    for message in recording.messages([source.topic]):
        try:
            decoded = recording.decode(message)
            address, port = sender(decoded)
            if source.sender not in {None, address, f"{address}:{port}"}:
                samples.counts.read += 1
                samples.counts.merged += 1
                continue
            data = payload(decoded)
        except DecodeError as err:
            samples.counts.read += 1
            samples.fail(str(err))
            continue
        header = getattr(decoded, "header", None)
        time_ns = stamp_of(clock, message, None if header is None else stamp_ns(header.stamp))
        for start in range(0, max(len(data), 1), PACKET_SIZE):  # one payload may hold several
            samples.counts.read += 1
            try:
                reading = decode_ncom(data[start : start + PACKET_SIZE])
            except DecodeError as err:
                samples.fail(str(err))
                continue
            packets.append(_Packet(time_ns, message.log_time_ns, reading))
    return packets


def _gps_stamps_ns(packets: Sequence[_Packet], leap_seconds: int) -> list[int | None]:
    """Return the packets' own times in nanoseconds since 1970 (UTC); None where the minute is unknown.

    A packet has milliseconds within the minute; only some also have the minute, from which that of
    their neighbours is derived.
    """
    offsets = {packet.reading.utc_offset_s for packet in packets} - {None}
    utc_offset_s = -leap_seconds if len(offsets) != 1 else offsets.pop()
    stamps: list[int | None] = []
    start = 0
    for i in range(1, len(packets) + 1):
        pause = i < len(packets) and packets[i].log_time_ns - packets[i - 1].log_time_ns > LONGEST_PAUSE_NS
        if i == len(packets) or pause:
            for gps_ms in _gps_ms(packets[start:i]):
                unix_ms = None if gps_ms is None else gps_ms + (GPS_EPOCH_S + (utc_offset_s or 0)) * 1000
                stamps.append(None if unix_ms is None else unix_ms * 1_000_000)
            start = i
    return stamps


def _gps_ms(packets: Sequence[_Packet]) -> list[int | None]:
    """Return milliseconds since the GPS epoch of packets without a long pause among them."""
    minutes = 0
    before_ms: int | None = None
    relative: list[int | None] = []
    bases: list[int] = []
    for packet in packets:
        ms = packet.reading.minute_ms
        if ms is None:
            relative.append(None)
            continue
        if before_ms is not None and ms - before_ms < -HALF_MINUTE_MS:
            minutes += 1
        elif before_ms is not None and ms - before_ms > HALF_MINUTE_MS:
            minutes -= 1  # a packet of the last minute that arrived late
        before_ms = ms
        relative.append(minutes * MINUTE_MS + ms)
        if packet.reading.gps_minute is not None:
            bases.append(packet.reading.gps_minute - minutes)
    if not bases:
        return [None] * len(packets)
    base_ms = sorted(bases)[len(bases) // 2] * MINUTE_MS  # the value of most packets
    return [None if ms is None else base_ms + ms for ms in relative]
