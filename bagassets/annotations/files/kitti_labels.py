"""KITTI label files: tracking (one file per sequence) and object detection (one file per frame).

Formats: the readme of the development kits of http://www.cvlibs.net/datasets/kitti. Boxes are in the
frame of the rectified camera, x right, y down, z forward: `location` is the middle of the bottom
face, `rotation_y` turns the object's front from x towards -z.
"""

from collections.abc import Iterator
from math import sqrt

from bagassets.annotations.files.label import Label, as_text, axis_rotation, box_label, compose

__all__ = ["read_kitti_labels"]

_OBJECT_COLUMNS = 15
# The box's x (front), y (left), z (up) at rotation_y 0 are the camera's x, z and -y.
_HALF = sqrt(0.5)
_CAM_FROM_BOX = (_HALF, _HALF, 0.0, 0.0)


def read_kitti_labels(data: bytes, *, tracking: bool) -> Iterator[Label]:
    """Yield the boxes of a file; `DontCare` regions are no boxes.

    Args:
        data: content of the file.
        tracking: True if lines begin with frame number and track id.

    Raises:
        UnreadableLabelsError: it is not UTF-8 text.
    """
    for line, text in enumerate(as_text(data).splitlines(), start=1):
        words = text.split()
        if words:
            yield _label(line, words, tracking=tracking)


def _label(line: int, words: list[str], *, tracking: bool) -> Label:
    frame_number, track_id = None, ""
    expected = _OBJECT_COLUMNS + (2 if tracking else 0)
    if len(words) not in (expected, expected + 1):
        return Label(line, problem=f"it has {len(words)} columns instead of {expected} or {expected + 1}")
    if tracking:
        try:
            frame_number, track = int(words[0]), int(words[1])
        except ValueError:
            return Label(line, problem="its frame or track is no whole number")
        track_id = "" if track < 0 else str(track)
        words = words[2:]
    category = words[0]
    if category == "DontCare":
        return Label(line)
    try:
        numbers = [float(word) for word in words[8:]]
    except ValueError:
        return Label(line, problem="a number cannot be read")
    height, width, length, x, y, z, rotation_y = numbers[:7]
    return box_label(
        line,
        (x, y - height / 2, z),
        compose(axis_rotation(1, rotation_y), _CAM_FROM_BOX),
        (width, length, height),
        track_id=track_id,
        category=category,
        frame_number=frame_number,
        score=numbers[7] if len(numbers) > 7 else 1.0,
    )
