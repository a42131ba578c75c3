"""What the velocities of a radar are, found from what stands still while the vehicle drives.

Where the radar sits need not be known: a direction of travel is sought in which most targets come nearer as fast as the vehicle
drives. If there is one, velocities are relative to the radar. If instead most targets have none, although the vehicle drives,
they are over ground. Traffic alone looks like either, so one must explain most targets, and the other hardly any.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from bagassets.decode.loading import load_decoder
from bagassets.decode.radar import measures_relative
from bagassets.decode.registry import AnyFamily, families_of, find_decoder
from bagassets.decode.tf import decode_transform
from bagassets.errors import DecodeError
from bagassets.geometry.radar_motion import SLOWEST_MPS, explained
from bagassets.geometry.se3 import Floats
from bagassets.geometry.wgs84 import ecef
from bagassets.recordings.model import Message, RawMessage
from bagassets.recordings.recording import Recording

__all__ = ["UNDECIDED", "velocities_of"]

UNDECIDED = "undecided"
# Vehicles stand before they drive; then a few seconds are enough.
_LONGEST_S, _STEP_S = 60.0, 0.25
_FEWEST_READINGS, _MOST_READINGS = 6, 24
_HALF_WINDOW_S = 0.25
_MOST_TARGETS = 500
_HEADINGS = np.deg2rad(np.arange(0, 360, 5))
_NOISE_SHARE = 0.05  # the direction of travel is off by up to 2.5 degrees
_MOST, _HARDLY_ANY = 0.5, 0.2

Readings = list[tuple[float, dict[str, Floats]]]
Track = list[tuple[float, float, float, float]]


def velocities_of(recording: Recording, radars: Iterable[str], movers: Collection[str]) -> dict[str, str]:
    """Return radar topic -> `relative`, `over_ground`, or `undecided`; not of those where nothing is to be decided.

    That is so where the message type says it, and where messages hold no velocities, or compensated ones.

    Args:
        recording: the recording; at most a minute of it is read.
        radars: topics of radars.
        movers: topics that tell where the vehicle is: poses, fixes or transforms.
    """
    found: dict[str, str] = {}
    waiting: dict[str, Readings] = {
        name: [] for name in radars if not measures_relative(recording.topics[name].msgtype)
    }
    tracks: dict[str, Track] = {}
    until_s: float | None = None
    for message in recording.messages(sorted({*waiting, *movers})) if waiting else ():
        now_s = message.log_time_ns / 1e9
        until_s = now_s + (_LONGEST_S if movers else 1.0) if until_s is None else until_s
        if not waiting or now_s > until_s:
            break
        name = message.topic
        try:
            if name in movers:
                for place, position_m in _places(message, recording.decode(message)):
                    tracks.setdefault(place, []).append((now_s, *position_m))
            elif name in waiting and not (waiting[name] and now_s - waiting[name][-1][0] < _STEP_S):
                targets = _targets(message, recording.decode(message))
                if len(targets["x"]) and ("vx" not in targets or "vx_comp" in targets):
                    del waiting[name]
                elif len(targets["x"]):
                    waiting[name].append((now_s, targets))
                    verdict = _verdict(waiting[name][-_MOST_READINGS:], list(tracks.values()))
                    if verdict != UNDECIDED:
                        found[name] = verdict
                        del waiting[name]
        except DecodeError:
            continue
    return found | {name: UNDECIDED for name, readings in waiting.items() if readings}


def _targets(message: RawMessage, decoded: Message) -> dict[str, Floats]:
    targets: dict[str, Floats] = _decode("radar", message.msgtype)(decoded, message.msgtype, None).targets
    step = max(1, len(targets["x"]) // _MOST_TARGETS)
    return {name: column[::step] for name, column in targets.items()}


def _places(message: RawMessage, decoded: Message) -> Iterator[tuple[str, tuple[float, float, float]]]:
    """Yield what is somewhere, and where, in metres."""
    family = families_of(message.msgtype)[0]
    value = _decode(family, message.msgtype)(decoded)
    if family == "fix":
        lat, lon = np.array([value.lat_deg]), np.array([value.lon_deg])
        yield message.topic, tuple(ecef(lat, lon, np.zeros(1))[0].tolist())
    elif family == "transforms":
        for edge in map(decode_transform, value):
            yield f"{edge.parent} {edge.child}", edge.parent_SE3_child.translation
    else:
        yield message.topic, value.parent_SE3_child.translation


def _decode(family: AnyFamily, msgtype: str) -> Callable[..., Any]:
    decoder = find_decoder(family, msgtype)
    if decoder is None:
        raise DecodeError("nothing decodes it")
    decode: Callable[..., Any] = load_decoder(decoder)
    return decode


def _verdict(readings: Readings, tracks: Sequence[Track]) -> str:
    if len(readings) < _FEWEST_READINGS or not tracks:
        return UNDECIDED
    # Of several transforms, the one that moves farthest is that of the vehicle.
    track = max((np.array(track) for track in tracks), key=_length_m)
    ground, relative = [], []
    for now_s, targets in readings:
        speed_mps = _speed_mps(track, now_s)
        if speed_mps >= SLOWEST_MPS:
            headings = speed_mps * np.stack([np.cos(_HEADINGS), np.sin(_HEADINGS)], axis=1)
            shares = explained(targets, headings, _NOISE_SHARE)
            ground.append(np.nan_to_num(shares[0]))
            relative.append(np.nan_to_num(shares[1]))
    if len(ground) < _FEWEST_READINGS:
        return UNDECIDED
    still, moving = np.mean(ground, axis=0), np.mean(relative, axis=0)
    best = int(np.argmax(moving))
    if moving[best] >= _MOST and still[best] <= _HARDLY_ANY:
        return "relative"
    return "over_ground" if still.max() >= _MOST and moving[best] <= _HARDLY_ANY else UNDECIDED


def _length_m(track: Floats) -> float:
    steps = np.diff(track[:, 1:], axis=0)
    return float(np.sqrt((steps * steps).sum(axis=1)).sum())


def _speed_mps(track: Floats, now_s: float) -> float:
    """Return the mean speed around a time; 0 outside of the track."""
    first_s, last_s = now_s - _HALF_WINDOW_S, now_s + _HALF_WINDOW_S
    if first_s < track[0, 0] or last_s > track[-1, 0]:
        return 0.0
    moved_m = np.array([np.diff(np.interp([first_s, last_s], track[:, 0], axis))[0] for axis in track.T[1:]])
    return float(np.sqrt((moved_m * moved_m).sum())) / (2 * _HALF_WINDOW_S)
