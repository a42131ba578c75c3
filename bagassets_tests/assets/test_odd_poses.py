"""Ego poses of sources that stray, start before they know, or overlap in time; and near-misses, which stay as they are."""

import math

import numpy as np
import pytest

from bagassets.assets.pose_outliers import overlaps, trusted_fixes
from bagassets.assets.quality.evidence import Evidence
from bagassets.assets.quality.pose_rules import poses_cover_sensors
from bagassets.base.errors import LossLimitError, PoseError
from bagassets.formats.nuscenes.part_checks import PART_CHECKS
from bagassets.geometry.se3 import SE3
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Limits
from bagassets.recipe.model_checks import PosesCheck
from bagassets.recordings.open import open_recording
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.oddities import BOOTED_NS, SET_AFTER_NS, SET_BACK_NS
from bagassets.sample.recipe import sample_recipe
from bagassets.store.store import Store
from bagassets_tests.ncom_data import ETHERNET, ethernet, ncom
from bagassets_tests.pose_data import NAVSAT, ODOMETRY, TFMESSAGE, S, about_z, fix, odometry, tf, transform
from bagassets_tests.posed import ORIGIN, Posed, at, truth
from bagassets_tests.sample_drives import build_recordings

pytestmark = pytest.mark.once

TIMES = np.arange(0.0, 4.0, 0.02)
ODOM = {"source": "odometry", "topic": "/odom"}
GNSS = {"source": "navsat", "topic": "/fix"}
LIMIT = Limits(lost_messages=0.05)
OUT_OF_REACH = "its position is out of reach from those before and after it"


# latitude, longitude and height at each time
PLACES = np.stack(ORIGIN.to_geodetic(np.array([truth(t).translation for t in TIMES])), axis=1).tolist()


def fixes(astray=(), lat=0.0, alt=0.0):
    """Fixes of the drive, of which some are moved to the north, in degrees, and up."""
    moved = [np.add(place, (lat, 0.0, alt)) if n in astray else place for n, place in enumerate(PLACES)]
    return [("/fix", NAVSAT, at(t), fix(at(t), *place)) for t, place in zip(TIMES, moved, strict=True)]


def odometries(times, pose=truth, stamp=at, later=0.0):
    return [("/odom", ODOMETRY, at(t + later), odometry(stamp(t), pose(t))) for t in times]


