"""What a calibration file says of a camera, whatever its format."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from bagassets.base.errors import CalibrationError
from bagassets.base.json_types import Json
from bagassets.geometry.se3 import SE3, Floats, quaternion_from_rotation

# Files are written with as few as four digits.
ROTATION_TOLERANCE = 1e-3


@dataclass(frozen=True)
class FileLens:
    """Intrinsics of a camera, as they stand in the file.

    Attributes:
        model: distortion model, named as in sensor_msgs/CameraInfo; "" without distortion.
        width: image width in pixels.
        height: image height in pixels.
        k: (9,) intrinsic matrix, row by row, pixels.
        d: distortion coefficients in the order of the model.
        r: (9,) rectification, row by row; None if the file has none.
        p: (12,) projection matrix of the rectified image, row by row; None if the file has none.
    """

    model: str
    width: int
    height: int
    k: tuple[float, ...]
    d: tuple[float, ...]
    r: tuple[float, ...] | None = None
    p: tuple[float, ...] | None = None


@dataclass(frozen=True)
class FilePose:
    """Where a camera is.

    Attributes:
        reference_SE3_sensor: its pose.
        reference: what that is relative to, for people, as in `the IMU`.
        is_sensor: the reference is itself a camera, whose frame is not the vehicle's.
        notes: sentences, without full stop, on what the file says and nothing here uses.
    """

    reference_SE3_sensor: SE3
    reference: str
    is_sensor: bool = False
    notes: tuple[str, ...] = ()


class CalibrationFile(ABC):
    """The cameras of one file. What it says of each is checked when it is asked for.

    Args:
        name: of the file, for messages.
    """

    kind: str
    """What it is, with an article."""

    def __init__(self, name: str) -> None:
        self.name = name

    @property
    @abstractmethod
    def cameras(self) -> tuple[str, ...]:
        """The names of its cameras; "" for one without a name."""

    def topic(self, camera: str) -> str:
        """Return the topic of a camera's images; "" if the file does not say."""
        del camera
        return ""

    @abstractmethod
    def lens(self, camera: str, model: str | None) -> FileLens:
        """Return the intrinsics of a camera.

        Args:
            camera: one of `cameras`.
            model: its distortion model, if the file names none.

        Raises:
            CalibrationError: they are missing, not what they should be, or of a model that is not supported.
        """

    def pose(self, camera: str) -> FilePose:
        """Return the pose of a camera.

        Raises:
            CalibrationError: the file has none.
        """
        del camera
        raise CalibrationError(
            f"{self.name}: {self.kind} holds no pose of its camera, as `extrinsics` needs; name a Kalibr camchain or a "
            "kapture rigs.txt, or remove `extrinsics` if TF or a `urdf` has it."
        )

    def choose(self, camera: str | None, topic: str) -> str:
        """Return the name of the camera that is meant.

        Args:
            camera: its name, if the recipe gives it.
            topic: topic of the channel.

        Raises:
            CalibrationError: there is no such camera, or there are several and none is of the topic.
        """
        names = self.cameras
        if camera is not None:
            if camera in names:
                return camera
            if names == ("",):
                raise CalibrationError(
                    f"{self.name}: its camera has no name, so `camera: {camera}` cannot be found; remove `camera`."
                )
            raise CalibrationError(
                f"{self.name}: there is no camera {camera}, only {', '.join(names)}; correct `camera`."
            )
        if len(names) == 1:
            return names[0]
        of_topic = self._of_topic(topic)
        if len(of_topic) == 1:
            return of_topic[0]
        if not names:
            raise CalibrationError(f"{self.name}: {self.kind} without a camera; name another file.")
        known = ", ".join(f"{name} ({self.topic(name)})" if self.topic(name) else name for name in names)
        which = "several are" if of_topic else "none is"
        raise CalibrationError(
            f"{self.name}: it holds the cameras {known}, of which {which} of topic {topic}; name one in `camera`."
        )

    def of_topic(self, topic: str) -> str | None:
        """Return the name of the only camera of a topic; None if there is none, or several are."""
        names = self._of_topic(topic)
        return names[0] if len(names) == 1 else None

    def _of_topic(self, topic: str) -> list[str]:
        plain = _plain(topic)
        return [name for name in self.cameras if _plain(self.topic(name)) == plain]

    def refuse_model(self, model: str | None) -> None:
        """Refuse a distortion model from the recipe, since the file names its own.

        Raises:
            CalibrationError: one is given.
        """
        if model is not None:
            raise CalibrationError(
                f"{self.name}: {self.kind} names its distortion model itself; remove `model: {model}`."
            )


def _plain(topic: str) -> str:
    """Return a topic as it is called when nothing is compressed."""
    return "/" + topic.strip("/").removesuffix("/compressed")


