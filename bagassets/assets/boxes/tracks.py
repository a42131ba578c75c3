"""Boxes at chosen times.

Boxes of a track are interpolated between the observations of the same object. Boxes without identity cannot be
assigned to objects, so each time takes those of the nearest message.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.timeline.keyframes import Stamps, nearest, partner_readings
from bagassets.geometry.se3 import Floats
from bagassets.geometry.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class TrackBoxes:
    """Boxes of one track at those of the given times at which it exists.

    Attributes:
        at: (M,) indices into the given times, increasing.
        observations: (M,) index of the observation nearest to each, in the rows of the track.
        centers_m: (M, 3) in the global frame.
        rotations: (M, 4) quaternions w, x, y, z.
        held: number of boxes that lie beyond an observation, not between two.
    """

    at: NDArray[np.intp]
    observations: NDArray[np.intp]
    centers_m: Floats
    rotations: Floats
    held: int


@dataclass(frozen=True, eq=False)
class Track:
    """The observations of one object.

    Attributes:
        source: topic or file.
        track_id: unique within the source.
        stamps_ns: (N,) strictly increasing.
        rows: (N,) rows of its table.
        centers_m: (N, 3) in the global frame.
        rotations: (N, 4).
    """

    source: str
    track_id: str
    stamps_ns: Stamps
    rows: NDArray[np.intp]
    centers_m: Floats
    rotations: Floats

    def at(self, times_ns: Stamps, max_gap_ns: int, tolerance_ns: int) -> TrackBoxes:
        """Return the boxes of the track at (T,) times.

        Between two observations at most `max_gap_ns` apart a box is interpolated: its centre along
        the line, its rotation by slerp. Elsewhere the nearest observation within `tolerance_ns` is extrapolated by
        the motion of the track there; without one the track does not exist at that time.
        """
        observation = nearest(self.stamps_ns, times_ns)
        # Stretches without long gaps; a time belongs to that of its nearest observation.
        starts = np.flatnonzero(np.diff(self.stamps_ns) > max_gap_ns) + 1
        stretch = np.searchsorted(starts, observation, side="right")
        bounds = [0, *starts.tolist(), len(self.stamps_ns)]
        centers = np.full((len(times_ns), 3), np.nan)
        rotations = np.full((len(times_ns), 4), np.nan)
        exists = np.zeros(len(times_ns), dtype=np.bool_)
        beyond = np.zeros(len(times_ns), dtype=np.bool_)
        for number in sorted(set(stretch.tolist())):
            rows = slice(bounds[number], bounds[number + 1])
            stamps = self.stamps_ns[rows]
            line = Trajectory(stamps, self.centers_m[rows], self.rotations[rows], max_gap_ns, tolerance_ns)
            asked = stretch == number
            centers[asked], rotations[asked], exists[asked] = line.at(times_ns[asked])
            beyond[asked] = (times_ns[asked] < stamps[0]) | (times_ns[asked] > stamps[-1])
        at = np.flatnonzero(exists)
        held = int(np.count_nonzero(exists & beyond))
        return TrackBoxes(at, observation[at], centers[at], rotations[at], held)


@dataclass(frozen=True, eq=False)
class Messages:
    """The boxes without identity of one source, by message.

    Attributes:
        source: topic or file.
        stamps_ns: (M,) stamps of the messages, strictly increasing.
        rows: (M,) rows of each message in the table.
    """

    source: str
    stamps_ns: Stamps
    rows: Sequence[NDArray[np.intp]]

    def at(self, times_ns: Stamps, tolerance_ns: int) -> NDArray[np.intp]:
        """Return for each of (T,) times the index of the nearest message, or -1 if it is not within `tolerance_ns`."""
        return partner_readings(times_ns, self.stamps_ns, tolerance_ns)


def messages_of(table: BoxTable) -> Iterator[Messages]:
    """Yield the boxes without identity, sorted by source."""
    rows: dict[str, dict[int, list[int]]] = {}
    for row, (source, track, stamp_ns) in enumerate(
        zip(table.sources, table.tracks, table.message_stamps_ns.tolist(), strict=True)
    ):
        if not track:
            rows.setdefault(source, {}).setdefault(stamp_ns, []).append(row)
    for source, messages in sorted(rows.items()):
        stamps = sorted(messages)
        index = [np.array(messages[stamp], dtype=np.intp) for stamp in stamps]
        yield Messages(source, np.array(stamps, dtype=np.int64), index)


def tracks_of(table: BoxTable) -> Iterator[Track]:
    """Yield the tracks of a table, sorted by source and track id."""
    rows: dict[tuple[str, str], list[int]] = {}
    for row, name in enumerate(zip(table.sources, table.tracks, strict=True)):
        if name[1]:
            rows.setdefault(name, []).append(row)
    for (source, track_id), numbers in sorted(rows.items()):
        index = np.array(numbers, dtype=np.intp)
        index = index[np.argsort(table.stamps_ns[index], kind="stable")]
        yield Track(
            source, track_id, table.stamps_ns[index], index, table.centers_m[index], table.rotations[index]
        )
