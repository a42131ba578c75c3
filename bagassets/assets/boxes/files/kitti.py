"""Label files of KITTI.

Label files (`.txt`): tracking (one file per sequence) and object detection (one file per frame).
Formats: the readme of the development kits of http://www.cvlibs.net/datasets/kitti. Boxes are in the
frame of the rectified camera, x right, y down, z forward: `location` is the middle of the bottom
face, `rotation_y` turns the object's front from x towards -z.

`tracklet_labels.xml` of raw data: tracks with a pose in each frame, in the lidar frame.
Format: the readme of the raw data development kit, http://www.cvlibs.net/datasets/kitti/raw_data.php.
A pose's tx, ty, tz is the middle of the bottom face. The XML parser is used directly because only it
reports the line of each element.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import sqrt
from xml.parsers import expat

from bagassets.assets.boxes.files.label import (
    Label,
    UnreadableLabelsError,
    as_text,
    axis_rotation,
    box_label,
    compose,
)

_OBJECT_COLUMNS = 15
# The box's x (front), y (left), z (up) at rotation_y 0 are the camera's x, z and -y.
_HALF = sqrt(0.5)
_CAM_FROM_BOX = (_HALF, _HALF, 0.0, 0.0)
_TRACKLET = ("boost_serialization", "tracklets", "item")
_POSE = (*_TRACKLET, "poses", "item")


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
            yield _line_label(line, words, tracking=tracking)


def _line_label(line: int, words: list[str], *, tracking: bool) -> Label:
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


@dataclass
class _Item:
    """A tracklet or, without poses of its own, one of its poses."""

    line: int
    values: dict[str, str] = field(default_factory=dict)
    poses: "list[_Item]" = field(default_factory=list)


class _Handler:
    """Collects tracklets from the parser's events."""

    def __init__(self) -> None:
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters
        self.parser.EntityDeclHandler = self._entity
        self.tracklets: list[_Item] = []
        self.has_root = False
        self._path: tuple[str, ...] = ()
        self._text = ""

    def _start(self, name: str, _attributes: dict[str, str]) -> None:
        self._path = (*self._path, name)
        self._text = ""
        item = _Item(self.parser.CurrentLineNumber)
        if self._path == _TRACKLET[:2]:
            self.has_root = True
        elif self._path == _TRACKLET:
            self.tracklets.append(item)
        elif self._path == _POSE:
            self.tracklets[-1].poses.append(item)

    def _end(self, name: str) -> None:
        self._path = self._path[:-1]
        if self._path in {_TRACKLET, _POSE}:
            item = self.tracklets[-1] if self._path == _TRACKLET else self.tracklets[-1].poses[-1]
            item.values[name] = self._text.strip()
        self._text = ""

    def _characters(self, text: str) -> None:
        self._text += text

    def _entity(self, *_: object) -> None:
        line = self.parser.CurrentLineNumber
        raise UnreadableLabelsError(line, "declares XML entities, which tracklets have no use for")


def read_kitti_tracklets(data: bytes) -> Iterator[Label]:
    """Yield the boxes of all tracks; the id of a track is its number in the file.

    Raises:
        UnreadableLabelsError: it is not XML, or has no tracklets.
    """
    handler = _Handler()
    try:
        handler.parser.Parse(data, True)
    except expat.ExpatError as err:
        raise UnreadableLabelsError(err.lineno, f"is no XML: {expat.ErrorString(err.code)}") from None
    except (ValueError, LookupError) as err:
        raise UnreadableLabelsError(1, f"is in an encoding that cannot be read ({err})") from None
    if not handler.has_root:
        raise UnreadableLabelsError(1, f"has no element {'/'.join(_TRACKLET[:2])}")
    for number, tracklet in enumerate(handler.tracklets):
        yield from _labels(number, tracklet)


def _labels(number: int, tracklet: _Item) -> Iterator[Label]:
    problem = ""
    try:
        first = int(tracklet.values["first_frame"])
        category = tracklet.values["objectType"]
        height, width, length = (float(tracklet.values[name]) for name in ("h", "w", "l"))
    except KeyError as err:
        problem = f"its tracklet has no {err.args[0]}"
    except ValueError:
        problem = "size or first frame of its tracklet is no number"
    if problem:
        # A lost box for each pose of a broken tracklet.
        yield from (Label(pose.line, problem=problem) for pose in tracklet.poses or [tracklet])
        return
    for offset, pose in enumerate(tracklet.poses):
        names = ("tx", "ty", "tz", "rx", "ry", "rz")
        try:
            x, y, z, roll, pitch, yaw = (float(pose.values[name]) for name in names)
        except KeyError as err:
            yield Label(pose.line, problem=f"it has no {err.args[0]}")
            continue
        except ValueError:
            yield Label(pose.line, problem="a number cannot be read")
            continue
        yield box_label(
            pose.line,
            (x, y, z + height / 2),
            compose(axis_rotation(2, yaw), axis_rotation(1, pitch), axis_rotation(0, roll)),
            (width, length, height),
            track_id=str(number),
            category=category,
            frame_number=first + offset,
        )
