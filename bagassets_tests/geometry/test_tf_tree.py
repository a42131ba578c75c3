"""Trees of frames: chains through moving and fixed edges, layers of trust, and what is wrong with a tree."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.base.errors import CalibrationError
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import Edge, TfTree, TransformLog, normalise_frame
from bagassets_tests.pose_data import T0, S, about_z

numbers = st.floats(-1.0, 1.0)
metres = st.floats(-100.0, 100.0)
transforms = st.builds(
    SE3.create,
    st.tuples(numbers, numbers, numbers, numbers).filter(lambda q: sum(v * v for v in q) > 0.01),
    st.tuples(metres, metres, metres),
)


def fixed(parent, child, x=1.0, source="tf_static"):
    return Edge.fixed(parent, child, source, SE3.create((1, 0, 0, 0), (x, 0, 0)))


def moving(parent, child, times_s, pose, source="tf"):
    log = TransformLog(source)
    for t in times_s:
        log.add(parent, child, T0 + round(t * S), pose(t))
    (edge,) = log.edges()
    return edge


@settings(deadline=None)
@given(st.lists(transforms, min_size=1, max_size=5), st.lists(transforms, max_size=4))
def test_a_chain_is_the_product_of_its_edges(down_one, down_other):
    """One branch from the root to a sensor, another to the ego frame; truth by 4x4 matrices."""

    def branch(name, chain):
        frames = ["root", *(f"{name}{i}" for i in range(len(chain)))]
        return frames, [
            Edge.fixed(*pair, "urdf", t) for *pair, t in zip(frames, frames[1:], chain, strict=False)
        ]

    one, edges_one = branch("a", down_one)
    other, edges_other = branch("b", down_other)
    matrix = np.linalg.inv(np.linalg.multi_dot([np.eye(4), np.eye(4), *(t.matrix for t in down_other)])) @ (
        np.linalg.multi_dot([np.eye(4), np.eye(4), *(t.matrix for t in down_one)])
    )
    tree = TfTree(edges_other + edges_one)
    found, sources = tree.fixed(other[-1], one[-1])
    np.testing.assert_allclose(found.matrix, matrix, atol=1e-8)
    assert sources == ("urdf",)
    stamps = np.array([T0, T0 + S])
    positions, rotations, valid = tree.at(other[-1], one[-1], stamps, 0, 0)
    assert valid.all()
    for position, rotation in zip(positions, rotations, strict=True):
        np.testing.assert_allclose(SE3.create(rotation, position).matrix, matrix, atol=1e-8)


def test_a_frame_to_itself_is_identity():
    assert TfTree([fixed("a", "b")]).fixed("b", "b") == (SE3(), ())


class TestMovingEdges:
    """Each edge is interpolated by itself, then they are composed."""

    def test_edges_of_different_rates_and_phases_meet_the_truth(self):
        """A slow drift of the map and a fast odometry, both uniform motions about z."""
        drift = lambda t: SE3.create(about_z(0.02 * t), (0.1 * t, -0.05 * t, 0.0))
        drive = lambda t: SE3.create(about_z(0.4 * t), (8.0 * t, 0.0, 0.3))
        mount = SE3.create((0.5, -0.5, 0.5, -0.5), (1.5, 0.2, 1.4))
        tree = TfTree(
            [Edge.fixed("base", "cam", "tf_static", mount)],
            [
                moving("map", "odom", np.arange(0.0, 4.0, 0.31), drift),
                moving("odom", "base", np.arange(-0.013, 4.0, 0.02), drive),
            ],
        )
        times = np.arange(0.1, 3.6, 0.0417)
        stamps = T0 + np.round(times * S).astype(np.int64)
        positions, rotations, valid = tree.at("map", "cam", stamps, S // 2, 0)
        assert valid.all()
        for t, position, rotation in zip(times, positions, rotations, strict=True):
            truth = drift(t).matrix @ drive(t).matrix @ mount.matrix
            assert np.abs(SE3.create(rotation, position).matrix - truth).max() < 1e-6
        back, _, _ = tree.at("cam", "map", stamps[:1], S // 2, 0)
        truth = np.linalg.inv(drift(0.1).matrix @ drive(0.1).matrix @ mount.matrix)
        np.testing.assert_allclose(back[0], truth[:3, 3], atol=1e-6)

    def test_a_gap_or_an_end_of_one_edge_is_one_of_the_chain(self):
        times = [0.0, 0.1, 0.2, 0.9, 1.0]
        tree = TfTree(
            [moving("map", "odom", np.arange(0, 1.2, 0.1), lambda t: SE3.create((1, 0, 0, 0), (t, 0, 0)))],
            [moving("odom", "base", times, lambda t: SE3.create((1, 0, 0, 0), (t, 0, 0)))],
        )
        stamps = T0 + np.round(np.array([-0.04, 0.15, 0.5, 0.95, 1.04, 1.1]) * S).astype(np.int64)
        positions, _, valid = tree.at("map", "base", stamps, S // 2, S // 20)
        assert valid.tolist() == [True, True, False, True, True, False]
        assert positions[1, 0] == pytest.approx(0.3)

    def test_a_slow_correction_need_not_keep_up_with_the_odometry(self):
        """map -> odom at 1 Hz, 0.4 s late; odom -> base at 50 Hz; gaps up to 0.1 s are allowed."""
        drift = lambda t: SE3.create((1, 0, 0, 0), (0.1 * t, 0, 0))
        drive = lambda t: SE3.create((1, 0, 0, 0), (8.0 * t, 0, 0))
        tree = TfTree(
            [
                moving("map", "odom", [0.4, 1.4, 2.4, 3.4, 8.0], drift),
                moving("odom", "base", np.arange(0.0, 8.01, 0.02), drive),
            ]
        )
        times = np.array([0.0, 0.9, 2.01, 3.4, 5.0, 8.0])
        positions, _, valid = tree.at("map", "base", T0 + np.round(times * S).astype(np.int64), S // 10, 0)
        assert valid.tolist() == [True, True, True, True, False, True]
        # Before the first correction the first one holds, between corrections they are interpolated.
        corrected = [0.1 * max(t, 0.4) + 8.0 * t for t in times[:4]]
        np.testing.assert_allclose(positions[:4, 0], corrected, atol=1e-6)
        early = np.array([T0 - round(0.7 * S)])
        assert not tree.at("map", "base", early, S // 10, S)[2].any()

    @pytest.mark.parametrize(("pause_s", "known"), [(3.0, True), (3.01, False)])
    def test_a_slow_edge_may_pause_for_three_of_its_periods(self, pause_s, known):
        last = 3.0 + pause_s
        tree = TfTree(
            [
                moving(
                    "map",
                    "odom",
                    [0, 1, 2, 3, last, last + 1, last + 2],
                    lambda t: SE3.create((1, 0, 0, 0), (t, 0, 0)),
                ),
                moving(
                    "odom", "base", np.arange(0.0, 9.0, 0.02), lambda t: SE3.create((1, 0, 0, 0), (0, t, 0))
                ),
            ]
        )
        middle = np.array([T0 + round((3.0 + pause_s / 2) * S)])
        positions, _, valid = tree.at("map", "base", middle, S // 10, 0)
        assert valid.tolist() == [known]
        if known:
            np.testing.assert_allclose(positions[0], [4.5, 4.5, 0.0], atol=1e-6)

    @pytest.mark.parametrize(("period_s", "slow"), [(0.2, False), (0.21, True)])
    def test_an_edge_is_slow_from_twice_the_period_of_the_fastest(self, period_s, slow):
        """A slow one holds its ends for a period; others end with the limit of the caller."""
        slower = np.arange(0.0, 5.0, period_s)
        tree = TfTree(
            [
                moving("map", "odom", slower, lambda t: SE3.create((1, 0, 0, 0), (t, 0, 0))),
                moving(
                    "odom", "base", np.arange(-1.0, 6.0, 0.1), lambda t: SE3.create((1, 0, 0, 0), (0, t, 0))
                ),
            ]
        )
        before = np.array([T0 - round(0.1 * S)])
        assert tree.at("map", "base", before, S, 0)[2].tolist() == [slow]
        assert tree.at("map", "base", np.array([T0 - round(0.22 * S)]), S, 0)[2].tolist() == [False]

    @pytest.mark.parametrize(("off", "moves"), [(1.0e-6, False), (1.1e-6, True)])
    def test_from_a_micrometre_an_edge_moves(self, off, moves):
        edge = Edge(
            "base", "cam", "tf", np.array([T0, T0 + S]), np.array([[0.0, 0, 0], [0, 0, -off]]), np.tile([1.0, 0, 0, 0], (2, 1))
        )  # fmt: skip
        assert edge.moves == moves

    @pytest.mark.parametrize(("angle", "moves"), [(0.9e-6, False), (1.1e-6, True)])
    def test_from_a_microradian_an_edge_moves(self, angle, moves):
        assert (
            moving("base", "cam", [0.0, 1.0], lambda t: SE3.create(about_z(angle * t), (0, 0, 0))).moves
            == moves
        )

    def test_the_period_of_an_edge_is_the_median(self):
        pose = lambda t: SE3.create((1, 0, 0, 0), (t, 0, 0))
        assert moving("a", "b", [0.0, 0.1, 0.2, 0.3, 3.0], pose).period_ns == S // 10
        assert moving("a", "b", [0.0], pose).period_ns == 0

    def test_an_edge_that_is_repeated_but_never_moves_holds_at_all_times(self):
        """Static in /tf: published at 10 Hz, with the noise of single precision in the quaternion's sign."""
        still = moving("base", "cam", [0.0, 0.1, 0.2], lambda t: SE3.create((1, 0, 0, 0), (1.0, 0, 0)))
        assert not still.moves
        flipped = Edge(
            "base", "cam", "tf", still.stamps_ns, still.translations_m + np.array([[0], [2e-8], [0]]),
            still.rotations * [[1], [-1], [1]],
        )  # fmt: skip
        assert not flipped.moves
        _, _, valid = TfTree([flipped]).at("base", "cam", np.array([T0 - 99 * S, T0 + 99 * S]), 1, 0)
        assert valid.all()
        assert TfTree([flipped]).fixed("base", "cam") == (SE3.create((1, 0, 0, 0), (1, 0, 0)), ("tf",))

    @pytest.mark.parametrize(
        "pose",
        [lambda t: SE3.create((1, 0, 0, 0), (t, 0, 0)), lambda t: SE3.create(about_z(0.01 * t), (0, 0, 0))],
    )
    def test_what_moves_is_no_extrinsic(self, pose):
        tree = TfTree([moving("base", "arm", [0.0, 1.0], pose)], [fixed("arm", "cam")])
        with pytest.raises(CalibrationError, match=r"from cam to base: base -> arm \(tf\) moves during"):
            tree.fixed("base", "cam")

    def test_samples_are_sorted_and_the_first_of_a_stamp_counts(self):
        log = TransformLog("tf")
        for t, x in [(0.2, 2.0), (0.1, 1.0), (0.2, 9.0)]:
            log.add("a", "b", T0 + round(t * S), SE3.create((1, 0, 0, 0), (x, 0, 0)))
        (edge,) = log.edges()
        assert edge.translations_m[:, 0].tolist() == [1.0, 2.0]
        assert edge.repeated == 1


