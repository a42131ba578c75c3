#!/usr/bin/env bash
# A tag 36h11, 160 pixels wide, is drawn with OpenCV, and detected by OpenCV (aruco) and by the AprilTag library. Do they agree on its corners?
# Guess: within 0.1 pixels, and the first corner of one is a corner of that name for the other.
# Seen with opencv-contrib-python-headless 4.14.0.94 and apriltag-python 3.4.5 on 2026-11-29:
# - the first corner is the top left one for OpenCV, and "left bottom" (`lb`) for AprilTag, which is where OpenCV has its SECOND, at the top
#   right: to AprilTag OpenCV's picture is upside down, so a board whose tags were printed with one is turned by 180 degrees for the other
# - AprilTag counts pixels from their edge: corners are 0.5 pixels to the right and down of what `solvePnP` and a camera matrix of ROS or
#   OpenCV, which count from the middle, expect: 240 to 400 where 239.5 to 399.5 are right
# - OpenCV does both: as it is set up, 240 to 399, the middles of the outermost pixels, so that the tag is a pixel too small; SUBPIX is right
#   within 0.06; with APRILTAG as refinement the corners are AprilTag's, half a pixel off
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check opencv-contrib-python-headless==4.14.0.94 apriltag-python==3.4.5 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import cv2
import numpy as np
from apriltag import apriltag

SIZE, LEFT, TOP = 160, 240, 160
dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
image = np.full((480, 640), 255, np.uint8)
image[TOP : TOP + SIZE, LEFT : LEFT + SIZE] = cv2.aruco.generateImageMarker(dictionary, 7, SIZE)


def corners_of(left, right, top, bottom):
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def aruco(refinement=None):
    parameters = cv2.aruco.DetectorParameters()
    if refinement is not None:
        parameters.cornerRefinementMethod = refinement
    (found,), numbers, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    assert numbers.tolist() == [[7]]
    return found[0]


right = corners_of(LEFT - 0.5, LEFT + SIZE - 0.5, TOP - 0.5, TOP + SIZE - 0.5)  # the middle of a pixel is a whole number
seen = {
    "aruco": aruco(),
    "aruco, SUBPIX": aruco(cv2.aruco.CORNER_REFINE_SUBPIX),
    "aruco, APRILTAG": aruco(cv2.aruco.CORNER_REFINE_APRILTAG),
}
(tag,) = apriltag("tag36h11", decimate=1.0).detect(image)
seen["apriltag, lb rb rt lt"] = tag["lb-rb-rt-lt"]
for name, corners in seen.items():
    print(f"{name}: {np.round(corners, 2).tolist()}")
assert np.array_equal(seen["aruco"], corners_of(240, 399, 160, 319))
assert np.abs(seen["aruco, SUBPIX"] - right).max() < 0.1
assert np.abs(seen["aruco, APRILTAG"] - (right + 0.5)).max() < 0.01
assert tag["id"] == 7
assert np.abs(seen["apriltag, lb rb rt lt"] - (right + 0.5)[[1, 0, 3, 2]]).max() < 0.01
PYTHON
