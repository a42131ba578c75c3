"""Statistics of features, as LeRobot keeps them: min, max, mean, std, count and quantiles.

Quantiles are those of the values themselves, interpolated between neighbours: neither from a histogram of 5,000 bins, nor
averaged over episodes, as the library's own are. Standard deviations are those of the population.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
STATISTICS = ("min", "max", "mean", "std", "count", *QUANTILES)
LEVELS = 256

Statistics = dict[str, NDArray[np.float64] | NDArray[np.int64]]
"""Name -> value for each element, (D,) or (3, 1, 1); `count` has shape (1,)."""


def of_values(values: NDArray[np.floating] | NDArray[np.int64]) -> Statistics:
    """Return the statistics of a feature, of its values in all frames, (N, D), N > 0."""
    exact = values.astype(np.float64)
    # Sums down the columns are made row by row, the same on every processor.
    mean = exact.sum(axis=0) / len(exact)
    spread = exact - mean
    variance = (spread * spread).sum(axis=0) / len(exact)
    ordered = np.sort(exact, axis=0)
    return {
        "min": ordered[0],
        "max": ordered[-1],
        "mean": mean,
        "std": np.sqrt(variance),
        "count": np.array([len(exact)]),
        **{name: _between(ordered, share) for name, share in QUANTILES.items()},
    }


def _between(ordered: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    place = share * (len(ordered) - 1)
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    step = (ordered[high] - ordered[low]) * (place - low)
    result: NDArray[np.float64] = ordered[low] + step
    return result


def of_runs(first: NDArray[np.int64], last: NDArray[np.int64]) -> Statistics:
    """Return the statistics of columns that count by one from `first` to `last`, (E,) each, for E episodes at once."""
    number = (last - first + 1).astype(np.float64)
    return {
        "min": first.astype(np.float64),
        "max": last.astype(np.float64),
        "mean": (first + last) / 2,
        "std": np.sqrt((number * number - 1) / 12),
        "count": number,
        **{name: first + (last - first) * share for name, share in QUANTILES.items()},
    }


def sampled_frames(number: int) -> NDArray[np.int64]:
    """Return the frames of an episode whose images count for its statistics: the library's choice, 100 or more of them."""
    chosen = max(min(100, number), min(int(number**0.75), 10_000))
    return np.round(np.linspace(0, number - 1, chosen)).astype(np.int64)


def thinned(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the pixels of an image, (H, W, 3), that count: the library's choice, about 150 a side of large ones."""
    height, width = image.shape[:2]
    if max(width, height) < 300:
        return image
    step = int(width / 150) if width > height else int(height / 150)
    return image[::step, ::step]


def histogram(image: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return how many pixels of an image, (H, W, 3), have which level, (3, 256)."""
    return np.stack([np.bincount(image[..., channel].ravel(), minlength=LEVELS) for channel in range(3)])


def of_images(levels: NDArray[np.int64], count: int) -> Statistics:
    """Return the statistics of images, levels scaled to 0..1, each (3, 1, 1), from their histograms, (3, 256); `count` images."""
    scale = np.arange(LEVELS, dtype=np.float64)
    found: dict[str, list[float]] = {name: [] for name in STATISTICS if name != "count"}
    for channel in levels:
        total = int(channel.sum())
        there = np.flatnonzero(channel)
        mean = float((channel * scale).sum()) / total
        variance = float((channel * (scale - mean) ** 2).sum()) / total
        upto = np.cumsum(channel)
        found["min"].append(float(there[0]))
        found["max"].append(float(there[-1]))
        found["mean"].append(mean)
        found["std"].append(float(np.sqrt(variance)))
        for name, share in QUANTILES.items():
            place = share * (total - 1)
            low, high = (
                int(np.searchsorted(upto, rank, "right"))
                for rank in (int(place), min(int(place) + 1, total - 1))
            )
            found[name].append(low + (high - low) * (place - int(place)))
    scaled = {name: np.array(values).reshape(3, 1, 1) / (LEVELS - 1) for name, values in found.items()}
    return scaled | {"count": np.array([count])}


def added(histograms: Iterable[Sequence[Sequence[int]]]) -> NDArray[np.int64]:
    """Return the sum of histograms, (3, 256) each."""
    return sum((np.asarray(one, dtype=np.int64) for one in histograms), np.zeros((3, LEVELS), dtype=np.int64))
