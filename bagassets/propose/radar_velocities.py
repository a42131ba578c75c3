"""What the velocities of a radar are, found from what stands still while the vehicle drives; where the radar sits need not be known."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from bagassets.base.errors import DecodeError, PluginError
from bagassets.decode.loading import load_decoder
from bagassets.decode.poses import decode_transform
from bagassets.decode.radar import measures_relative
from bagassets.decode.registry import AnyFamily, families_of, find_decoder
from bagassets.geometry.radar_motion import Velocities, what_velocities_are
from bagassets.geometry.se3 import Floats
from bagassets.geometry.wgs84 import ecef
from bagassets.recordings.model import RawMessage
from bagassets.recordings.recording import Recording

# Vehicles stand before they drive; then a few seconds are enough.
_LONGEST_S, _STEP_S, _MOST_READINGS = 60.0, 0.2, 30
_HALF_WINDOW_S = 0.25
_MOST_TARGETS = 500
_HEADINGS = np.deg2rad(np.arange(0, 360, 3))
_DIRECTIONS = np.stack([np.cos(_HEADINGS), np.sin(_HEADINGS)], axis=1)
_NOISE_SHARE = 0.03  # the direction of travel is off by up to 1.5 degrees

Verdict = Velocities | Literal["undecided"]


def velocities_of(recording: Recording, radars: Iterable[str], movers: Collection[str]) -> dict[str, Verdict]:
    """Return radar topic -> what its velocities are; without those where nothing is to be decided.

    That is so where the message type says it, and where messages hold no velocities, or compensated ones.

    Args:
        recording: the recording; at most a minute of it is read.
        radars: topics of radars.
        movers: topics that tell where the vehicle is: poses, fixes or transforms.
    """
    found: dict[str, Verdict] = {}
    waiting: dict[str, list[tuple[float, Floats]]] = {
        name: [] for name in radars if not measures_relative(recording.topics[name].msgtype)
    }
    tracks: dict[str, list[tuple[float, ...]]] = {}
    until_s: float | None = None
    for message in recording.messages(sorted({*waiting, *movers})) if waiting else ():
        name, now_s = message.topic, message.log_time_ns / 1e9
        until_s = now_s + (_LONGEST_S if movers else 1.0) if until_s is None else until_s
        if not waiting or now_s > until_s:
            break
        try:
            if name in movers:
                for what, place in _places(recording, message):
                    tracks.setdefault(what, []).append((now_s, *place))
                continue
            if name not in waiting or (waiting[name] and now_s - waiting[name][-1][0] < _STEP_S):
                continue
            decode = _decoder("radar", message.msgtype)
            targets = decode(recording.decode(message), message.msgtype, None).targets
        except (DecodeError, PluginError):
            continue
        if not len(targets["x"]):
            continue
        if "vx" not in targets or "vx_comp" in targets:
            del waiting[name]
            continue
        step = len(targets["x"]) // _MOST_TARGETS + 1
        columns = np.array([targets[field][::step] for field in ("x", "y", "z", "vx", "vy")])
        waiting[name] = [*waiting[name][1 - _MOST_READINGS :], (now_s, columns)]
        if (said := _verdict(waiting[name], tracks)) is not None:
            found[name] = said
            del waiting[name]
    return found | {name: "undecided" for name, readings in waiting.items() if readings}


def _places(recording: Recording, message: RawMessage) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Yield what is somewhere, and where, in metres."""
    family = families_of(message.msgtype)[0]
    value = _decoder(family, message.msgtype)(recording.decode(message))
    if family == "transforms":
        for edge in map(decode_transform, value):
            yield f"{edge.parent} {edge.child}", edge.parent_SE3_child.translation
    elif family == "fix":
        lat_deg, lon_deg = np.array([value.lat_deg]), np.array([value.lon_deg])
        yield message.topic, tuple(ecef(lat_deg, lon_deg, np.zeros(1))[0].tolist())
    else:
        yield message.topic, value.parent_SE3_child.translation


def _decoder(family: AnyFamily, msgtype: str) -> Callable[..., Any]:
    decoder = find_decoder(family, msgtype)
    if decoder is None:
        raise DecodeError("nothing decodes it")
    decode: Callable[..., Any] = load_decoder(decoder)
    return decode


def _verdict(
    readings: Sequence[tuple[float, Floats]], tracks: Mapping[str, Sequence[tuple[float, ...]]]
) -> Velocities | None:
    if not tracks:
        return None
    # Of several transforms, that of the vehicle leads farthest.
    track = max(map(np.array, tracks.values()), key=lambda one: np.ptp(one[:, 1:], axis=0).max())
    told = [(targets, _speed_mps(track, now_s) * _DIRECTIONS) for now_s, targets in readings]
    return what_velocities_are(told, _NOISE_SHARE)


def _speed_mps(track: Floats, now_s: float) -> float:
    """Return the mean speed around a time; 0 outside of the track."""
    window_s = np.array([now_s - _HALF_WINDOW_S, now_s + _HALF_WINDOW_S])
    if window_s[0] < track[0, 0] or window_s[1] > track[-1, 0]:
        return 0.0
    moved_m = [np.diff(np.interp(window_s, track[:, 0], axis)) for axis in track.T[1:]]
    return float(np.sqrt(np.square(moved_m).sum())) / (2 * _HALF_WINDOW_S)