class Fields:
    """A mapping in a calibration file whose scalars are texts, read field by field.

    Args:
        value: the mapping.
        name: of the file.
        at: where in the file it is, as in `cam0`; "" for the whole.
    """

    def __init__(self, value: Mapping[str, Json], name: str, at: str = "") -> None:
        self._value = value
        self._name = name
        self._at = at

    def has(self, field: str) -> bool:
        """Return whether there is a field and it has a value."""
        return self._value.get(field) not in (None, "")

    def text(self, field: str, meaning: str) -> str:
        """Return a text."""
        value = self._get(field, meaning)
        if not isinstance(value, str):
            raise self.error(field, f"expected {meaning}, found {_kind(value)}")
        return value

    def whole(self, field: str, meaning: str) -> int:
        """Return a positive whole number."""
        number = self._number(field, self._get(field, meaning), meaning)
        if number != int(number) or number <= 0:
            raise self.error(field, f"expected {meaning}, a positive whole number, found {number:g}")
        return int(number)

    def number(self, field: str, meaning: str) -> float:
        """Return a number."""
        return self._number(field, self._get(field, meaning), meaning)

    def numbers(self, field: str, meaning: str, count: int | None = None) -> tuple[float, ...]:
        """Return a list of numbers.

        Args:
            field: its name.
            meaning: what it is.
            count: how many there must be; None for any number.
        """
        value = self._get(field, meaning)
        if not isinstance(value, list):
            raise self.error(field, f"expected {meaning}, a list of numbers, found {_kind(value)}")
        numbers = tuple(self._number(field, one, meaning) for one in value)
        if count is not None and len(numbers) != count:
            raise self.error(field, f"expected {meaning}, {count} numbers, found {len(numbers)}")
        return numbers

    def section(self, field: str, meaning: str) -> "Fields":
        """Return a mapping."""
        value = self._get(field, meaning)
        if not isinstance(value, dict):
            raise self.error(field, f"expected {meaning}, a mapping, found {_kind(value)}")
        return Fields(value, self._name, f"{self._at}.{field}" if self._at else field)

    def transform(self, field: str, meaning: str) -> SE3:
        """Return a rigid transform that is written as a 4x4 matrix, a list of rows."""
        value = self._get(field, meaning)
        wanted = f"expected {meaning}, four rows of four numbers"
        if not (isinstance(value, list) and all(isinstance(row, list) for row in value)):
            raise self.error(field, f"{wanted}, found {_kind(value)}")
        rows = [[self._number(field, one, meaning) for one in row] for row in value]
        if [len(row) for row in rows] != [4] * 4:
            raise self.error(field, f"{wanted}, found rows of {', '.join(str(len(row)) for row in rows)}")
        matrix = np.array(rows)
        if not (_is_rotation(matrix[:3, :3]) and rows[3] == [0.0, 0.0, 0.0, 1.0]):
            raise self.error(
                field, f"expected {meaning}, a rotation beside a translation, and last the row 0 0 0 1"
            )
        return SE3.create(quaternion_from_rotation(matrix[:3, :3]), matrix[:3, 3])

    def error(self, field: str, problem: str) -> CalibrationError:
        """Return the error for a field.

        Args:
            field: its name.
            problem: what is wrong, without full stop.
        """
        place = f"{self._at}.{field}" if self._at else field
        return CalibrationError(f"{self._name}: {place}: {problem}; correct the file or name another one.")

    def _get(self, field: str, meaning: str) -> Json:
        if not self.has(field):
            raise self.error(field, f"this field is missing, expected {meaning}")
        return self._value[field]

    def _number(self, field: str, value: Json, meaning: str) -> float:
        number = finite(value) if isinstance(value, str) else None
        if number is None:
            raise self.error(field, f"expected {meaning}, in numbers, found {_kind(value)}")
        return number


def finite(text: str) -> float | None:
    """Return the number in a text; None if it is none, or not finite."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if isfinite(number) else None


def _is_rotation(matrix: Floats) -> bool:
    """Return whether the rows of a (3, 3) matrix are axes at right angles, in right-handed order."""
    a, b, c = matrix
    lengths = (a * a).sum(), (b * b).sum(), (c * c).sum()
    products = (a * b).sum(), (b * c).sum(), (a * c).sum()
    return (
        all(abs(float(value) - 1) < ROTATION_TOLERANCE for value in lengths)
        and all(abs(float(value)) < ROTATION_TOLERANCE for value in products)
        and float((np.cross(a, b) * c).sum()) > 0
    )


def _kind(value: Json | Sequence[Json]) -> str:
    if value is None or value == "":
        return "nothing"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    text = str(value)
    return repr(text if len(text) <= 40 else text[:37] + "...")
