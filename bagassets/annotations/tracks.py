"""Tracks at chosen times: boxes interpolated between the observations of the same object."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.annotations.table import BoxTable
from bagassets.geometry.se3 import Floats
from bagassets.geometry.trajectory import Trajectory
from bagassets.timeline.keyframes import Stamps, nearest

__all__ = ["Track", "TrackBoxes", "tracks_of"]


@dataclass(frozen=True, eq=False)
class TrackBoxes:
    """Boxes of one track at those of the asked times at which it exists.

    Attributes:
        at: (M,) indices into the asked times, increasing.
        observations: (M,) index of the observation nearest to each, in the rows of the track.
        centers_m: (M, 3) in the global frame.
        rotations: (M, 4) quaternions w, x, y, z.
        held: number of boxes that are an observation moved in time, not interpolated.
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
        rows: (N,) rows of the table that it was made from.
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
        the line, its rotation by slerp. Elsewhere the nearest observation holds, if it is within
        `tolerance_ns`; and else the track does not exist at that time.
        """
        line = Trajectory(self.stamps_ns, self.centers_m, self.rotations, max_gap_ns, 0)
        centers, rotations, between = line.at(times_ns)
        observation = nearest(self.stamps_ns, times_ns)
        close = np.abs(self.stamps_ns[observation] - times_ns) <= tolerance_ns
        hold = close & ~between
        centers = np.where(hold[:, None], self.centers_m[observation], centers)
        rotations = np.where(hold[:, None], self.rotations[observation], rotations)
        at = np.flatnonzero(between | hold)
        return TrackBoxes(at, observation[at], centers[at], rotations[at], int(np.count_nonzero(hold)))


def tracks_of(table: BoxTable) -> Iterator[Track]:
    """Yield the tracks of a table, sorted by source and track id."""
    rows: dict[tuple[str, str], list[int]] = {}
    for row, name in enumerate(zip(table.sources, table.tracks, strict=True)):
        rows.setdefault(name, []).append(row)
    for (source, track_id), numbers in sorted(rows.items()):
        index = np.array(numbers, dtype=np.intp)
        index = index[np.argsort(table.stamps_ns[index], kind="stable")]
        yield Track(
            source, track_id, table.stamps_ns[index], index, table.centers_m[index], table.rotations[index]
        )
