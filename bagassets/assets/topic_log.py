"""Facts that the inventory collects about one topic while it reads the recording."""

from array import array
from struct import Struct

import numpy as np
from blake3 import blake3
from numpy.typing import NDArray

from bagassets.base.json_types import JsonObject
from bagassets.recordings.model import RawMessage

GAP_FACTOR = 5
MOST_GAPS = 20
MOST_FRAMES = 5

_LENGTHS = Struct("<qQ")  # log time, length
# Hashing takes several times as long piece by piece, if the pieces are small.
_SMALL_BYTES = 16 * 1024
_HELD_BYTES = 64 * 1024


class TopicLog:
    """Counts, times and the content digest of one topic.

    The digest is computed from the type, from (log time, length, payload) of each message in order of
    log time, and from the layout by which payloads are decoded. Re-indexing, re-compressing or splitting
    a recording does not change it; a definition that decodes the same bytes to other values does.
    """

    def __init__(self, msgtype: str) -> None:
        self.bytes = 0
        self._hasher = blake3(msgtype.encode() + b"\0")
        self._to_hash = bytearray()
        self._times = array("q")
        self._stamps = array("q")
        self._stamped_times = array("q")
        self._frames: dict[str, None] = {}

    @property
    def count(self) -> int:
        """Number of messages so far."""
        return len(self._times)

    @property
    def times_ns(self) -> NDArray[np.int64]:
        """(N,) log times so far."""
        return np.array(self._times, dtype=np.int64)

    def add(self, message: RawMessage, header: tuple[int, str] | None) -> None:
        """Take the next message."""
        _, _, log_time_ns, data = message
        size = len(data)
        self.bytes += size
        self._to_hash += _LENGTHS.pack(log_time_ns, size)
        if size <= _SMALL_BYTES:
            self._to_hash += data
            if len(self._to_hash) >= _HELD_BYTES:
                self._hash()
        else:
            self._hash()
            self._hasher.update(data)
        self._times.append(log_time_ns)
        if header is None:
            return
        stamp_ns, frame = header
        self._stamps.append(stamp_ns)
        self._stamped_times.append(log_time_ns)
        if frame and frame not in self._frames and len(self._frames) < MOST_FRAMES:
            self._frames[frame] = None

    def _hash(self) -> None:
        self._hasher.update(self._to_hash)
        self._to_hash.clear()

    def as_json(self, layout_digest: str) -> JsonObject:
        """Return the facts in the form of `inventory.json`.

        Args:
            layout_digest: digest of the layout of messages; empty if it is not known.
        """
        self._hash()
        times = self.times_ns
        stamps = np.array(self._stamps, dtype=np.int64)
        offsets = np.array(self._stamped_times, dtype=np.int64) - stamps
        unordered = stamps[1:][stamps[1:] < stamps[:-1]]
        periods = np.diff(times)
        span_ns = int(times[-1] - times[0]) if len(times) > 1 else 0
        return {
            "count": len(times),
            "bytes": self.bytes,
            "digest": blake3(self._hasher.digest() + layout_digest.encode()).hexdigest(),
            "first_ns": int(times[0]) if len(times) else None,
            "last_ns": int(times[-1]) if len(times) else None,
            "first_stamp_ns": int(stamps.min()) if len(stamps) else None,
            "last_stamp_ns": int(stamps.max()) if len(stamps) else None,
            "rate_hz": round((len(times) - 1) / (span_ns / 1e9), 3) if span_ns > 0 else None,
            "max_gap_s": _seconds(int(periods.max())) if len(periods) else None,
            "header_offset_s": None
            if not len(offsets)
            else {
                "min": _seconds(int(offsets.min())),
                "median": _seconds(int(np.sort(offsets)[len(offsets) // 2])),
                "max": _seconds(int(offsets.max())),
            },
            "period_ns": _median_period(stamps if (stamps > 0).any() else times),
            "unordered_stamps": len(unordered),
            "first_unordered_ns": int(unordered[0]) if len(unordered) else None,
            "frame_ids": list(self._frames),
            **_gaps(times, periods),
        }


def _median_period(stamps: NDArray[np.int64]) -> int | None:
    """Return the median time between stamps, whatever their order; pauses and lost messages do not shift it."""
    periods = np.diff(np.sort(stamps[stamps > 0]))
    periods = np.sort(periods[periods > 0])  # `np.unique` takes twenty times as long
    return int(periods[len(periods) // 2]) if len(periods) else None


def _gaps(times: NDArray[np.int64], periods: NDArray[np.int64]) -> JsonObject:
    if len(periods) < 2:
        return {"gaps": [], "gap_count": 0}
    median = int(np.sort(periods)[len(periods) // 2])
    long = np.flatnonzero(periods > GAP_FACTOR * max(median, 1))
    gaps = [
        {"start_ns": int(times[i]), "duration_s": _seconds(int(periods[i]))}
        for i in long[:MOST_GAPS].tolist()
    ]
    return {"gaps": gaps, "gap_count": len(long)}


def _seconds(nanoseconds: int) -> float:
    return round(nanoseconds / 1e9, 6)