class TestStrayFixes:
    """The origin is the first fix that most others can be reached from."""

    @pytest.mark.parametrize("off_deg", [4.6, 0.3, 0.02, -47.0])
    @pytest.mark.parametrize(
        "astray", [{0}, {0, 1, 2, 3, 4}, {0, 90, 91, 92}, {199, 198}], ids=["one", "five", "later", "end"]
    )
    def test_they_change_nothing_but_the_counts(self, tmp_path, off_deg, astray):
        made = Posed(tmp_path / "odd", GNSS, *fixes(astray, off_deg), limits=LIMIT)
        others = [entry for n, entry in enumerate(fixes()) if n not in astray]
        twin = Posed(tmp_path / "twin", GNSS, *others)
        assert made.table == twin.table
        assert made.json["origin"] == twin.json["origin"]
        assert made.json["counts"] == {
            "read": 200, "written": 200 - len(astray), "merged": 0, "lost": {OUT_OF_REACH: len(astray)},
        }  # fmt: skip

    def test_the_world_is_level(self, tmp_path):
        made = Posed(tmp_path, GNSS, *fixes({0}, 4.6))
        first = truth(TIMES[1])
        for row in made.table:
            t = (row["stamp_ns"] - at(0.0)) / 1e9
            expected = np.array(truth(t).translation) - np.array(first.translation)
            np.testing.assert_allclose([row["x"], row["y"], row["z"]], expected, atol=1e-3)

    def test_those_before_the_first_good_one_are_no_damage_and_later_ones_are(self, tmp_path):
        assert Posed(tmp_path / "a", GNSS, *fixes(set(range(20)), 4.6)).summary["count"] == 180
        with pytest.raises(
            LossLimitError, match=r"from /fix: 20 of 200 messages .* its position is out of reach"
        ):
            Posed(tmp_path / "b", GNSS, *fixes(set(range(100, 120)), 4.6))

    def test_a_first_height_that_is_wrong_or_not_known(self, tmp_path):
        twin = Posed(tmp_path / "twin", GNSS, *fixes()[1:])
        made = Posed(tmp_path / "wrong", GNSS, *fixes({0}, alt=-500.0))
        assert (made.table, made.json["origin"]) == (twin.table, twin.json["origin"])
        made = Posed(tmp_path / "none", GNSS, *fixes({0}, alt=math.nan))
        assert made.json["origin"]["alt"] == twin.json["origin"]["alt"]
        assert max(abs(row["z"]) for row in made.table) < 0.5

    def test_ncom(self, tmp_path):
        entries = [
            ("/ncom", ETHERNET, at(t), ethernet(at(t), ncom(0, lat + (4.6 if n < 3 else 0.0), lon, alt)))
            for n, (t, (lat, lon, alt)) in enumerate(zip(TIMES, PLACES, strict=True))
        ]
        source = {"source": "ncom", "topic": "/ncom"}
        made, twin = Posed(tmp_path / "a", source, *entries), Posed(tmp_path / "b", source, *entries[3:])
        assert (made.table, made.json["origin"]) == (twin.table, twin.json["origin"])
        assert made.json["counts"]["lost"] == {OUT_OF_REACH: 3}

    @pytest.mark.parametrize(
        "metres_of",
        [
            lambda t: 33.0 * t,  # 33 km
            lambda t: 20.0 * t + (3000.0 if t > 500 else 0.0) * (not 500 < t < 620),
            lambda t: 10.0 * t + 0.5 * (round(t) % 7 in (1, 2, 5)),
            lambda t: 10.0 * t + (300.0 if t > 400 else 0.0),
        ],
        ids=["a long drive", "a tunnel", "jumps of RTK", "between houses"],
    )
    def test_genuine_movement_is_kept(self, metres_of):
        times = np.array([t for t in range(1000) if not 500 < t < 620])
        north_m = np.array([metres_of(t) for t in times])
        lat, lon, alt = ORIGIN.to_geodetic(np.stack([0 * north_m, north_m, 0 * north_m], axis=1))
        assert trusted_fixes(times * S, lat, lon, alt).all()

    def test_a_receiver_that_stays_where_it_was_switched_off(self):
        """For eight minutes: the first of these fixes alone could be reached in time."""
        lat = np.where(np.arange(1200) < 500, 48.4, 48.0)
        trusted = trusted_fixes(np.arange(1200) * S, lat, np.full(1200, 11.0), np.zeros(1200))
        assert trusted.tolist() == [n >= 500 for n in range(1200)]

    def test_without_a_majority_nobody_knows_and_all_are_kept(self):
        lat = np.repeat([48.0, 49.0], 10)
        assert trusted_fixes(np.arange(20) * S, lat, np.full(20, 11.0), np.zeros(20)).all()

    def test_coordinates_of_a_source_that_begins_at_zero(self, tmp_path):
        """UTM is moved to a local origin, which zeros at the beginning must not be."""

        def utm(t):
            return (
                SE3()
                if t < 0.1
                else SE3(truth(t).rotation, tuple(np.add(truth(t).translation, (4e5, 5e6, 0))))
            )

        assert Posed(tmp_path, ODOM, *odometries(TIMES, utm)).json["origin"]["y"] == 5e6


class TestZeroQuaternions:
    @pytest.mark.parametrize("unset", [range(2), range(20), range(50, 54)], ids=["first", "many", "later"])
    def test_they_cost_their_poses(self, tmp_path, unset):
        entries = odometries(TIMES)
        for n in unset:
            zero(entries[n])
        made = Posed(tmp_path / "odd", ODOM, *entries)
        twin = Posed(tmp_path / "twin", ODOM, *(e for n, e in enumerate(entries) if n not in unset))
        assert made.table == twin.table
        assert made.json["counts"]["lost"] == {"its quaternion is zero": len(unset)}

    def test_all_of_them_are_refused_with_a_way_out(self, tmp_path):
        entries = odometries(TIMES)
        for entry in entries:
            zero(entry)
        with pytest.raises(PoseError) as refused:
            Posed(tmp_path, ODOM, *entries)
        assert str(refused.value) == (
            "ego poses from /odom: none of 200 messages gives a pose (200 because its quaternion is zero); name another "
            "topic, or TF, as ego_pose in the recipe."
        )

    def test_transforms(self, tmp_path):
        """A few are lost; of all of them nothing is left, and the message says why."""
        entries = [
            ("/tf", TFMESSAGE, at(t), tf(transform(at(t), "odom", "base_link", truth(t)))) for t in TIMES
        ]
        source = {"source": "tf", "global_frame": "odom"}
        for number in (3, 200):
            for entry in entries[:number]:
                rotation = entry[3].transforms[0].transform.rotation
                rotation.w = rotation.x = rotation.y = rotation.z = 0.0
            if number < 200:
                made = Posed(tmp_path, source, *entries)
                assert made.json["counts"]["lost"] == {"its quaternion is not of unit length": number}
        with pytest.raises(
            PoseError, match=r"Some transforms in /tf cannot be used: its quaternion is not of unit length\."
        ):
            Posed(tmp_path / "none", source, *entries)

    def test_other_lengths_are_damage(self, tmp_path):
        entries = odometries(TIMES)
        for entry in entries[:4]:
            entry[3].pose.pose.orientation.w = 2.0
        with pytest.raises(LossLimitError, match=r"4 of 200 .* its quaternion is not of unit length"):
            Posed(tmp_path, ODOM, *entries)


