"""Statistics of features: the definitions, and that joining histograms of episodes loses nothing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bagassets.formats.lerobot import statistics


@given(
    arrays(
        np.float32, st.tuples(st.integers(1, 40), st.integers(1, 4)), elements=st.floats(-1e3, 1e3, width=32)
    )
)
def test_values(values):
    found, exact = statistics.of_values(values), values.astype(np.float64)
    assert set(found) == set(statistics.STATISTICS)
    assert found["min"] == pytest.approx(exact.min(axis=0))
    assert found["max"] == pytest.approx(exact.max(axis=0))
    assert found["mean"] == pytest.approx(exact.mean(axis=0), abs=1e-9)
    assert found["std"] == pytest.approx(exact.std(axis=0), abs=1e-9)
    assert found["count"].tolist() == [len(values)]
    for name, share in statistics.QUANTILES.items():
        assert found[name] == pytest.approx(np.quantile(exact, share, axis=0), abs=1e-9)


@given(st.integers(0, 10**6), st.integers(1, 3000))
def test_columns_that_count(first, number):
    run = np.arange(first, first + number)
    closed = statistics.of_runs(np.array([first]), np.array([first + number - 1]))
    for name, value in statistics.of_values(run[:, None]).items():
        assert closed[name] == pytest.approx(value, rel=1e-9, abs=1e-9), name


@given(st.lists(arrays(np.uint8, (6, 4, 3)), min_size=1, max_size=5))
def test_images_of_several_episodes(images):
    levels = statistics.added(statistics.histogram(image).tolist() for image in images)
    found = statistics.of_images(levels, len(images))
    pixels = np.stack(images).reshape(-1, 3) / 255
    assert found["count"].tolist() == [len(images)]
    for name, truth in {
        "min": pixels.min(axis=0),
        "max": pixels.max(axis=0),
        "mean": pixels.mean(axis=0),
        "std": pixels.std(axis=0),
        **{name: np.quantile(pixels, share, axis=0) for name, share in statistics.QUANTILES.items()},
    }.items():
        assert found[name].shape == (3, 1, 1)
        assert found[name].ravel() == pytest.approx(truth, abs=1e-9), name


def test_the_frames_and_pixels_that_count_are_those_of_the_library():
    """lerobot 0.4.4: `compute_stats.sample_indices` and `auto_downsample_height_width`."""
    assert statistics.sampled_frames(60).tolist() == list(range(60))
    assert len(statistics.sampled_frames(1000)) == 177
    assert len(statistics.sampled_frames(5000)) == 594
    assert statistics.thinned(np.zeros((480, 640, 3), np.uint8)).shape == (120, 160, 3)
    assert statistics.thinned(np.zeros((290, 299, 3), np.uint8)).shape == (290, 299, 3)
    assert statistics.thinned(np.zeros((600, 300, 3), np.uint8)).shape == (150, 75, 3)
