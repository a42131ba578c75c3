"""Turning an image into what a camera without distortion, or with another pinhole matrix, would have taken."""

from functools import lru_cache
from threading import Lock
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.camera import CameraModel
from bagassets.geometry.kernels.bilinear import BilinearLookup

Pixels = NDArray[Any]
"""uint8 or uint16: OpenCV takes both, and its type hints cannot tell them apart."""

_MOST_KEPT = 8  # cameras; their maps have six bytes for each pixel


class Undistortion:
    """Turns images of one camera into those of another model; several threads may share it.

    The maps are computed with the first image, in its thread, so that several cameras do so in parallel; those of the last
    few cameras are kept for further recordings of the same rig.

    Args:
        recorded: the camera that recorded the images.
        written: the camera of the written images.
    """

    def __init__(self, recorded: CameraModel, written: CameraModel) -> None:
        self._recorded = recorded
        self._written = written
        self._made: BilinearLookup | None = None
        self._lock = Lock()

    @property
    def _lookup(self) -> BilinearLookup:
        with self._lock:
            if self._made is None:
                self._made = _lookup_of(self._recorded, self._written)
            return self._made

    def __call__(self, pixels: Pixels) -> Pixels:
        """Return the image of (H, W) grey, (H, W, 3) BGR or (H, W, 4) BGRA pixels; for BGRA it is BGR, too.

        8-bit BGRA is fastest.
        """
        lookup = self._lookup
        if pixels.dtype == np.uint8 and pixels.ndim == 3 and lookup.is_fast:
            bgra = pixels if pixels.shape[2] == 4 else cv2.cvtColor(pixels, cv2.COLOR_BGR2BGRA)
            return lookup(np.ascontiguousarray(bgra))
        undistorted = undistort(pixels, lookup.maps)
        if undistorted.ndim == 3 and undistorted.shape[2] == 4:
            return cv2.cvtColor(undistorted, cv2.COLOR_BGRA2BGR)
        return undistorted


@lru_cache(maxsize=_MOST_KEPT)
def _lookup_of(recorded: CameraModel, written: CameraModel) -> BilinearLookup:
    return BilinearLookup(*recorded.undistortion_maps(written), recorded.width, recorded.height)


def undistort(pixels: Pixels, maps: tuple[NDArray[np.int16], NDArray[np.uint16]]) -> Pixels:
    """Return an image (H, W) or (H, W, C) looked up bilinearly through maps of `undistortion_maps`.

    OpenCV does 8 bit in integers, but 16 bit in single precision, where processors round differently.
    In double precision the products of 16-bit pixels and 10-bit weights are exact, and so is the result.
    """
    if pixels.dtype == np.uint8:
        return cv2.remap(pixels, *maps, cv2.INTER_LINEAR)
    exact = np.asarray(cv2.remap(pixels.astype(np.float64), *maps, cv2.INTER_LINEAR), dtype=np.float64)
    return np.floor(exact + 0.5).astype(np.uint16)
