"""The future trajectory drawn into an image, which shows poses, extrinsics and intrinsics at once."""

import cv2
import numpy as np

from bagassets.assets.pictures.canvas import ACCENT, TEXT, Image, scaled_to, text
from bagassets.assets.pictures.channels import View
from bagassets.geometry.se3 import Floats, rotate

HALF_TRACK_M = 0.9
_OPACITY = 0.45
# Of band and picture; in single precision, rounded once, as where the processor multiplies and adds in one step. Elsewhere
# `cv2.addWeighted` rounds twice.
_REST = (np.float32(1 - _OPACITY) * np.arange(256, dtype=np.float32)).astype(np.float64)
_SUMS = float(np.float32(_OPACITY)) * np.arange(256.0)[:, np.newaxis] + _REST
_MIXED = np.rint(_SUMS.astype(np.float32)).astype(np.uint8)


def future_trajectory(
    image: Image,
    positions_global: Floats,
    rotations: Floats,
    seconds: Floats,
    view: View,
    *,
    width: int = 1280,
    title: str = "",
) -> Image:
    """Draw the band that the vehicle will drive over, as wide as a car, with a mark for each second.

    It lies at the height of the ego frame's origin, which is on the ground in most vehicles (REP 105).

    Args:
        image: (H, W, 3) BGR, as written.
        positions_global: (P, 3) of the ego frame from the moment of the image on.
        rotations: (P, 4) of the ego frame.
        seconds: (P,) time of each since the image.
        view: pose and model of the camera when the image was taken.
        width: of the picture in pixels.
        title: text in the corner.
    """
    picture = scaled_to(image, width).copy()
    scale = picture.shape[1] / image.shape[1]
    sides = [
        view.project(positions_global + rotate(rotations, np.array([0.0, side, 0.0])), scale)
        for side in (HALF_TRACK_M, -HALF_TRACK_M)
    ]
    (left, depth, left_seen), (right, _, right_seen) = sides
    band = picture.copy()
    # The band ends where one of its edges leaves the image.
    drawn = left_seen & right_seen & (depth > 0)
    for i in np.flatnonzero(drawn[:-1] & drawn[1:]).tolist():
        corners = np.array([left[i], left[i + 1], right[i + 1], right[i]])
        cv2.fillConvexPoly(band, np.rint(corners * 16).astype(np.int32), ACCENT, cv2.LINE_AA, 4)
    picture = _MIXED[band, picture]
    for second in range(1, int(seconds[-1]) + 1 if len(seconds) else 1):
        i = int(np.searchsorted(seconds, second))
        if i < len(seconds) and drawn[i]:
            a, b = (tuple(np.rint(side[i]).astype(int).tolist()) for side in (left, right))
            cv2.line(picture, a, b, TEXT, max(1, width // 900), cv2.LINE_AA)
            text(picture, f"{second} s", b[0] + 6, b[1] + 4, size_px=max(10, width / 100), halo=True)
    text(picture, title, 12, 24, size_px=max(11, width / 80), halo=True)
    return picture
