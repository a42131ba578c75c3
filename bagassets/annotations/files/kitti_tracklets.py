"""`tracklet_labels.xml` of KITTI raw data: tracks with a pose in each frame, in the lidar frame.

Format: the readme of the raw data development kit, http://www.cvlibs.net/datasets/kitti/raw_data.php.
A pose's tx, ty, tz is the middle of the bottom face. The XML parser is used directly because only it
reports the line of each element.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from bagassets.annotations.files.label import Label, UnreadableLabelsError, axis_rotation, box_label, compose

__all__ = ["read_kitti_tracklets"]

_TRACKLET = ("boost_serialization", "tracklets", "item")
_POSE = (*_TRACKLET, "poses", "item")


@dataclass
class _Pose:
    line: int
    values: dict[str, str] = field(default_factory=dict)


@dataclass
class _Tracklet:
    line: int
    values: dict[str, str] = field(default_factory=dict)
    poses: list[_Pose] = field(default_factory=list)


class _Handler:
    """Collects tracklets from the parser's events."""

    def __init__(self) -> None:
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters
        self.parser.EntityDeclHandler = self._entity
        self.tracklets: list[_Tracklet] = []
        self.has_root = False
        self._path: list[str] = []
        self._text = ""

    def _start(self, name: str, _attributes: dict[str, str]) -> None:
        self._path.append(name)
        self._text = ""
        path, line = tuple(self._path), self.parser.CurrentLineNumber
        if path == _TRACKLET[:2]:
            self.has_root = True
        elif path == _TRACKLET:
            self.tracklets.append(_Tracklet(line))
        elif path == _POSE:
            self.tracklets[-1].poses.append(_Pose(line))

    def _end(self, name: str) -> None:
        self._path.pop()
        path = tuple(self._path)
        if path == _TRACKLET:
            self.tracklets[-1].values[name] = self._text.strip()
        elif path == _POSE:
            self.tracklets[-1].poses[-1].values[name] = self._text.strip()
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


def _labels(number: int, tracklet: _Tracklet) -> Iterator[Label]:
    try:
        first = int(tracklet.values["first_frame"])
        category = tracklet.values["objectType"]
        height, width, length = (float(tracklet.values[name]) for name in ("h", "w", "l"))
    except KeyError as err:
        yield from _unusable(tracklet, f"its tracklet has no {err.args[0]}")
        return
    except ValueError:
        yield from _unusable(tracklet, "size or first frame of its tracklet is no number")
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


def _unusable(tracklet: _Tracklet, problem: str) -> Iterator[Label]:
    """Yield a lost box for each pose of a broken tracklet."""
    for pose in tracklet.poses or [_Pose(tracklet.line)]:
        yield Label(pose.line, problem=problem)
