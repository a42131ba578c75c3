"""Where a recording was driven: positions on Earth from poses or fixes, about once a second."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.assets import ego_poses
from bagassets.assets.track import FILE, TRACK, TrackParams, _thinned
from bagassets_tests.facts import MadeUpInputs
from bagassets_tests.pose_data import IMU, NAVSAT, ODOMETRY, T0, Recorded, S, Written, fix, imu, odometry
from bagassets_tests.posed import Posed, at, truth

ODOM = {"source": "odometry", "topic": "/odom"}


def odometries(times):
    return [("/odom", ODOMETRY, at(t) + 4_000_000, odometry(at(t), truth(t))) for t in times]


def tracked(folder, posed, entries, clock="header"):
    """The content of the track of a recording with these poses."""
    recording = Recorded(*entries)
    inputs = MadeUpInputs(
        recording.inventory(),
        artifacts={"ego_poses": posed.artifact},
        trajectory=ego_poses.load_trajectory(posed.artifact),
        recording=recording,
    )
    use = TRACK.use(TrackParams(clock), inputs)[""]
    made = Written(folder / "track", partial(TRACK.make, use, inputs))
    return made.artifact.read_json(FILE), made.summary


def driven_north(seconds):
    """A fix each tenth of a second, a millionth of a degree farther north each time."""
    stamps = [T0 + round(t * S) for t in seconds]
    fixes = [("/fix", NAVSAT, s + 7, fix(s, 48 + (s - T0) / S / 1e5, 11.5, 500.0)) for s in stamps]
    return fixes + [("/imu", IMU, s + 7, imu(s, (1.0, 0.0, 0.0, 0.0))) for s in stamps]


def test_poses_from_positions_on_earth_lie_there(tmp_path):
    entries = driven_north(np.arange(0, 3.25, 0.1))
    posed = Posed(tmp_path, {"source": "navsat", "topic": "/fix", "imu": "/imu"}, *entries)
    content, summary = tracked(tmp_path, posed, entries)
    assert summary == {"source": "ego_poses", "points": 5}
    stamps = [stamp for stamp, _, _ in content["points"]]
    assert stamps == [T0, T0 + S, T0 + 2 * S, T0 + 3 * S, T0 + round(3.2 * S)]
    for stamp, lat, lon in content["points"]:
        assert lat == pytest.approx(48 + (stamp - T0) / S / 1e5, abs=1.1e-7)
        assert lon == pytest.approx(11.5, abs=1.1e-7)
    # A hundred-thousandth of a degree is 1.11 m.
    assert [round(y / 1.11194, 1) for _, _, y in content["local"]] == [0.0, 1.0, 2.0, 3.0, 3.2]


@pytest.mark.parametrize(("clock", "late_ns"), [("header", 0), ("log", 7)])
def test_with_other_poses_the_fixes_say_where(tmp_path, clock, late_ns):
    poses, fixes = odometries(np.arange(0, 2.5, 0.1)), driven_north(np.arange(0, 2.5, 0.1))
    content, summary = tracked(tmp_path, Posed(tmp_path, ODOM, *poses), [*poses, *fixes], clock)
    assert summary == {"source": "/fix", "points": 3}
    assert content["points"] == [[T0 + n * S + late_ns, round(48 + n / 1e5, 7), 11.5] for n in range(3)]
    assert [stamp for stamp, _, _ in content["local"]] == [at(0.0), at(1.0), at(2.0), at(2.4)]


def test_stray_fixes_are_on_no_map(tmp_path):
    poses, fixes = odometries(np.arange(0, 4.5, 0.1)), driven_north(np.arange(0, 4.5, 0.1))
    fixes[0][3].latitude += 0.3
    content, _ = tracked(tmp_path, Posed(tmp_path, ODOM, *poses), [*poses, *fixes])
    assert [lat for _, lat, _ in content["points"]] == [round(48 + n / 1e5, 7) for n in range(1, 5)]


def test_without_fixes_nothing_says_where(tmp_path):
    poses = odometries(np.arange(0, 2.5, 0.1))
    content, summary = tracked(tmp_path, Posed(tmp_path, ODOM, *poses), poses)
    assert summary == {"source": None, "points": 0}
    assert (content["source"], content["points"]) == (None, [])
    assert len(content["local"]) == 4


def test_a_fixed_pose_is_one_place(tmp_path):
    content, _ = tracked(tmp_path, Posed(tmp_path, {"source": "fixed"}), [])
    assert len(content["local"]) == 1


@given(st.lists(st.integers(0, 20 * S), min_size=1, unique=True).map(sorted))
def test_thinned_stamps_are_a_second_apart_but_for_the_last(stamps):
    chosen = _thinned(stamps)
    assert (chosen[0], chosen[-1]) == (0, len(stamps) - 1)
    apart = np.diff(np.array(stamps)[chosen])
    assert (apart[:-1] >= S).all()
    assert (apart > 0).all()
    for index, stamp in enumerate(stamps):
        before = [stamps[other] for other in chosen if other <= index]
        assert stamp - before[-1] < S or index == len(stamps) - 1
