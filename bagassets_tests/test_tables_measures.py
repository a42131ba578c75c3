"""Points in boxes and visibility, against plain definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.geometry.se3 import SE3
from bagassets.nuscenes.points import count_points
from bagassets.nuscenes.visibility import CameraView, visibility_levels

K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
# Camera axes: z is global x, x is global -y, y is global -z.
LOOKING_ALONG_X = SE3.create((0.5, -0.5, 0.5, -0.5), (0.0, 0.0, 0.0))
LOOKING_BACK = SE3.create((0.5, -0.5, -0.5, 0.5), (0.0, 0.0, 0.0))
CUBE = np.array([[2.0, 2.0, 2.0]])


def view(pose=LOOKING_ALONG_X):
    return CameraView(pose, K, 640, 480)


def level(*center, views=None, size=CUBE, rotation=(1.0, 0.0, 0.0, 0.0)):
    views = [view()] if views is None else views
    (name,) = visibility_levels(views, np.array([center], dtype=float), np.array([rotation]), size)
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

    def test_without_cameras_nothing_is_visible(self):
        assert level(20.0, 0.0, 0.0, views=[]) == "v0-40"


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