class TestRepeats:
    """A fixed transform that is sent again."""

    def tree(self, *samples, source="tf_static"):
        log = TransformLog(source)
        for stamp_s, pose in samples:
            log.add("base", "cam", T0 + stamp_s * S, pose)
        return TfTree(log.edges(), [fixed("base", "lidar")])

    POSE = SE3.create(about_z(0.3), (1.25, -0.5, 1.5))
    NOISY = SE3.create(tuple(np.float32(POSE.rotation).astype(float)), (1.25 + 5e-7, -0.5, 1.5))
    OPPOSITE = SE3(tuple(-value for value in POSE.rotation), POSE.translation)

    @pytest.mark.parametrize("source", ["tf_static", "tf"])
    @pytest.mark.parametrize("second_s", [0, 7])
    @pytest.mark.parametrize("again", [POSE, NOISY, OPPOSITE])
    def test_the_same_value_again_is_the_same_edge(self, again, second_s, source):
        found, _ = self.tree((0, self.POSE), (second_s, again), source=source).fixed("base", "cam")
        assert found == self.POSE

    @pytest.mark.parametrize("source", ["tf_static", "tf"])
    @pytest.mark.parametrize("stamps_s", [(0, 0), (0, 7), (0, 0, 0)])
    @pytest.mark.parametrize(
        "other",
        [
            SE3.create(about_z(0.3), (1.25, -0.5, 1.6)),
            SE3.create(about_z(0.31), (1.25, -0.5, 1.5)),
            POSE.inverse(),
        ],
    )
    def test_another_value_is_refused_whenever_it_is_sent(self, other, stamps_s, source):
        values = [self.POSE, other, self.POSE]
        for order in (values, values[::-1]):
            tree = self.tree(*zip(stamps_s, order, strict=False), source=source)
            with pytest.raises(
                CalibrationError,
                match=r"base -> cam \(.*\) (moves during the recording|has several values at one time)",
            ):
                tree.fixed("base", "cam")
            assert tree.fixed("base", "lidar")[0].translation == (1.0, 0.0, 0.0)

    def test_several_values_at_one_time_are_refused_in_a_moving_chain_too(self):
        log = TransformLog("tf_static")
        for x in (1.0, 1.1):
            log.add("base", "cam", T0, SE3.create((1, 0, 0, 0), (x, 0, 0)))
        tree = TfTree(
            log.edges(),
            [moving("odom", "base", [0.0, 0.5, 1.0], lambda t: SE3.create((1, 0, 0, 0), (t, 0, 0)))],
        )
        with pytest.raises(CalibrationError, match="has several values at one time"):
            tree.at("odom", "cam", np.array([T0]), S, 0)

    @pytest.mark.parametrize(
        ("topics", "advice"),
        [
            (("/a", "/b"), "two nodes publish it, so name only one of /a and /b in the recipe"),
            (("/a", "/a"), "correct what publishes it"),
        ],
    )
    def test_topics_are_named_where_one_of_them_has_a_single_value(self, topics, advice):
        log = TransformLog("tf_static")
        for x, topic in zip((1.0, 1.1), topics, strict=True):
            log.add("base", "cam", T0, SE3.create((1, 0, 0, 0), (x, 0, 0)), topic)
            log.add(f"mast{x}", "lidar", T0, SE3(), topic)
        tree = TfTree(log.edges())
        for src, dst in (("cam", "base"), ("lidar", "mast1.0")):
            with pytest.raises(CalibrationError, match=f"; {advice}$"):
                tree.fixed(dst, src)

    def test_a_moving_edge_whose_stamps_repeat_takes_the_first_as_before(self):
        log = TransformLog("tf")
        for t, x in [(0, 0.0), (0, 9.0), (1, 1.0), (1, 8.0)]:
            log.add("odom", "base", T0 + t * S, SE3.create((1, 0, 0, 0), (x, 0, 0)))
        positions, _, valid = TfTree(log.edges()).at("odom", "base", np.array([T0 + S // 2]), 2 * S, 0)
        assert valid.all()
        assert positions[0].tolist() == [0.5, 0.0, 0.0]


class TestLayers:
    """The first source that knows a frame wins."""

    def test_a_frame_is_taken_from_the_most_trusted_source(self):
        tree = TfTree([fixed("base", "cam", 1.0)], [fixed("base", "cam", 7.0, "urdf")])
        assert tree.fixed("base", "cam") == (SE3.create((1, 0, 0, 0), (1, 0, 0)), ("tf_static",))

    def test_chains_lead_through_several_sources(self):
        tree = TfTree([fixed("mast", "cam")], [fixed("base", "mast", 2.0, "urdf")])
        assert tree.fixed("base", "cam") == (SE3.create((1, 0, 0, 0), (3, 0, 0)), ("tf_static", "urdf"))

    def test_a_less_trusted_source_cannot_close_a_circle(self):
        """tf_static says base -> footprint, the URDF footprint -> base."""
        tree = TfTree([fixed("base", "footprint", -1.0)], [fixed("footprint", "base", 5.0, "urdf")])
        assert tree.fixed("base", "footprint")[0].translation == (-1.0, 0.0, 0.0)

    def test_several_parents_in_one_source_are_an_error_where_they_matter(self):
        tree = TfTree([fixed("base", "cam"), fixed("mast", "cam"), fixed("base", "lidar")])
        assert tree.fixed("base", "lidar")[0].translation == (1.0, 0.0, 0.0)
        with pytest.raises(
            CalibrationError, match=r"cam has more than one parent, base \(tf_static\) and mast \(tf_static\)"
        ):
            tree.fixed("base", "cam")

    def test_a_circle_is_named(self):
        tree = TfTree([fixed("a", "b"), fixed("b", "c"), fixed("c", "a"), fixed("base", "x")])
        with pytest.raises(CalibrationError, match=r"round in a circle, a <- c <- b <- a"):
            tree.fixed("base", "a")

    @pytest.mark.parametrize(
        ("dst", "src"), [("base", "lidar"), ("lidar", "base"), ("cam", "lidar"), ("tip", "base")]
    )
    def test_a_way_through_a_circle_is_refused(self, dst, src):
        """Which of the two ways round is meant nobody knows; the shorter one was taken, inverted."""
        tree = TfTree(
            [
                fixed("base", "lidar"),
                fixed("lidar", "base", 3.0),
                fixed("lidar", "tip"),
                fixed("base", "cam"),
                fixed("base", "rear"),
            ]
        )
        stamps = np.array([T0])
        for find in (lambda: tree.fixed(dst, src), lambda: tree.at(dst, src, stamps, 0, 0)):
            with pytest.raises(
                CalibrationError,
                match=r"the transforms go round in a circle, (base <- lidar <- base|lidar <- base <- lidar)",
            ):
                find()

    def test_a_circle_above_both_frames_does_not_matter(self):
        tree = TfTree(
            [fixed("base", "lidar"), fixed("base", "cam", 3.0), fixed("odom", "base"), fixed("base", "odom")]
        )
        assert tree.fixed("lidar", "cam")[0].translation == (2.0, 0.0, 0.0)
        assert tree.fixed("base", "cam")[0].translation == (3.0, 0.0, 0.0)

    def test_a_circle_of_three_sources(self):
        tree = TfTree([fixed("a", "b")], [fixed("b", "c", source="urdf"), fixed("c", "a", source="urdf")])
        with pytest.raises(CalibrationError, match="round in a circle"):
            tree.fixed("a", "b")

    def test_a_frame_that_is_not_there_is_named_with_those_that_are(self):
        with pytest.raises(
            CalibrationError,
            match=r"from lidar to base: lidar is not a frame known here \(known frames: base, cam\)",
        ):
            TfTree([fixed("base", "cam")]).fixed("base", "lidar")
        with pytest.raises(CalibrationError, match="no frames are known at all"):
            TfTree().fixed("a", "b")
        many = TfTree([fixed("base", f"f{i:02d}") for i in range(30)])
        with pytest.raises(CalibrationError, match="f18 and 11 more"):
            many.fixed("base", "cam")

    def test_two_trees_are_named_by_their_roots(self):
        tree = TfTree([fixed("base", "cam"), fixed("world", "lidar")])
        with pytest.raises(CalibrationError, match="two trees with the roots world and base"):
            tree.fixed("cam", "lidar")


@pytest.mark.parametrize(("name", "plain"), [("/base", "base"), (" base_link ", "base_link"), ("", "")])
def test_leading_slashes_do_not_matter(name, plain):
    assert normalise_frame(name) == plain
