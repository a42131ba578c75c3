"""Machine code gives the bytes of its slower twins, and is used where it can be."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.geometry.camera import CameraModel
from bagassets.geometry.kernels import bilinear, machine_code, moving
from bagassets.geometry.kernels.bilinear import BilinearLookup
from bagassets.geometry.kernels.machine_code import MachineCode
from bagassets.geometry.undistortion import Undistortion, undistort

LENSES = [(-0.3, 0.1, 0.0, 0.0, 0.0), (0.5, 0.2, 0.0, 0.0, 0.0), (0.0, 0.0, 0.05, -0.08, 0.0), (0.0,) * 5]


@pytest.fixture
def no_llvmlite(monkeypatch):
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    monkeypatch.setitem(sys.modules, "llvmlite.binding", None)
    monkeypatch.setattr(machine_code, "_ALL", [])
    for module, name, build in (
        (bilinear, "_LOOKUP", "_lookup_function"),
        (moving, "_MOVE", "_move_function"),
    ):
        known = getattr(module, name)
        monkeypatch.setattr(module, name, MachineCode(known._name, getattr(module, build)))


def lens(width, height, coefficients):
    focal = 0.62 * width
    return CameraModel("plumb_bob", width, height, focal, focal, width / 2, height / 2, coefficients)


def pixels_of(seed, *shape):
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


@settings(max_examples=150, deadline=None)
@given(
    st.integers(2, 150),
    st.integers(2, 90),
    st.sampled_from(LENSES),
    st.floats(0.4, 2.5),
    st.integers(0, 9999),
)
def test_images_are_those_of_opencv(width, height, coefficients, zoom, seed):
    camera = lens(width, height, coefficients)
    written = camera.undistorted()
    written = CameraModel(
        "none", width, height, written.fx * zoom, written.fy * zoom, written.cx, written.cy, ()
    )
    bgra = pixels_of(seed, height, width, 4)
    straight = Undistortion(camera, written)
    plain = undistort(bgra[..., :3].copy(), camera.undistortion_maps(written))
    assert np.array_equal(straight(bgra), plain)
    assert np.array_equal(straight(bgra[..., :3].copy()), plain)


def test_images_of_other_sizes_than_recorded():
    camera = lens(333, 217, LENSES[0])
    for width, height in ((640, 480), (97, 31)):
        written = camera.undistorted()
        written = CameraModel(
            "none",
            width,
            height,
            written.fx * width / 333,
            written.fy * width / 333,
            width / 2,
            height / 2,
            (),
        )
        bgra = pixels_of(width, 217, 333, 4)
        plain = undistort(bgra[..., :3].copy(), camera.undistortion_maps(written))
        assert np.array_equal(Undistortion(camera, written)(bgra), plain)


def test_nearly_all_pixels_of_a_lens_are_looked_up_in_machine_code():
    camera = lens(1920, 1080, LENSES[0])
    lookup = BilinearLookup(*camera.undistortion_maps(camera.undistorted()), 1920, 1080)
    assert lookup.is_fast
    assert len(lookup._others) < 0.01 * 1920 * 1080


def test_grey_and_16_bit_images_stay_with_opencv():
    camera = lens(64, 48, LENSES[0])
    straight, maps = (
        Undistortion(camera, camera.undistorted()),
        camera.undistortion_maps(camera.undistorted()),
    )
    for image in (pixels_of(1, 48, 64), pixels_of(2, 48, 64, 3).astype(np.uint16) * 257):
        assert np.array_equal(straight(image), undistort(image, maps))


@pytest.mark.parametrize("shape", [(48, 64, 3), (64, 48, 4), (48, 63, 4)])
def test_an_image_that_the_maps_are_not_for_is_refused(shape):
    camera = lens(64, 48, LENSES[0])
    lookup = BilinearLookup(*camera.undistortion_maps(camera.undistorted()), 64, 48)
    with pytest.raises(ValueError, match="is not an image of"):
        lookup(np.zeros(shape, np.uint8))


def test_without_llvmlite_the_twins_give_the_same(no_llvmlite):
    camera = lens(150, 90, LENSES[0])
    straight, bgra = Undistortion(camera, camera.undistorted()), pixels_of(3, 90, 150, 4)
    assert not straight._lookup.is_fast
    plain = undistort(bgra[..., :3].copy(), camera.undistortion_maps(camera.undistorted()))
    assert np.array_equal(straight(bgra), plain)
    with pytest.raises(RuntimeError, match="no machine code"):
        straight._lookup(bgra)


@settings(max_examples=150, deadline=None)
@given(st.integers(1, 60), st.integers(1, 40), st.integers(3, 6), st.booleans(), st.integers(0, 9999))
def test_points_are_moved_as_numpy_moves_them(groups, knots, columns, ordered, seed):
    rng = np.random.default_rng(seed)
    first_ns, last_ns = 1_700_000_000_000_000_000, 1_700_000_000_000_000_000 + knots * moving.KNOT_NS
    knots_ns = np.arange(knots + 1) * moving.KNOT_NS + first_ns
    knots_ns[-1] = last_ns = last_ns - int(rng.choice([0, 1, 400_000, moving.KNOT_NS]))
    times_ns = rng.integers(first_ns, last_ns + 1, groups)
    times_ns[0], times_ns[-1] = first_ns, last_ns
    times_ns = np.repeat(np.sort(times_ns) if ordered else times_ns, rng.integers(1, 9, groups))
    points = rng.normal(0, 50, (len(times_ns), columns)).astype(np.float32)
    transforms = rng.normal(0, 2, (knots + 1, 12))
    moved, plain = points.copy(), points.copy()
    moving.move_points(moved, times_ns, knots_ns, transforms)
    moving._twin(plain, times_ns, knots_ns, transforms)
    assert moving._MOVE.function() is not None
    assert moved.tobytes() == plain.tobytes()
    assert np.array_equal(moved[:, 3:], points[:, 3:])
    at = int(rng.integers(len(points)))
    matrix = np.array([np.interp(times_ns[at] - first_ns, knots_ns - first_ns, e) for e in transforms.T])
    if knots_ns[-1] > knots_ns[-2] or times_ns[at] < knots_ns[-2]:
        matrix = matrix.reshape(3, 4)
        truth = matrix[:, :3] @ points[at, :3].astype(float) + matrix[:, 3]
        assert np.allclose(moved[at, :3], truth, rtol=1e-5, atol=1e-3)


def test_without_llvmlite_points_are_moved_all_the_same(no_llvmlite):
    points = np.tile(np.array([1, 2, 3, 9], np.float32), (moving._CHUNK + 1, 1))
    shift = np.array([1, 0, 0, 10, 0, 1, 0, 20, 0, 0, 1, 30], dtype=np.float64)
    times_ns = np.full(len(points), moving.KNOT_NS // 2)
    moving.move_points(points, times_ns, np.array([0, moving.KNOT_NS]), np.stack([0 * shift, 2 * shift]))
    assert moving._MOVE.function() is None
    assert (points == [11, 22, 33, 9]).all()


def test_all_are_compiled_before_workers_fork():
    import bagassets.geometry.kernels.returns  # noqa: F401  (what is imported is compiled)

    for _ in machine_code.compile_all():
        pass
    assert {code._name for code in machine_code._ALL if code._function is not None} >= {
        "lookup",
        "move_points",
        "take_returns",
        "each",
    }


def test_what_cannot_be_compiled_is_reported_once_and_done_without(caplog, monkeypatch):
    monkeypatch.setattr(machine_code, "_ALL", [])
    code = MachineCode("wrong", lambda: "this is no function")
    assert code.function() is None
    assert code.function() is None
    assert [record.message for record in caplog.records if record.name == machine_code.__name__] == [
        "wrong cannot be compiled here; a slower twin is used"
    ]
