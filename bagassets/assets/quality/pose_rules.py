"""Rules about ego poses: readings have one, and the vehicle does not jump."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from bagassets.assets.quality.finding import Finding, clock
from bagassets.assets.timeline.keyframes import Stamps
from bagassets.base.json_types import JsonMapping
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model_checks import PosesCheck

# Of the course over ground: what most of them agree in is no noise.
_LEG_M, _FEWEST_LEGS, _STEADY, _ASKEW_DEG = 1.0, 20, 0.9, 30.0


def poses_cover_sensors(
    trajectory: Trajectory, stamps_ns: Mapping[str, Stamps], check: PosesCheck, losses: Iterable[str] = ()
) -> Finding:
    """Check that readings of each channel have an ego pose at their time.

    Args:
        trajectory: `global_SE3_ego`.
        stamps_ns: channel -> (N,) stamps of its readings.
        check: thresholds.
        losses: sentences about messages without pose, which readings between others need not miss.
    """
    problems = []
    shares = {}
    for name, stamps in sorted(stamps_ns.items()):
        if not len(stamps):
            continue
        _, _, valid = trajectory.at(stamps)
        with_pose = int(np.count_nonzero(valid))
        shares[name] = round(with_pose / len(stamps), 4)
        if with_pose < check.min_share * len(stamps):
            first = int(stamps[~valid][0])
            without = len(stamps) - with_pose
            lack = "has no ego pose, that" if without == 1 else "have no ego pose, the first"
            problems.append(
                f"{name}: {without} of {len(stamps)} readings {lack} at {clock(first)}; a share of {check.min_share:g} is expected to have one{_rarity(trajectory)}"
            )
    problems = [*_overlaps(trajectory), *problems, *_jumps(trajectory, check)]
    return Finding(problems, {"with_pose": shares}, list(losses))


def poses_complete(counts: JsonMapping, what: str, max_lost: float) -> Iterator[str]:
    """Yield a sentence if, by `counts` of `ego_poses.json`, a larger share of `what`, as `messages of /odom`, gave no pose."""
    number = sum(counts["lost"].values())
    if number <= max_lost * counts["read"]:
        return
    reasons = sorted(counts["lost"].items(), key=lambda item: (-item[1], item[0]))
    why = ", ".join(f"{count} because {reason}" for reason, count in reasons)
    yield (
        f"{number} of {counts['read']} {what} gave no pose ({why}). If that is acceptable, raise "
        "limits.reported_losses in the recipe; else name another source as ego_pose"
    )


def heading_askew(trajectory: Trajectory, imu: str) -> Iterator[str]:
    """Yield a sentence if the vehicle moves, nearly all of the time, at one angle to where an Imu says that it heads.

    So it is if the Imu is mounted otherwise than transforms say, counts its heading from where it was switched on, or
    clockwise from north; then the angle also changes, but that of course and heading together does not.
    """
    covered_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(trajectory.positions_m[:, :2], axis=0).T)))
    ends = np.unique(np.searchsorted(covered_m, np.arange(0.0, covered_m[-1], _LEG_M)))
    if len(ends) <= _FEWEST_LEGS:
        return
    legs = np.diff(trajectory.positions_m[ends, :2], axis=0)
    w, x, y, z = trajectory.rotations[ends].T
    headings = np.exp(1j * np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    headings = (headings[1:] + headings[:-1]) / 2.0
    courses = np.exp(1j * np.arctan2(legs[:, 1], legs[:, 0]))
    apart, together = (courses * headings.conj()).mean(), (courses * headings).mean()
    apart_deg = float(np.degrees(np.angle(apart)))
    if abs(apart) > _STEADY and _ASKEW_DEG < abs(apart_deg) < 180 - _ASKEW_DEG:
        what = f"moves {abs(apart_deg):.0f} degrees to the {'left' if apart_deg > 0 else 'right'} of where it heads"
    elif abs(together) > _STEADY > abs(apart):
        what = "heads to the right when it turns left"
    else:
        return
    yield (
        f"the vehicle {what}, by the orientation in {imu}: it must be east-north-up (REP 103), and that of the Imu as mounted; "
        "leave `imu` out of ego_pose to have the course over ground instead"
    )


def _rarity(trajectory: Trajectory) -> str:
    """Return the end of a sentence about readings without pose, if all poses are too far apart; else ""."""
    apart_ns = np.median(np.diff(trajectory.stamps_ns)) if len(trajectory.stamps_ns) > 1 else 0
    if apart_ns <= trajectory.max_gap_ns:
        return ""
    return f"; poses come every {apart_ns / 1e9:.3g} s only: raise max_gap_s of ego_pose ({trajectory.max_gap_ns / 1e9:g})"


def _overlaps(trajectory: Trajectory) -> Iterator[str]:
    if not trajectory.holes_ns:
        return
    (first_ns, last_ns), number = trajectory.holes_ns[0], len(trajectory.holes_ns)
    often = "once" if number == 1 else f"{number} times, first"
    yield (
        f"ego poses go to and fro between two trajectories {often} for {(last_ns - first_ns) / 1e9:.2f} s from {clock(first_ns)}, "
        "as if a clock was set back or two nodes published; readings in that time are left out"
    )


def _jumps(trajectory: Trajectory, check: PosesCheck) -> Iterator[str]:
    seconds = np.diff(trajectory.stamps_ns) / 1e9
    moves = np.diff(trajectory.positions_m, axis=0)
    speeds = np.sqrt((moves * moves).sum(axis=1)) / seconds
    # Between poses within a millisecond, noise alone gives high speeds.
    jumps = np.flatnonzero((speeds > check.max_speed_mps) & (seconds > 1e-3))
    if not len(jumps):
        return
    first = int(jumps[0])
    often = "once, by" if len(jumps) == 1 else f"{len(jumps)} times, first by"
    yield (
        f"ego poses jump {often} {speeds[first] * seconds[first]:.1f} m at "
        f"{clock(int(trajectory.stamps_ns[first]))} ({speeds[first]:.0f} m/s; "
        f"at most {check.max_speed_mps:g} m/s expected)"
    )
