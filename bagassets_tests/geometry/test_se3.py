"""Rigid transforms against plain 4x4 matrices, and the portable elementary functions."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.geometry.portable import arctan_unit, sin_cos, sin_cos_deg, sinc
from bagassets.geometry.se3 import SE3, quaternion_from_rotation, quaternion_multiply, rotate

numbers = st.floats(-1.0, 1.0)
metres = st.floats(-1e4, 1e4)
quaternions = st.tuples(numbers, numbers, numbers, numbers).filter(lambda q: sum(v * v for v in q) > 0.01)
transforms = st.builds(SE3.create, quaternions, st.tuples(metres, metres, metres))


@settings(deadline=None)
@given(transforms, transforms)
def test_composition_is_the_product_of_the_matrices(a_SE3_b, b_SE3_c):
    np.testing.assert_allclose((a_SE3_b @ b_SE3_c).matrix, a_SE3_b.matrix @ b_SE3_c.matrix, atol=1e-10)


@settings(deadline=None)
@given(transforms, transforms, transforms)
def test_composition_is_associative(a, b, c):
    np.testing.assert_allclose(((a @ b) @ c).matrix, (a @ (b @ c)).matrix, atol=1e-9)


@settings(deadline=None)
@given(transforms)
def test_a_transform_and_its_inverse_cancel(a_SE3_b):
    np.testing.assert_allclose((a_SE3_b @ a_SE3_b.inverse()).matrix, np.eye(4), atol=1e-10)
    np.testing.assert_allclose((a_SE3_b.inverse() @ a_SE3_b).matrix, np.eye(4), atol=1e-10)


@settings(deadline=None)
@given(quaternions)
def test_quaternion_to_matrix_and_back(quaternion):
    a_SE3_b = SE3.create(quaternion, (0, 0, 0))
    matrix = a_SE3_b.rotation_matrix
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-14)
    back = np.array(quaternion_from_rotation(matrix))
    forth = np.array(a_SE3_b.rotation)
    assert min(abs(back - forth).max(), abs(back + forth).max()) < 1e-14
    assert back[0] >= 0


@settings(deadline=None)
@given(transforms, st.lists(st.tuples(metres, metres, metres), min_size=1, max_size=5))
def test_points_are_mapped_as_by_the_matrix(dst_SE3_src, points):
    points_src = np.array(points)
    homogeneous = np.concatenate([points_src, np.ones((len(points), 1))], axis=1)
    expected = (dst_SE3_src.matrix @ homogeneous.T).T[:, :3]
    np.testing.assert_allclose(dst_SE3_src.transform_points(points_src), expected, atol=1e-9)


@settings(deadline=None)
@given(quaternions, quaternions, st.tuples(metres, metres, metres))
def test_rotating_twice_is_rotating_by_the_product(a, b, v):
    qa = np.array(SE3.create(a, (0, 0, 0)).rotation)
    qb = np.array(SE3.create(b, (0, 0, 0)).rotation)
    np.testing.assert_allclose(
        rotate(quaternion_multiply(qa, qb), np.array(v)), rotate(qa, rotate(qb, np.array(v))), atol=1e-9
    )


@settings(deadline=None)
@given(transforms, transforms)
def test_one_transform_is_composed_bit_for_bit_as_arrays_are(a_SE3_b, b_SE3_c):
    qa, qb = np.array(a_SE3_b.rotation), np.array(b_SE3_c.rotation)
    moved = rotate(qa, np.array(b_SE3_c.translation)) + np.array(a_SE3_b.translation)
    assert a_SE3_b @ b_SE3_c == SE3.create(quaternion_multiply(qa, qb), moved)
    conjugate = qa * [1, -1, -1, -1]
    assert a_SE3_b.inverse() == SE3.create(conjugate, -rotate(conjugate, np.array(a_SE3_b.translation)))


@pytest.mark.parametrize(
    ("rotation", "translation"),
    [
        ((0, 0, 0, 0), (0, 0, 0)),
        ((1, 0, 0, math.nan), (0, 0, 0)),
        ((1, 0, 0, 0), (math.inf, 0, 0)),
        ((1, 0, 0), (0, 0, 0)),
        ((1, 0, 0, 0), (0, 0)),
    ],
)
def test_nonsense_is_refused(rotation, translation):
    with pytest.raises(ValueError, match="a pose needs"):
        SE3.create(rotation, translation)


@given(st.floats(-20.0, 20.0))
def test_sine_and_cosine_agree_with_the_c_library(angle_rad):
    sine, cosine = sin_cos(np.array(angle_rad))
    assert float(sine) == pytest.approx(math.sin(angle_rad), abs=5e-16)
    assert float(cosine) == pytest.approx(math.cos(angle_rad), abs=5e-16)


@given(st.floats(-720.0, 720.0))
def test_sine_and_cosine_of_degrees_agree_with_the_c_library(angle_deg):
    sine, cosine = sin_cos_deg(np.array(angle_deg))
    assert float(sine) == pytest.approx(math.sin(math.radians(angle_deg)), abs=3e-15)
    assert float(cosine) == pytest.approx(math.cos(math.radians(angle_deg)), abs=3e-15)


def test_right_angles_are_exact():
    sine, cosine = sin_cos_deg(np.array([-180.0, -90.0, 0.0, 90.0, 180.0, 270.0, 360.0]))
    assert sine.tolist() == [0.0, -1.0, 0.0, 1.0, 0.0, -1.0, 0.0]
    assert cosine.tolist() == [-1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 1.0]


@given(st.floats(0.0, 1.0))
def test_arctangent_agrees_with_the_c_library(ratio):
    assert float(arctan_unit(np.array(ratio))) == pytest.approx(math.atan(ratio), rel=1e-15, abs=1e-300)


@given(st.floats(1e-9, math.pi / 2))
def test_sinc_agrees_with_the_c_library(angle_rad):
    assert float(sinc(np.array(angle_rad))) == pytest.approx(math.sin(angle_rad) / angle_rad, rel=1e-15)
    assert float(sinc(np.array(0.0))) == 1.0