def zero(entry):
    orientation = entry[3].pose.pose.orientation
    orientation.w = orientation.x = orientation.y = orientation.z = 0.0


def set_back(by_s, at_s=2.0):
    """A stamp by a clock that is set back."""
    return lambda t: at(t if t < at_s else t - by_s)


class TestOverlaps:
    """Two trajectories at the same time: nothing at that time has a pose."""

    @pytest.mark.parametrize("by_s", [0.503, 0.1503, 0.7511, 1.337])
    def test_a_clock_that_is_set_back(self, tmp_path, by_s):
        made = Posed(tmp_path, ODOM, *odometries(TIMES, stamp=set_back(by_s)))
        now = np.arange(0.0, 4.0 - by_s - 0.02, 0.0037)
        positions, _, valid = made.trajectory.at(np.array([at(t) for t in now]))
        shared = (now > 2.0 - by_s) & (now < 1.98)
        assert not valid[shared].any()
        # At most two poses beyond either end are lost with them.
        assert valid[(now < 2.0 - by_s - 0.05) | (now > 2.05)].all()
        for t, position in zip(now[valid], positions[valid], strict=True):
            expected = truth(t if t < 2.0 - by_s / 2 else t + by_s).translation
            np.testing.assert_allclose(position, expected, atol=1e-3)
        assert list(made.json["counts"]["lost"]) == ["two trajectories overlap at its time"]
        (hole,) = made.json["holes_ns"]
        assert at(2.0 - by_s) - S // 20 < hole[0] < at(2.0 - by_s) < at(1.98) < hole[1] < at(2.05)

    def test_it_is_said(self, tmp_path):
        made = Posed(tmp_path, ODOM, *odometries(TIMES, stamp=set_back(0.503)))
        stamps = {"CAM_FRONT": np.array([at(t) for t in np.arange(0.0, 3.4, 0.1)])}
        said, lacking = poses_cover_sensors(made.trajectory, stamps, PosesCheck()).problems
        assert lacking.startswith("CAM_FRONT: 6 of 34 readings have no ego pose")
        assert said.startswith("ego poses go to and fro between two trajectories once for 0.5")
        assert said.endswith(
            "as if a clock was set back or two nodes published; readings in that time are left out"
        )

    def test_a_second_publisher_for_a_while_costs_that_while(self, tmp_path):
        aside = SE3(translation=(0.0, 0.29, 0.0))
        second = odometries(np.arange(1.007, 2.0, 0.02), lambda t: truth(t) @ aside)
        made = Posed(tmp_path, ODOM, *odometries(TIMES), *second)
        (hole,) = made.json["holes_ns"]
        assert at(0.93) < hole[0] < at(1.007) < at(1.987) < hole[1] < at(2.07)

    def test_noise_does_not_hide_two_publishers(self, tmp_path):
        random = np.random.default_rng(1)

        def noisy(t, aside=0.0):
            return truth(t) @ SE3(translation=tuple(random.normal(size=3) * 0.02 + (0.0, aside, 0.0)))

        times = np.arange(0.0, 20.0, 0.02)
        second = odometries(times + 0.007, lambda t: noisy(t, 0.29))
        with pytest.raises(PoseError, match="between two trajectories"):
            Posed(tmp_path, ODOM, *odometries(times, noisy), *second)

    @pytest.mark.parametrize("metres", [0.29, 20.0, 5000.0])
    def test_two_publishers_are_refused(self, tmp_path, metres):
        aside = SE3(translation=(0.0, metres, 0.0))
        second = odometries(TIMES + 0.007, lambda t: truth(t) @ aside)
        with pytest.raises(PoseError) as refused:
            Posed(tmp_path, ODOM, *odometries(TIMES), *second)
        assert "poses go to and fro between two trajectories, first at 2023-11-14T22:13:20.0" in str(
            refused.value
        )
        assert str(refused.value).endswith(
            "two nodes publish, or a clock was set back. Name a topic, or TF frames, that one node publishes in ego_pose of the "
            "recipe."  # of nearly all poses no clock is to blame
        )

    def test_two_that_differ_in_their_heading_alone(self, tmp_path):
        turned = SE3.create(about_z(0.1), (0, 0, 0))
        with pytest.raises(PoseError, match="between two trajectories"):
            Posed(tmp_path, ODOM, *odometries(TIMES), *odometries(TIMES + 0.007, lambda t: truth(t) @ turned))

    def test_two_at_slightly_different_rates_are_one_span(self):
        times = np.sort(np.concatenate([np.arange(0.0, 8.0, 0.02), np.arange(0.003, 8.0, 1 / 48)]))
        second = np.isin(times, np.arange(0.003, 8.0, 1 / 48))
        rows = np.array([[*truth(t).translation, *truth(t).rotation] for t in times])
        rows[second, 1] += 0.29
        ((first, last),) = overlaps(rows)
        assert first == 1
        assert last > len(rows) - 12  # after the last change of order, a row is too short

    def test_two_broadcasters_of_a_transform(self, tmp_path):
        aside = SE3(translation=(0.0, 0.29, 0.0))
        entries = [
            ("/tf", TFMESSAGE, at(t), tf(transform(at(t), "odom", "base_link", pose)))
            for n, t in enumerate(np.arange(0.0, 4.0, 0.01))
            for pose in (truth(t) @ aside if n % 2 else truth(t),)
        ]
        with pytest.raises(PoseError, match=r"from TF: 3.. of 400 poses go to and fro"):
            Posed(tmp_path, {"source": "tf", "global_frame": "odom"}, *entries)

    def test_what_only_looks_alike_is_kept(self):
        random = np.random.default_rng(5)
        path = np.array([[*truth(t).translation, *truth(t).rotation] for t in np.arange(0.0, 60.0, 0.02)])
        standing = np.repeat(path[:1], len(path), axis=0)
        for name, rows, noise_m in (
            ("clean", path, (0.0, 0.0, 0.0)),
            ("noisy", path, (0.5, 0.5, 0.5)),
            ("noisy on the ground", path, (0.3, 0.3, 0.0)),
            ("standing", standing, (0.5, 0.5, 0.5)),
            ("standing on the ground", standing, (1.0, 1.0, 0.0)),
        ):
            moved = rows.copy()
            moved[:, :3] += random.normal(size=(len(rows), 3)) * noise_m
            assert overlaps(moved) == [], name
        jumped = path.copy()
        jumped[len(path) // 2 :, :3] += (3.0, -2.0, 0.0)
        assert overlaps(jumped) == []
        corrected = path.copy()
        corrected[::50, :3] += (0.0, 0.3, 0.0)  # once a second, as if a filter took a single measurement in
        assert overlaps(corrected) == []

    def test_stamps_in_pairs_are_one_source(self, tmp_path):
        """As of a bus that delivers two messages at once."""
        entries = odometries(TIMES, stamp=lambda t: at(t) + (round(t / 0.02) % 2 == 0) * S // 52)
        assert Posed(tmp_path, ODOM, *entries).json["counts"]["lost"] == {}


def recorded(folder, *odd):
    """The truth of a short drive with oddities, and its messages about motion."""
    drive = write_recordings([Target(folder / "drive.mcap", "mcap")], 3, duration_s=0.6, odd=odd)
    with open_recording(folder / "drive.mcap") as recording:
        messages = recording.messages(["/odom", "/gnss/fix", "/imu/data"])
        return drive, [(m.topic, m.msgtype, m.log_time_ns, recording.decode(m)) for m in messages]


class TestSample:
    def test_what_a_source_sends_before_it_knows(self, tmp_path):
        drive, messages = recorded(tmp_path, "stray-fixes", "zero-quaternions")
        made = Posed(tmp_path / "odometry", ODOM, *messages)
        assert made.json["counts"] == {
            "read": 31,
            "written": 21,
            "merged": 0,
            "lost": {"its quaternion is zero": 10},
        }
        for row in made.table:
            expected = drive.odom_SE3_ego(row["stamp_ns"]).translation
            np.testing.assert_allclose([row["x"], row["y"], row["z"]], expected, atol=1e-6)
        source = {"source": "navsat", "topic": "/gnss/fix", "imu": "/imu/data"}
        made = Posed(tmp_path / "navsat", source, *messages)
        assert made.json["counts"]["lost"] == {OUT_OF_REACH: 2}
        third = drive.odom_SE3_ego(drive.start_ns + S // 5).translation
        assert made.table[0]["stamp_ns"] == drive.start_ns + S // 5
        for row in made.table:
            expected = np.subtract(drive.odom_SE3_ego(row["stamp_ns"]).translation, third)
            np.testing.assert_allclose([row["x"], row["y"], row["z"]], expected, atol=1e-3)

    def test_two_publishers(self, tmp_path):
        _, messages = recorded(tmp_path, "two-publishers")
        with pytest.raises(PoseError, match="60 of 62 poses go to and fro between two trajectories"):
            Posed(tmp_path / "odometry", ODOM, *messages)


def build(folder, odd, duration_s):
    """The truth of a drive with an oddity, and asset -> what was made of it."""
    drive = write_recordings(
        [Target(folder / "recordings" / "drive.mcap", "mcap")], 3, duration_s=duration_s, odd=(odd,)
    )
    recipe = sample_recipe().replace("/odom}", "/odom, max_gap_s: 1}")
    (folder / "recipe.yaml").write_text(recipe.replace("length_s: 20", "length_s: 20\n  min_length_s: 0.5"))
    return drive, build_recordings(load_recipe(folder / "recipe.yaml"))["drive.mcap"]


def pose_finding(folder, made):
    recipe = load_recipe(folder / "recipe.yaml")
    evidence = Evidence(recipe, recipe.rigs[0], Store(recipe.store_path), lambda asset: made[asset].artifact)
    (check,) = [check for check in PART_CHECKS if check.name == "poses_cover_sensors"]
    return check.rule(evidence)


class TestBuilt:
    def test_lost_poses_are_said(self, tmp_path):
        _, made = build(tmp_path, "zero-quaternions", 1.0)
        (warning,) = pose_finding(tmp_path, made).warnings
        assert warning.startswith(
            "10 of 51 messages of /odom gave no pose (10 because its quaternion is zero)."
        )
        recipe = tmp_path / "recipe.yaml"
        recipe.write_text(recipe.read_text() + "limits: {reported_losses: 0.2}\n")
        assert "gave no pose" not in str(pose_finding(tmp_path, made))

    def test_a_clock_that_is_set_late_gives_two_scenes(self, tmp_path):
        drive, made = build(tmp_path, "clock-set-late", 2.6)
        tables = made["nuscenes_tables"].artifact
        assert [row["nbr_samples"] for row in tables.read_json("scene.json")] == [4, 2]
        rows = tables.read_json("ego_pose.json")
        assert len(rows) > 100
        for row in rows:
            stamp_ns = row["timestamp"] * 1000
            true_ns = stamp_ns if stamp_ns > drive.start_ns else stamp_ns - BOOTED_NS + drive.start_ns
            np.testing.assert_allclose(row["translation"], drive.odom_SE3_ego(true_ns).translation, atol=1e-3)

    @pytest.mark.long
    def test_what_was_recorded_twice_is_in_no_dataset(self, tmp_path):
        drive, made = build(tmp_path, "clock-set-back", 3.2)
        set_ns = drive.start_ns + SET_AFTER_NS
        tables = made["nuscenes_tables"].artifact
        rows = tables.read_json("ego_pose.json")
        assert len(rows) > 80
        for row in rows:
            stamp_ns = row["timestamp"] * 1000
            assert not set_ns - SET_BACK_NS < stamp_ns < set_ns
            true_ns = stamp_ns if stamp_ns < set_ns else stamp_ns + SET_BACK_NS
            np.testing.assert_allclose(row["translation"], drive.odom_SE3_ego(true_ns).translation, atol=1e-3)
        lost = tables.read_json("facts.json")["counts"]["channels"]["CAM_FRONT"]["without_pose"]
        # The world jumps there, so no scene leads across.
        before, after = tables.read_json("scene.json")
        samples = {row["token"]: 1000 * row["timestamp"] for row in tables.read_json("sample.json")}
        assert samples[before["last_sample_token"]] < set_ns - SET_BACK_NS
        assert samples[after["first_sample_token"]] >= set_ns
        assert 10 <= lost <= 12  # five images of each time, and those next to them
