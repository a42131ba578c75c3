"""Positions that cannot be true, and times at which two trajectories overlap."""

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.se3 import Floats, rotate
from bagassets.geometry.wgs84 import ecef

Mask = NDArray[np.bool_]
Stamps = NDArray[np.int64]

# Nothing on wheels reaches this speed, but numbers with a flipped bit do. Poses with almost equal stamps
# differ by noise.
_FASTEST_MPS, _NOISE_M = 1000.0, 10.0
# Fixes that continue elsewhere after a jump: receivers err by up to hundreds of metres between houses, not by more.
_TRAVEL_MPS, _MULTIPATH_M = 100.0, 1000.0
# Poses of one source are hardly ever this far off the line between their neighbours, and at once so much nearer to that
# between the poses beyond these; never at so many poses in a row, whatever their noise.
_LEAST_OFF_M, _RATIO, _IN_A_ROW = 0.05, 5.0, 10
_BRIDGED = 4  # poses between two such rows: where the order of two sources changes, a row ends


def strays(stamps_ns: Stamps, positions_m: Floats) -> Mask:
    """Return (N,) whether each of (N, 3) positions, in order of time, is out of reach from both neighbours.

    A jump after which the positions continue, as when a vehicle has localized itself on a map, is not a
    stray. At either end of the trajectory, the only neighbour must itself be in reach of the next position.
    """
    out_of_reach = np.zeros(len(stamps_ns), np.bool_)
    if len(stamps_ns) < 3:
        return out_of_reach
    jumps = ~_in_reach(np.diff(stamps_ns), np.diff(positions_m, axis=0), _FASTEST_MPS, _NOISE_M)
    out_of_reach[1:-1] = jumps[:-1] & jumps[1:]
    out_of_reach[0] = jumps[0] and not jumps[1]
    out_of_reach[-1] = jumps[-1] and not jumps[-2]
    return out_of_reach


def trusted_fixes(stamps_ns: Stamps, lat_deg: Floats, lon_deg: Floats, alt_m: Floats) -> Mask:
    """Return (N,) whether each of (N,) fixes, in order of time, is in reach of the others.

    Of runs of fixes between jumps, the longest is trusted, and those that can be reached from it, if these are most fixes: a
    receiver may begin with many at the place where it was switched off. Heights that are not known (NaN) do not count.
    """
    ground_m = ecef(lat_deg, lon_deg, np.zeros(len(lat_deg)))
    near = _in_reach(np.diff(stamps_ns), np.diff(ground_m, axis=0), _TRAVEL_MPS, _MULTIPATH_M)
    lasts = np.append(np.flatnonzero(~near), len(near))
    firsts = np.append(0, lasts[:-1] + 1)
    longest = int(np.argmax(lasts - firsts))
    # The ends of a run and of the longest one that face each other.
    before = np.arange(len(lasts)) < longest
    here, there = np.where(before, lasts, firsts), np.where(before, firsts[longest], lasts[longest])
    gaps_ns = np.abs(stamps_ns[there] - stamps_ns[here])
    reached = _in_reach(gaps_ns, ground_m[there] - ground_m[here], _TRAVEL_MPS, _MULTIPATH_M)
    reached[longest] = True
    trusted = np.repeat(reached, lasts - firsts + 1)
    if 2 * np.count_nonzero(trusted) <= len(trusted):
        trusted[:] = True
    known = np.isfinite(alt_m)
    heights_m = np.where(known, alt_m, np.median(alt_m[known]) if known.any() else 0.0)
    positions_m = ecef(lat_deg[trusted], lon_deg[trusted], heights_m[trusted])
    trusted[trusted] = ~strays(stamps_ns[trusted], positions_m)
    return trusted


def _in_reach(gaps_ns: Stamps, moves_m: Floats, fastest_mps: float, noise_m: float) -> Mask:
    """Return (N,) whether each of (N, 3) moves can have been made in its time."""
    limit_m = noise_m + fastest_mps * (gaps_ns.astype(np.float64) / 1e9)
    return np.asarray(np.sqrt((moves_m * moves_m).sum(axis=1)) <= limit_m)


def overlaps(rows: Floats) -> list[tuple[int, int]]:
    """Return first and last index of each span of (N, 7) poses, in order of time, that go to and fro between two trajectories.

    That is what is left after the clock was set back while recording, or if two nodes publish on one topic: a pose is off the line
    between its neighbours, and the poses before and after these are on its own side. Noise, jumps, and stamps that are not exact
    do not look like that. Of each pose its place counts, and that of a point 1 m ahead, which shows its rotation.
    """
    if len(rows) < _IN_A_ROW:
        return []
    points = np.concatenate([rows[:, :3], rotate(rows[:, 3:], np.array([1.0, 0.0, 0.0]))], axis=1)
    off_m = _off_line(points[2:-2], points[1:-3], points[3:-1])
    same_m = _off_line(points[2:-2], points[:-4], points[4:])
    marked = np.flatnonzero(off_m > np.maximum(_LEAST_OFF_M, _RATIO * same_m)) + 2
    found: list[tuple[int, int]] = []
    for row in np.split(marked, np.flatnonzero(np.diff(marked) > 1) + 1):
        if len(row) < _IN_A_ROW:
            continue
        # Of the outermost poses, one neighbour is of one trajectory only.
        first, last = int(row[0]) - 1, int(row[-1]) + 1
        if found and first - found[-1][1] <= _BRIDGED:
            first = found.pop()[0]
        found.append((first, last))
    return found


def _off_line(points: Floats, starts: Floats, ends: Floats) -> Floats:
    """Return (N,) distances of (N, D) points from the segments between (N, D) starts and ends.

    Unlike a distance from an interpolated pose, it is small if only the stamps are wrong.
    """
    along = ends - starts
    square = (along * along).sum(axis=1)
    share = ((points - starts) * along).sum(axis=1) / np.where(square > 0, square, 1.0)
    apart = points - starts - np.clip(share, 0.0, 1.0)[:, None] * along
    return np.asarray(np.sqrt((apart * apart).sum(axis=1)))
