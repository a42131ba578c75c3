"""Points in boxes and visibility, against plain definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.formats.nuscenes.points import Hits, hits_of
from bagassets.formats.nuscenes.visibility import CameraView, share_in_images, share_open, visibility_levels
from bagassets.geometry.se3 import SE3

pytestmark = pytest.mark.once

K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
# Camera axes: z is global x, x is global -y, y is global -z.
LOOKING_ALONG_X = SE3.create((0.5, -0.5, 0.5, -0.5), (0.0, 0.0, 0.0))
LOOKING_BACK = SE3.create((0.5, -0.5, -0.5, 0.5), (0.0, 0.0, 0.0))
CUBE = np.array([[2.0, 2.0, 2.0]])


def count_points(points, global_SE3_sensor, centers, rotations, sizes):
    return hits_of(points, global_SE3_sensor, centers, rotations, sizes, np.zeros(len(centers))).inside


def view(pose=LOOKING_ALONG_X):
    return CameraView(pose, K, 640, 480)


def level(*center, views=None, size=CUBE, rotation=(1.0, 0.0, 0.0, 0.0)):
    views = [view()] if views is None else views
    shares = share_in_images(views, np.array([center], dtype=float), np.array([rotation]), size)
    (name,) = visibility_levels(shares, None, np.zeros(1, np.int64))
    return name


class TestVisibility:
    def test_in_the_middle_of_the_image(self):
        assert level(20.0, 0.0, 0.0) == "v80-100"

    def test_behind_or_beside_the_camera(self):
        assert level(-20.0, 0.0, 0.0) == "v0-40"
        assert level(1.0, 50.0, 0.0) == "v0-40"

    def test_half_out_of_the_image(self):
        # At 20 m the image ends 12.8 m to the left: lattice planes at 11.79 … 13.79 m, three of five inside.
        assert level(20.0, 12.79, 0.0, size=np.array([[2.0, 0.01, 0.01]])) == "v60-80"
        # A little farther two of five are inside; the bound belongs to the upper level.
        assert level(20.0, 13.0, 0.0, size=np.array([[2.0, 0.01, 0.01]])) == "v40-60"
        assert level(20.0, 13.5, 0.0, size=np.array([[2.0, 0.01, 0.01]])) == "v0-40"

    def test_two_cameras_see_their_parts_of_a_box(self):
        long = np.array([[1.0, 30.0, 1.0]])
        assert level(0.0, 0.0, 0.0, size=long) == "v40-60"
        assert level(0.0, 0.0, 0.0, size=long, views=[view(), view(LOOKING_BACK)]) == "v80-100"

    def test_width_and_length_are_not_mixed_up(self):
        # 40 m long and turned across: it reaches out of the image on both sides.
        long = np.array([[1.0, 40.0, 1.0]])
        assert (
            level(20.0, 0.0, 0.0, size=np.array([[1.0, 4.0, 1.0]]), rotation=(0.5**0.5, 0, 0, 0.5**0.5))
            == "v80-100"
        )
        assert level(30.0, 0.0, 0.0, size=long) == "v80-100"
        assert level(20.0, 0.0, 0.0, size=long, rotation=(0.5**0.5, 0, 0, 0.5**0.5)) == "v60-80"


def levels(in_images, is_open, points):
    shares = [None if given is None else np.array(given, dtype=float) for given in (in_images, is_open)]
    return visibility_levels(*shares, np.array(points))


class TestWhoJudges:
    def test_images_and_lidar_together(self):
        found = levels([1.0, 1.0, 1.0, 0.5, 1.0], [1.0, 0.7, 0.3, 0.9, 0.0], [9, 9, 9, 9, 9])
        assert found == ["v80-100", "v60-80", "v0-40", "v40-60", "v0-40"]

    def test_lower_bounds_belong_to_the_level(self):
        assert levels([0.4, 0.6, 0.8], None, [0, 0, 0]) == ["v40-60", "v60-80", "v80-100"]

    def test_where_no_ray_was_asked_the_images_judge(self):
        assert levels([1.0, 0.5], [np.nan, np.nan], [1, 1]) == ["v80-100", "v40-60"]

    def test_without_a_lidar_point_nothing_is_wholly_visible(self):
        assert levels([1.0, 1.0, 0.5], [1.0, np.nan, 1.0], [0, 0, 0]) == ["v60-80", "v60-80", "v40-60"]

    def test_without_lidar_the_images_judge_alone(self):
        assert levels([1.0, 0.5, 0.0], None, [0, 0, 3]) == ["v80-100", "v40-60", "v0-40"]

    def test_without_images_the_lidar_judges_alone(self):
        found = levels(None, [1.0, 0.7, 0.2, np.nan, 1.0, np.nan], [5, 5, 5, 1, 0, 0])
        assert found == ["v80-100", "v60-80", "v0-40", "v80-100", "v0-40", "v0-40"]

    def test_with_neither_a_radar_point_decides(self):
        assert levels(None, None, [2, 0]) == ["v80-100", "v0-40"]

    def test_of_several_lidars_the_one_that_sees_most_counts(self):
        one = Hits(np.zeros(4, int), np.array([10, 10, 0, 0]), np.array([10, 2, 0, 0]))
        other = Hits(np.zeros(4, int), np.array([4, 4, 4, 0]), np.array([1, 3, 2, 0]))
        np.testing.assert_array_equal(share_open([one, other], 4), [0.75, 0.8, 0.5, np.nan])


finite = st.floats(-30.0, 30.0)
unit = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(v * v for v in q) > 0.01)


class TestPoints:
    @settings(max_examples=60)
    @given(
        seed=st.integers(0, 2**32),
        sensor=st.tuples(unit, st.tuples(finite, finite, finite)),
        box=st.tuples(unit, st.tuples(finite, finite, finite)),
        size=st.tuples(*[st.floats(0.1, 20.0)] * 3),
    )
    def test_against_the_definition(self, seed, sensor, box, size):
        global_SE3_sensor, global_SE3_box = SE3.create(*sensor), SE3.create(*box)
        width, length, height = size
        rng = np.random.default_rng(seed)
        in_box = rng.uniform(-0.8, 0.8, (300, 3)) * [length, width, height]
        points_global = global_SE3_box.transform_points(in_box)
        points = global_SE3_sensor.inverse().transform_points(points_global).astype(np.float32)
        counted = count_points(
            points,
            global_SE3_sensor,
            np.array([global_SE3_box.translation]),
            np.array([global_SE3_box.rotation]),
            np.array([size]),
        )[0]
        # float32 moves points by micrometres: those that close to a face may count either way.
        margin = 1e-4
        half = np.array([length, width, height]) / 2
        surely = np.count_nonzero((np.abs(in_box) <= half - margin).all(axis=1))
        perhaps = np.count_nonzero((np.abs(in_box) <= half + margin).all(axis=1))
        assert surely <= counted <= perhaps

    @settings(max_examples=60)
    @given(
        seed=st.integers(0, 2**32),
        sensor=st.tuples(unit, st.tuples(finite, finite, finite)),
        boxes=st.lists(
            st.tuples(unit, st.tuples(finite, finite, finite), st.tuples(*[st.floats(0.3, 12.0)] * 3)),
            min_size=1,
            max_size=4,
        ),
        number=st.sampled_from([0, 1, 40, 3000]),
    )
    def test_rays_against_the_definition(self, seed, sensor, boxes, number):
        """Ray by ray and box by box: does it pass through the core, and does it end before the box?"""
        global_SE3_sensor = SE3.create(*sensor)
        poses = [SE3.create(rotation, center) for rotation, center, _ in boxes]
        sizes = np.array([size for _, _, size in boxes])
        rng = np.random.default_rng(seed)
        points = rng.normal(0, 25, (number, 3)).astype(np.float32)
        if number > 1:  # half of them towards the boxes
            toward = np.array(
                [global_SE3_sensor.inverse().transform_points(np.array([p.translation]))[0] for p in poses]
            )
            aimed = toward[rng.integers(0, len(poses), number // 2)] + rng.normal(0, 1.5, (number // 2, 3))
            points[: number // 2] = aimed * rng.uniform(0.1, 1.6, (number // 2, 1))
        hits = hits_of(
            points,
            global_SE3_sensor,
            np.array([pose.translation for pose in poses]),
            np.array([pose.rotation for pose in poses]),
            sizes,
            np.zeros(len(poses)),
        )
        for index, pose in enumerate(poses):
            width, length, height = sizes[index]
            half = np.array([length, width, height]) / 2
            box_SE3_sensor = pose.inverse() @ global_SE3_sensor
            start = np.array(box_SE3_sensor.translation)
            ends = box_SE3_sensor.transform_points(points.astype(np.float64))
            if (np.abs(start) <= half).all():
                assert hits.rays[index] == hits.blocked[index] == 0
                continue
            ways = ends - start
            lengths = np.linalg.norm(ways, axis=1)
            with np.errstate(divide="ignore"):
                planes = np.stack([(-half * 0.9 - start) / ways, (half * 0.9 - start) / ways])
                outer = np.stack([(-half - start) / ways, (half - start) / ways])
            first, last = planes.min(axis=0).max(axis=1), planes.max(axis=0).min(axis=1)
            through = (first <= last) & (last > 0)
            before_m = (outer.min(axis=0).max(axis=1) - 1) * lengths
            unsure = (np.abs(first - last) < 1e-4) | (np.abs(before_m - 0.3) < 1e-3) | (lengths < 1e-3)
            unsure |= (np.abs(np.abs(ends) - half) < 1e-3).any(axis=1)
            blocked = through & (before_m > 0.3)
            assert 0 <= hits.rays[index] - np.count_nonzero(through & ~unsure) <= np.count_nonzero(unsure)
            assert 0 <= hits.blocked[index] - np.count_nonzero(blocked & ~unsure) <= np.count_nonzero(unsure)

    def test_a_wall_hides_what_is_behind_it_and_nothing_else(self):
        azimuth, elevation = np.meshgrid(
            np.deg2rad(np.arange(-30, 30, 0.25)), np.deg2rad(np.arange(-8, 4, 0.5))
        )
        rays = np.stack(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)],
            axis=-1,
        ).reshape(-1, 3)
        wall = rays[:, 1] > 0  # to the left, at 10 m; all else is seen to 40 m
        points = (rays * np.where(wall, 10.0, 40.0)[:, None]).astype(np.float32)
        centers = np.array(
            [[20.0, 4.0, 0.0], [20.0, -4.0, 0.0], [20.0, 0.0, 0.0], [10.0, 3.0, 0.0], [-20.0, 0, 0]]
        )
        hits = hits_of(
            points,
            SE3(),
            centers,
            np.tile([1.0, 0, 0, 0], (5, 1)),
            np.tile([2.0, 2.0, 2.0], (5, 1)),
            np.zeros(5),
        )
        shares = share_open([hits], 5)
        np.testing.assert_array_equal(shares[:2], [0.0, 1.0])
        assert shares[3] > 0.95  # the wall runs through it
        assert 0.45 < shares[2] < 0.55
        assert np.isnan(shares[4])
        assert hits.inside.tolist()[:3] == [0, 0, 0]
        assert hits.inside[3] > 0

    @pytest.mark.parametrize(
        ("before_m", "moves_m", "blocked"), [(0.25, 0, 0), (0.35, 0, 1), (0.9, 0.7, 0), (1.1, 0.7, 1)]
    )
    def test_returns_of_the_object_itself_lie_just_before_its_box_too(self, before_m, moves_m, blocked):
        point = np.array([[9.0 - before_m, 0, 0]], dtype=np.float32)
        size, rotation = np.full((1, 3), 2.0), np.array([[1.0, 0, 0, 0]])
        hits = hits_of(point, SE3(), np.array([[10.0, 0, 0]]), rotation, size, np.array([moves_m]))
        assert (hits.inside.tolist(), hits.rays.tolist(), hits.blocked.tolist()) == ([0], [1], [blocked])

    def test_a_sample_of_a_large_cloud_gives_the_same_shares(self):
        rng = np.random.default_rng(0)
        azimuth = rng.uniform(-np.pi, np.pi, 300_000)
        points = np.stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), rng.uniform(-2, 2, 300_000)], axis=1)
        points[points[:, 0] > 0] *= 0.5
        points = points.astype(np.float32)
        centers = np.array([[0.0, 15.0, 0.0], [15.0, 0.0, 0.0], [-15.0, 0.0, 0.0]])
        rotations, sizes = np.tile([1.0, 0, 0, 0], (3, 1)), np.array([[1.0, 6.0, 2.0]] * 3)
        hits = hits_of(points, SE3(), centers, rotations, sizes, np.zeros(3))
        assert 100 < hits.rays.min() <= hits.rays.max() < 3000
        np.testing.assert_allclose(share_open([hits], 3), [0.5, 0.0, 1.0], atol=0.06)
        apart = np.abs(points[None].astype(np.float64) - centers[:, None])
        inside = (apart <= sizes[:, None, [1, 0, 2]] / 2).all(axis=2).sum(axis=1)
        np.testing.assert_array_equal(hits.inside, inside)

    def test_directions_next_to_the_axes_are_not_lost(self):
        """Sectors lie on a ring, whose seam is at x; rounding must not push a point off it."""
        tiny = 1e-30
        points = np.array(
            [[10, y, 0] for y in (-1e-3, -1e-7, -tiny, 0.0, tiny, 1e-3)]
            + [[-10, -tiny, 0], [0, 10, 0], [0, -10, 0]],
            dtype=np.float32,
        )
        many = np.concatenate([points, np.tile(np.float32([[0, 0, 90]]), (3000, 1))])
        centers = np.array([[10.0, 0, 0], [-10.0, 0, 0], [0, 10.0, 0], [0, -10.0, 0]])
        found = hits_of(many, SE3(), centers, np.tile([1.0, 0, 0, 0], (4, 1)), np.ones((4, 3)), np.zeros(4))
        assert found.inside.tolist() == [6, 1, 1, 1]

    def test_several_boxes_nothing_and_nan(self):
        centers = np.array([[0.0, 0, 0], [10.0, 0, 0], [100.0, 0, 0]])
        rotations = np.tile([1.0, 0, 0, 0], (3, 1))
        sizes = np.ones((3, 3))
        points = np.array(
            [[0, 0, 0], [10, 0.5, 0], [10, 0.51, 0], [np.nan, 0, 0], [0.2, 0, 0]], dtype=np.float32
        )
        assert count_points(points, SE3(), centers, rotations, sizes).tolist() == [2, 1, 0]
        assert count_points(points[:0], SE3(), centers, rotations, sizes).tolist() == [0, 0, 0]
        assert count_points(points, SE3(), centers[:0], rotations[:0], sizes[:0]).tolist() == []


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_points_on_a_face_are_inside_as_in_the_devkit(axis):
    point = np.zeros((1, 3), dtype=np.float32)
    size = np.array([[2.0, 4.0, 1.0]])
    point[0, axis] = [2.0, 1.0, 0.5][axis]
    assert count_points(point, SE3(), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), size).tolist() == [1]
