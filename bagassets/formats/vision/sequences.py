"""Cutting the images of a camera into sequences of equal length."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class SequenceCuts:
    """The sequences of one camera, and counts of the images in none of them.

    images = sequences x length + strided + without_pose + remainder.

    Attributes:
        sequences: (S, N) indices of images, increasing.
        strided: images skipped by the stride.
        without_pose: images without an ego pose at their time.
        remainder: images at the end of runs, too few for another sequence.
        breaks: number of runs that end before the last image, at a gap or a missing pose.
    """

    sequences: NDArray[np.intp]
    strided: int
    without_pose: int
    remainder: int
    breaks: int


def cut_sequences(
    stamps_ns: NDArray[np.int64],
    has_pose: NDArray[np.bool_],
    *,
    length: int,
    stride: int,
    max_gap_ns: int,
) -> SequenceCuts:
    """Cut images into consecutive sequences that share no image.

    A sequence never spans a gap longer than `max_gap_ns` or an image without pose, because it would not be one drive.
    After such a break the next sequence starts at the next image.

    Args:
        stamps_ns: (N,) strictly increasing.
        has_pose: (N,) whether there is an ego pose at the stamp.
        length: images per sequence.
        stride: every `stride`-th image is used, counted from the first one.
        max_gap_ns: longest time between two consecutive images of a sequence.
    """
    taken = np.arange(0, len(stamps_ns), stride, dtype=np.intp)
    posed = taken[has_pose[taken]]
    # Two neighbours belong together if no image between them was left out and they are close in time.
    adjacent = (np.diff(posed) == stride) & (np.diff(stamps_ns[posed]) <= max_gap_ns)
    runs = np.split(posed, np.flatnonzero(~adjacent) + 1)
    sequences = [
        run[start : start + length] for run in runs for start in range(0, len(run) - length + 1, length)
    ]
    in_sequences = len(sequences) * length
    return SequenceCuts(
        sequences=np.array(sequences, dtype=np.intp).reshape(-1, length),
        strided=len(stamps_ns) - len(taken),
        without_pose=len(taken) - len(posed),
        remainder=len(posed) - in_sequences,
        breaks=int(np.count_nonzero(~adjacent)),
    )
