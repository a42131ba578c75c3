"""The asset `ego_poses`: every source against a known motion, and what is missing or contradicts."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bagassets.assets.asset import Use
from bagassets.assets.ego_poses import EGO_POSES, Unposed
from bagassets.assets.pose_samples import MovingRig
from bagassets.base.errors import DecodeError, LossLimitError, PoseError
from bagassets.geometry.se3 import SE3
from bagassets.geometry.wgs84 import utm_track
from bagassets.recipe.model import Limits
from bagassets.recipe.model_poses import OdometrySource, TfSource
from bagassets_tests.facts import MadeUpFacts, use_of
from bagassets_tests.pose_data import (
    IMU,
    NAVSAT,
    ODOMETRY,
    POSE,
    POSE_COVARIANCE,
    T0,
    TFMESSAGE,
    Recorded,
    S,
    about_z,
    fix,
    imu,
    odometry,
    pose_stamped,
    pose_with_covariance,
    tf,
    transform,
)
from bagassets_tests.posed import BETWEEN, ORIGIN, SPEED, TIMES, Posed, at, rig, static, truth


def odometries(times, pose=truth, **options):
    return [("/odom", ODOMETRY, at(t) + 4_000_000, odometry(at(t), pose(t), **options)) for t in times]


ODOM = {"source": "odometry", "topic": "/odom"}
TRANSFORM = "geometry_msgs/msg/TransformStamped"


class TestTopics:
    """Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped."""

    @pytest.mark.parametrize(
        ("source", "entries"),
        [
            (ODOM, odometries(TIMES)),
            (
                {"source": "pose", "topic": "/pose"},
                [("/pose", POSE, at(t), pose_stamped(at(t), truth(t))) for t in TIMES],
            ),
            (
                {"source": "pose", "topic": "/pose"},
                [("/pose", POSE_COVARIANCE, at(t), pose_with_covariance(at(t), truth(t))) for t in TIMES],
            ),
            (
                {"source": "pose", "topic": "/vicon/arm/arm", "frame": "base_link"},
                [
                    ("/vicon/arm/arm", TRANSFORM, at(t), transform(at(t), "map", "vicon/arm/arm", truth(t)))
                    for t in TIMES
                ],
            ),
        ],
    )
    def test_between_messages_to_a_millimetre(self, tmp_path, source, entries):
        made = Posed(tmp_path, source, *entries)
        metres, radians = made.errors_m_rad(BETWEEN)
        assert metres < 1e-3
        assert radians < 1e-6
        assert made.summary["count"] == len(TIMES)
        assert made.json["origin"] is None
        assert made.json["global_frame"] == ("odom" if source is ODOM else "map")

    @settings(deadline=None, max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(st.permutations(range(25)), st.sets(st.integers(0, 24), max_size=4))
    def test_order_and_repetition_of_messages_do_not_matter(self, tmp_path_factory, order, repeated):
        entries = odometries(np.arange(25) * 0.02)
        shuffled = [
            (topic, kind, T0 + i, message)
            for i, (topic, kind, _, message) in enumerate([entries[i] for i in [*order, *sorted(repeated)]])
        ]
        plain = Posed(tmp_path_factory.mktemp("a"), ODOM, *entries)
        mixed = Posed(tmp_path_factory.mktemp("b"), ODOM, *shuffled)
        assert mixed.table == plain.table
        assert mixed.json["counts"]["merged"] == len(repeated)

    def test_the_clock_of_the_recipe(self, tmp_path):
        late = [(topic, kind, log_ns + S, message) for topic, kind, log_ns, message in odometries(TIMES)]
        assert Posed(tmp_path / "a", ODOM, *late).table[0]["stamp_ns"] == T0
        assert Posed(tmp_path / "b", ODOM, *late, clock="log").table[0]["stamp_ns"] == T0 + S + 4_000_000

    def test_stamps_that_were_never_set(self, tmp_path):
        entries = [("/odom", ODOMETRY, at(t), odometry(0, truth(t))) for t in TIMES]
        with pytest.raises(PoseError, match=r"from /odom: all header stamps are zero; set `clock: log`"):
            Posed(tmp_path / "a", ODOM, *entries)
        assert Posed(tmp_path / "b", ODOM, *entries, clock="log").errors_m_rad(BETWEEN)[0] < 1e-3

    def test_a_single_pose_at_any_time_but_zero_is_one(self, tmp_path):
        once = [("/odom", ODOMETRY, at(0.0), odometry(at(0.0), truth(0.0)))] * 2
        assert Posed(tmp_path, ODOM, *once).json["counts"] == {
            "read": 2,
            "written": 1,
            "merged": 1,
            "lost": {},
        }

    def test_the_first_of_two_poses_at_a_stamp_counts(self, tmp_path):
        entries = [*odometries([0.0, 0.1]), ("/odom", ODOMETRY, at(1.0), odometry(at(0.1), truth(9.0)))]
        made = Posed(tmp_path, ODOM, *entries)
        assert made.table[1]["x"] == pytest.approx(truth(0.1).translation[0])
        assert made.json["counts"] == {"read": 3, "written": 2, "merged": 1, "lost": {}}

    def test_no_pose_in_a_gap(self, tmp_path):
        times = [t for t in TIMES if not 0.5 < t < 1.2]
        made = Posed(tmp_path, ODOM | {"max_gap_s": 0.5}, *odometries(times))
        _, _, valid = made.trajectory.at(np.array([at(0.4), at(0.8), at(1.3)]))
        assert valid.tolist() == [True, False, True]

    def test_poses_of_another_frame_of_the_vehicle(self, tmp_path):
        """The odometry tracks the rear axle; the ego frame sits elsewhere on the car."""
        axle_SE3_ego = SE3.create(about_z(0.2), (1.4, 0.1, 0.3))
        entries = odometries(TIMES, lambda t: truth(t) @ axle_SE3_ego.inverse(), child="/axle")
        made = Posed(tmp_path, ODOM, *entries, static("axle", "base_link", axle_SE3_ego))
        metres, radians = made.errors_m_rad(BETWEEN)
        assert metres < 1e-3
        assert radians < 1e-6

    @pytest.mark.parametrize("where", ["tf", "urdf"])
    def test_the_other_frame_from_a_urdf_or_a_fixed_joint_in_tf(self, tmp_path, where):
        entries = odometries([0.0, 0.1], lambda _: SE3.create((1, 0, 0, 0), (5, 0, 0)), child="foot")
        urdf = None
        if where == "tf":
            joint = SE3.create((1, 0, 0, 0), (0, 0, 0.3))
            entries += [
                ("/tf", TFMESSAGE, at(t), tf(transform(at(t), "foot", "base_link", joint))) for t in (0, 1)
            ]
        else:
            urdf = (
                b'<robot name="r"><joint name="j" type="fixed"><origin xyz="0 0 0.3"/>'
                b'<parent link="foot"/><child link="base_link"/></joint></robot>'
            )
        made = Posed(tmp_path, ODOM, *entries, urdf=urdf)
        assert [made.table[0][axis] for axis in "xyz"] == [5.0, 0.0, 0.3]

    def test_a_frame_that_nothing_relates_to_the_ego_frame(self, tmp_path):
        with pytest.raises(
            PoseError,
            match=r"/odom gives poses of imu, not of base_link: no transform from base_link to imu: .* not a frame "
            r"known here .*Correct ego_frame in the recipe, or name in ego_pose\.frame",
        ):
            Posed(tmp_path, ODOM, *odometries(TIMES, child="imu"))

    def test_the_recipe_may_say_whose_pose_it_is(self, tmp_path):
        made = Posed(tmp_path, ODOM | {"frame": "base_link"}, *odometries(TIMES, child="camera_pose_frame"))
        assert made.errors_m_rad([0.5])[0] < 1e-3

    def test_odometry_without_child_frame_is_of_the_ego_frame(self, tmp_path):
        assert Posed(tmp_path, ODOM, *odometries(TIMES, child="")).errors_m_rad([0.5])[0] < 1e-3

    def test_poses_of_two_global_frames_are_not_mixed(self, tmp_path):
        entries = [*odometries([0.0, 0.1, 0.2]), *odometries([0.3], frame="map")]
        made = Posed(tmp_path, ODOM, *entries)
        assert made.json["counts"]["lost"] == {"it is in another frame than the first pose": 1}

    def test_nonsense_is_counted_up_to_the_limit(self, tmp_path):
        broken = odometry(at(3.0), truth(3.0))
        broken.pose.pose.orientation.w = 7.0
        entries = [
            *odometries(TIMES),
            ("/odom", ODOMETRY, at(3.0), broken),
            ("/odom", ODOMETRY, at(3.1), DecodeError("its bytes do not fit")),
        ]
        made = Posed(tmp_path / "a", ODOM, *entries, limits=Limits(lost_messages=0.1))
        assert made.json["counts"]["lost"] == {
            "its quaternion is not of unit length": 1,
            "its bytes do not fit": 1,
        }
        with pytest.raises(
            LossLimitError, match=r"from /odom: 2 of 102 messages cannot be used.*accepts a share of 0\.01"
        ):
            Posed(tmp_path / "b", ODOM, *entries)

    @pytest.mark.parametrize(
        ("axis", "value", "reason"),
        [
            ("x", 1e308, "its position is farther away than any place on Earth"),
            ("z", -9e7, "its position is farther away than any place on Earth"),
            ("y", math.nan, "its position is not finite"),
            ("w", 1e308, "its quaternion is not of unit length"),
            ("x", 65536.5, "its position is out of reach from those before and after it"),
        ],
    )
    @pytest.mark.parametrize("place", [0, 40, len(TIMES) - 1])
    def test_a_pose_beyond_physics_is_a_lost_message(self, tmp_path, place, axis, value, reason):
        entries = odometries(TIMES)
        pose = entries[place][3].pose.pose
        setattr(pose.orientation if axis == "w" else pose.position, axis, value)
        made = Posed(tmp_path, ODOM, *entries)
        assert made.json["counts"]["lost"] == {reason: 1}
        assert made.json["origin"] is None
        others = Posed(tmp_path / "whole", ODOM, *odometries(TIMES)).table
        del others[place]
        assert made.table == others

    def test_a_vehicle_that_finds_itself_elsewhere_is_no_stray(self, tmp_path):
        def jumping(t):
            pose = truth(t)
            x_m, y_m, z_m = pose.translation
            return SE3(pose.rotation, (x_m + (5000.0 if t > 1.0 else 0.0), y_m, z_m))

        made = Posed(tmp_path, ODOM, *odometries(TIMES, jumping))
        assert made.json["counts"]["lost"] == {}
        assert made.summary["count"] == len(TIMES)

    def test_no_usable_pose_at_all(self, tmp_path):
        with pytest.raises(
            PoseError, match=r"from /odom: none of 1 messages gives a pose \(1 because its bytes do not fit\)"
        ):
            Posed(tmp_path, ODOM, ("/odom", ODOMETRY, T0, DecodeError("its bytes do not fit")))

    def test_a_topic_that_is_not_there(self, tmp_path):
        with pytest.raises(
            PoseError,
            match=r"ego poses: the recording has no messages on /odom, which ego_pose reads; it has /pose\.",
        ):
            Posed(tmp_path, ODOM, ("/pose", POSE, T0, pose_stamped(T0, truth(0))))

    def test_a_topic_of_another_type(self, tmp_path):
        with pytest.raises(PoseError, match=r"topic /odom carries sensor_msgs/msg/Imu, expected Odometry"):
            Posed(tmp_path, ODOM, ("/odom", IMU, T0, imu(T0, (1, 0, 0, 0))))

    def test_far_away_coordinates_are_moved_to_a_local_origin(self, tmp_path):
        """UTM, say: in float32 they would be 0.25 m off."""
        far = SE3.create((1, 0, 0, 0), (448_251.8, 5_411_932.7, 35.2))
        made = Posed(tmp_path, ODOM, *odometries(TIMES, lambda t: far @ truth(t)))
        assert made.json["origin"] == {"kind": "local", "x": 448_251.0, "y": 5_411_932.0, "z": 35.0}
        shift = SE3.create((1, 0, 0, 0), (0.8, 0.7, 0.2))
        assert made.errors_m_rad(BETWEEN, lambda t: shift @ truth(t))[0] < 1e-3

    def test_coordinates_that_are_local_stay_as_they_are(self, tmp_path):
        near = SE3.create((1, 0, 0, 0), (99_000.0, 0.0, 0.0))
        made = Posed(tmp_path, ODOM, *odometries([0.0, 0.1], lambda t: near @ truth(t)))
        assert made.table[0]["x"] == 99_000.0
        assert made.json["origin"] is None

    def test_length_of_the_path(self, tmp_path):
        made = Posed(tmp_path, ODOM, *odometries(TIMES))
        assert made.summary["length_m"] == pytest.approx(SPEED * TIMES[-1], rel=1e-3)


class TestTf:
    """A chain of transforms."""

    SOURCE = {"source": "tf", "global_frame": "map"}

    @staticmethod
    def chain(drift_times, odometry_times, mount=None):
        """map -> odom (slow), odom -> base (fast), base -> base_link (fixed); together `truth`."""
        mount = mount or SE3.create(about_z(0.1), (0.5, 0.0, 0.2))
        drift = lambda t: SE3.create(about_z(0.01 * t), (0.2 * t, 0.0, 0.0))
        entries = [
            ("/tf", TFMESSAGE, at(t) + 300_000_000, tf(transform(at(t), "/map", "odom", drift(t))))
            for t in drift_times
        ]
        entries += [
            (
                "/tf", TFMESSAGE, at(t) + 2_000_000,
                tf(transform(at(t), "odom", "base", drift(t).inverse() @ truth(t) @ mount.inverse())),
            )
            for t in odometry_times
        ]  # fmt: skip
        return entries, mount

    def test_edges_of_different_rates_and_latencies(self, tmp_path):
        entries, mount = self.chain(np.arange(-0.3, 2.5, 0.25), TIMES)
        made = Posed(tmp_path, self.SOURCE, *entries, static("base", "base_link", mount))
        metres, radians = made.errors_m_rad(BETWEEN)
        assert metres < 1e-3
        assert radians < 1e-5
        assert made.json["global_frame"] == "map"

    def test_a_fixed_joint_repeated_in_tf(self, tmp_path):
        entries, mount = self.chain(np.arange(-0.3, 2.5, 0.25), TIMES)
        entries += [
            ("/tf", TFMESSAGE, at(t), tf(transform(at(t), "base", "base_link", mount)))
            for t in np.arange(0, 2, 0.7)
        ]
        assert Posed(tmp_path, self.SOURCE, *entries).errors_m_rad(BETWEEN)[0] < 1e-3

    def test_a_correction_once_a_second_does_not_make_gaps(self, tmp_path):
        entries, mount = self.chain([0.1, 1.1], TIMES)
        made = Posed(tmp_path, self.SOURCE | {"max_gap_s": 0.1}, *entries, static("base", "base_link", mount))
        # Before the first and after the last correction that one holds; it drifts by 0.2 m/s.
        assert made.errors_m_rad([0.15, 0.6, 1.05])[0] < 0.01
        assert made.errors_m_rad([0.01, 1.9])[0] < 0.25
        assert made.json["counts"]["lost"] == {}

    def test_samples_without_the_other_edges_are_counted(self, tmp_path):
        entries, mount = self.chain(np.arange(0.5, 1.0, 0.02), TIMES)
        made = Posed(tmp_path, self.SOURCE, *entries, static("base", "base_link", mount))
        (reason,) = made.json["counts"]["lost"]
        assert reason == "other transforms on the way have no value at its time"
        assert made.table[0]["stamp_ns"] >= at(0.45)

    def test_the_log_clock(self, tmp_path):
        """Header stamps of a machine whose clock is an hour off."""
        entries = [
            ("/tf", TFMESSAGE, at(t), tf(transform(at(t) - 3600 * S, "map", "base_link", truth(t))))
            for t in TIMES
        ]
        made = Posed(tmp_path, self.SOURCE, *entries, clock="log")
        assert made.errors_m_rad(BETWEEN)[0] < 1e-3

    def test_a_static_edge_with_two_values(self, tmp_path):
        entries, mount = self.chain(np.arange(-0.3, 2.5, 0.25), TIMES)
        other = SE3.create(mount.rotation, (0.6, 0.0, 0.2))
        with pytest.raises(
            PoseError, match=r"base -> base_link is published as static \(/tf_static\) with different"
        ):
            Posed(
                tmp_path, self.SOURCE, *entries,
                static("base", "base_link", mount), static("base", "base_link", other, stamp_ns=5),
            )  # fmt: skip

    def test_an_edge_that_is_static_and_moves(self, tmp_path):
        """A placeholder of the localisation in `/tf_static`; the correction in `/tf` must not be left out without a word."""
        entries, mount = self.chain(np.arange(-0.3, 2.5, 0.25), TIMES)
        entries.append(static("base", "base_link", mount))
        with pytest.raises(PoseError, match=r"map -> odom is fixed in /tf_static and moves in /tf;"):
            Posed(tmp_path / "moves", self.SOURCE, *entries, static("map", "odom", SE3()))

    def test_only_where_that_can_be_are_poses_of_before_looked_at_again(self):
        chain = MovingRig("header", "base_link", 0.0, (), ("/tf_static",), ("/tf",), TfSource())
        assert EGO_POSES.action(Use(chain), None).version == 5
        for other in (
            replace(chain, tf_static=()),
            replace(chain, source=OdometrySource(topic="/odom")),
            Unposed(),
        ):
            assert EGO_POSES.action(Use(other), None).version == 4

    def test_a_missing_link(self, tmp_path):
        entries, _ = self.chain([0.0, 1.0], TIMES)
        with pytest.raises(
            PoseError,
            match=r"ego poses from TF: no transform from base_link to map: base_link is not a frame known here "
            r"\(known frames: base, map, odom\)\. Correct global_frame or ego_frame in the recipe",
        ):
            Posed(tmp_path, self.SOURCE, *entries)

    def test_two_trees(self, tmp_path):
        entries, mount = self.chain([], TIMES)
        with pytest.raises(PoseError, match="two trees with the roots odom and map"):
            Posed(
                tmp_path,
                self.SOURCE,
                *entries,
                static("base", "base_link", mount),
                static("map", "earth", SE3()),
            )

    def test_nothing_moves(self, tmp_path):
        entries = [("/tf", TFMESSAGE, at(t), tf(transform(at(t), "map", "base_link", SE3()))) for t in (0, 1)]
        with pytest.raises(PoseError, match=r"nothing between map and base_link moves; .* `source: fixed`"):
            Posed(tmp_path, self.SOURCE, *entries)

    def test_no_tf_in_the_recording(self, tmp_path):
        with pytest.raises(PoseError, match="no messages on /tf"):
            Posed(tmp_path, self.SOURCE, static("a", "b", SE3()))


@pytest.mark.parametrize(
    ("source", "topic", "words"),
    [
        ({"source": "navsat", "topic": "/imu"}, "/imu", "10 because it is a sensor_msgs/Imu, expected sensor_msgs/NavSatFix"),
        (
            {"source": "navsat", "topic": "/fix", "imu": "/again"}, "/again",
            "10 because no Imu orientation at its time",
        ),
    ],
)  # fmt: skip
def test_a_topic_of_another_type_is_reported_and_fails_in_a_sentence(tmp_path, source, topic, words):
    times = [n / 10 for n in range(10)]
    entries = fixes(times)
    if topic == "/again":
        entries += [("/again", *entry[1:]) for entry in fixes(times)]
    else:
        entries = turns(times)
    with pytest.raises(PoseError, match=words):
        Posed(tmp_path, source, *entries)


def fixes(times, antenna=SE3(), frame="gps", origin=ORIGIN):
    """Fixes of an antenna that sits at `antenna` on the vehicle."""
    made = []
    for t in times:
        place = np.array([(truth(t) @ antenna).translation])
        lat, lon, alt = (float(v[0]) for v in origin.to_geodetic(place))
        made.append(("/fix", NAVSAT, at(t), fix(at(t), lat, lon, alt, frame=frame)))
    return made


def turns(times, mount=SE3(), frame="imu"):
    return [("/imu", IMU, at(t), imu(at(t), (truth(t) @ mount).rotation, frame=frame)) for t in times]


GNSS = {"source": "navsat", "topic": "/fix"}
GNSS_IMU = GNSS | {"imu": "/imu"}


class TestNavSat:
    """Fixes on the ellipsoid become local metres, whose origin is kept."""

    def test_positions_and_orientations(self, tmp_path):
        made = Posed(tmp_path, GNSS_IMU, *fixes(TIMES), *turns(np.arange(-0.1, 2.1, 0.013)))
        metres, radians = made.errors_m_rad(BETWEEN)
        assert metres < 1e-3
        assert radians < 1e-5
        assert made.json["global_frame"] == "enu"
        assert made.json["helpers"]["/imu"]["lost"] == {}

    def test_the_origin_is_reported_with_its_utm_coordinates(self, tmp_path):
        origin = Posed(tmp_path, GNSS_IMU, *fixes(TIMES), *turns(TIMES)).json["origin"]
        grid = utm_track(np.array([48.137]), np.array([11.575]))
        assert origin["kind"] == "wgs84"
        assert (origin["lat"], origin["lon"], origin["alt"]) == pytest.approx(
            (48.137, 11.575, 520.0), abs=1e-9
        )
        assert origin["utm_zone"] == "32N"
        assert (origin["easting"], origin["northing"]) == pytest.approx(
            (grid.easting_m[0], grid.northing_m[0]), abs=1e-3
        )

    def test_the_utm_origin_is_the_published_one(self, tmp_path):
        """The Eiffel tower: 31 N 448251.795 5411932.678."""
        lat, lon = 48 + 51 / 60 + 29.52 / 3600, 2 + 17 / 60 + 40.20 / 3600
        entries = [("/fix", NAVSAT, at(t), fix(at(t), lat, lon + 1e-5 * t, 35.0)) for t in (0.0, 0.1)]
        origin = Posed(tmp_path, GNSS, *entries).json["origin"]
        assert origin["utm_zone"] == "31N"
        assert (origin["easting"], origin["northing"]) == pytest.approx((448251.795, 5411932.678), abs=1e-3)

    def test_the_antenna_and_the_imu_sit_where_tf_says(self, tmp_path):
        antenna, mount = (
            SE3.create((1, 0, 0, 0), (-0.6, 0.3, 1.5)),
            SE3.create((0.5, 0.5, 0.5, 0.5), (1, 1, 1)),
        )
        made = Posed(
            tmp_path, GNSS_IMU, *fixes(TIMES, antenna), *turns(np.arange(-0.1, 2.1, 0.013), mount),
            static("base_link", "gps", antenna), static("base_link", "imu", mount),
        )  # fmt: skip
        # The origin is the first fix, so the first pose of the ego frame is off it by the antenna's place.
        place = truth(0).inverse() @ SE3.create((1, 0, 0, 0), (0.6, -0.3, -1.5))
        shift = SE3.create((1, 0, 0, 0), place.translation)
        metres, radians = made.errors_m_rad(BETWEEN, lambda t: shift @ truth(t))
        assert metres < 1e-3
        assert radians < 1e-5
        assert made.json["notes"] == []

    def test_what_is_assumed_is_noted(self, tmp_path):
        made = Posed(tmp_path, GNSS_IMU, *fixes(TIMES), *turns(TIMES))
        assert [note.split(";")[0] for note in made.json["notes"]] == [
            "No fixed transform relates base_link to the Imu (frame imu)",
            "No fixed transform relates base_link to the antenna (frame gps)",
        ]
        assert Posed(tmp_path / "b", GNSS, *fixes(TIMES), ego_frame="gps").json["notes"] == []

    def test_the_course_is_the_heading_without_an_imu(self, tmp_path):
        times = np.cumsum([0.0, *[0.08, 0.15, 0.1] * 12])
        made = Posed(tmp_path, GNSS, *fixes(times))
        # On a circle, the course at a fix is the tangent, however unevenly fixes come.
        metres, radians = made.errors_m_rad(times[3:-3])
        assert metres < 1e-6
        assert radians < 1e-5
        metres, radians = made.errors_m_rad(np.arange(0.5, 3.5, 0.0373))
        assert metres < 7e-3  # the circle bulges by v² t² / 8 r over the chord
        assert radians < 1e-5

    def test_the_heading_holds_while_the_vehicle_stands(self, tmp_path):
        def position(t):  # drives north-east, stands with noise, drives on
            way = min(t, 2.0) + max(t - 4.0, 0.0)
            noise = 0.01 * math.sin(40 * t) if 2.0 < t < 4.0 else 0.0
            return SE3.create((1, 0, 0, 0), (3.0 * way + noise, 3.0 * way - noise, 0.0))

        made = []
        for t in np.arange(0.0, 6.0, 0.1):
            place = np.array([position(t).translation])
            lat, lon, alt = (float(v[0]) for v in ORIGIN.to_geodetic(place))
            made.append(("/fix", NAVSAT, at(t), fix(at(t), lat, lon, alt)))
        _, rotations, _ = Posed(tmp_path, GNSS, *made).trajectory.at(
            np.array([at(t) for t in np.arange(0.0, 5.9, 0.05)])
        )
        np.testing.assert_allclose(rotations, np.tile(about_z(math.pi / 4), (len(rotations), 1)), atol=1e-2)

    def test_a_vehicle_that_never_moves_faces_east(self, tmp_path):
        entries = [("/fix", NAVSAT, at(t), fix(at(t), 48.0, 11.0, 0.0)) for t in (0.0, 0.1)]
        assert [row["qw"] for row in Posed(tmp_path, GNSS, *entries).table] == [1.0, 1.0]

    def test_height_that_is_not_known(self, tmp_path):
        entries = [("/fix", NAVSAT, at(t), fix(at(t), 48.0, 11.0 + t, math.nan)) for t in (0.0, 0.0001)]
        made = Posed(tmp_path, GNSS, *entries)
        assert made.json["origin"]["alt"] == 0.0
        assert abs(made.table[1]["z"]) < 0.01

    def test_messages_without_fix_are_counted_and_do_not_fail_the_recording(self, tmp_path):
        searching = [("/fix", NAVSAT, at(t), fix(at(t), 0.0, 0.0, 0.0, status=-1)) for t in (-0.2, -0.1)]
        made = Posed(tmp_path, GNSS, *searching, *fixes(TIMES))
        assert made.json["counts"]["lost"] == {"the receiver has no fix (status -1)": 2}

    def test_fixes_without_orientation_are_counted(self, tmp_path):
        made = Posed(tmp_path, GNSS_IMU, *fixes(TIMES), *turns(np.arange(0.0, 1.0, 0.013)))
        lost = made.json["counts"]["lost"]["no Imu orientation at its time"]
        assert lost == len([t for t in TIMES if t > 0.988 + 0.05])

    def test_an_imu_without_orientation(self, tmp_path):
        entries = [("/imu", IMU, at(t), imu(at(t), (1, 0, 0, 0), covariance=-1.0)) for t in TIMES]
        with pytest.raises(PoseError, match="100 because no Imu orientation at its time"):
            Posed(tmp_path, GNSS_IMU, *fixes(TIMES), *entries)

    def test_topics_that_are_not_there(self, tmp_path):
        with pytest.raises(PoseError, match=r"no messages on /imu, which ego_pose reads; it has /fix"):
            Posed(tmp_path, GNSS_IMU, *fixes(TIMES))

    @pytest.mark.parametrize(
        ("lat", "lon", "problem"),
        [(math.nan, 1.0, "not finite"), (91.0, 0.0, "out of range"), (0.0, 0.0, "at 0, 0")],
    )
    def test_places_that_are_none(self, tmp_path, lat, lon, problem):
        with pytest.raises(PoseError, match=problem):
            Posed(tmp_path, GNSS, ("/fix", NAVSAT, T0, fix(T0, lat, lon)))


class TestFixed:
    """A rig that stands still."""

    def test_one_pose_holds_always(self, tmp_path):
        pose = {"translation": [1.0, 2.0, 3.0], "rotation": [0.5, 0.5, 0.5, 0.5]}
        made = Posed(tmp_path, {"source": "fixed", "pose": pose})
        assert made.use.topics == ()
        assert made.json["fixed"]
        assert made.table == [
            {"stamp_ns": 0, "x": 1.0, "y": 2.0, "z": 3.0, "qw": 0.5, "qx": 0.5, "qy": 0.5, "qz": 0.5}
        ]
        _, _, valid = made.trajectory.at(np.array([0, T0]))
        assert valid.all()


def test_the_key_holds_what_is_read_and_nothing_else():
    facts = MadeUpFacts(Recorded(*odometries([0.0])).inventory())
    used = partial(use_of, EGO_POSES, facts=facts)
    base = used(rig(ODOM))
    assert base.topics == ("/odom",)
    assert used(rig(ODOM, location="x")) == base
    assert used(rig(ODOM), clock="log") != base
    assert used(rig(ODOM | {"max_gap_s": 1.0})) != base


def test_the_same_messages_give_the_same_bytes(tmp_path):
    first = Posed(tmp_path / "a", GNSS_IMU, *fixes(TIMES), *turns(TIMES))
    again = Posed(tmp_path / "b", GNSS_IMU, *fixes(TIMES), *turns(TIMES))
    assert first.digest == again.digest
