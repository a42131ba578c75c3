"""The files of readings, decoded: images, and the points of lidars and radars, which know their frame."""

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DatasetError
from bagassets.formats.reader.source import Reading
from bagassets.formats.reader.table_folder import TableFolder
from bagassets.geometry.se3 import SE3

_LIDAR_FIELDS: tuple[str, ...] = ("x", "y", "z", "intensity", "ring")
_TRIES = 3
_GREY_16 = bytes([16, 0])
"""Bit depth and colour type in the header of a PNG."""
_PCD_KINDS = {"F": "f", "I": "i", "U": "u"}


class Points(np.ndarray[Any, np.dtype[np.float32]]):
    """The points of one reading: float32 (N, fields) in the frame of the sensor, metres.

    It is an array. Rows taken from it, and copies, know their frame as well; other columns do not.

    Attributes:
        fields: names of the columns; x, y and z come first.
        global_SE3_ego: pose of the ego frame at the time of the reading.
        ego_SE3_sensor: where the sensor sits.
    """

    fields: tuple[str, ...]
    global_SE3_ego: SE3
    ego_SE3_sensor: SE3

    @classmethod
    def of(
        cls, values: NDArray[np.float32], fields: tuple[str, ...], global_SE3_ego: SE3, ego_SE3_sensor: SE3
    ) -> Self:
        """Return points with values (N, fields)."""
        points = values.view(cls)
        points.fields, points.global_SE3_ego, points.ego_SE3_sensor = fields, global_SE3_ego, ego_SE3_sensor
        return points

    def __array_finalize__(self, source: object) -> None:
        self.fields = getattr(source, "fields", ())
        self.global_SE3_ego = getattr(source, "global_SE3_ego", SE3())
        self.ego_SE3_sensor = getattr(source, "ego_SE3_sensor", SE3())

    def __reduce__(self) -> tuple[Any, ...]:
        return Points.of, (np.array(self), self.fields, self.global_SE3_ego, self.ego_SE3_sensor)

    def in_ego(self) -> NDArray[np.float32]:
        """Return them in the ego frame at the time of the reading: (N, fields), other columns unchanged.

        Raises:
            ValueError: columns were taken away.
        """
        return self._placed(self.ego_SE3_sensor)

    def in_global(self) -> NDArray[np.float32]:
        """Return them in the global frame: (N, fields), other columns unchanged.

        They are float32 as well: a millimetre, 10 km from the origin.

        Raises:
            ValueError: columns were taken away.
        """
        return self._placed(self.global_SE3_ego @ self.ego_SE3_sensor)

    def _placed(self, frame_SE3_sensor: SE3) -> NDArray[np.float32]:
        if self.ndim != 2 or self.shape[1] != len(self.fields):
            raise ValueError(
                f"expected points with {len(self.fields)} columns ({', '.join(self.fields)}), got an array of shape {self.shape}; "
                "transform first, and take columns from the result."
            )
        matrix = frame_SE3_sensor.matrix
        placed = np.array(self, dtype=np.float32)
        placed[:, :3] = placed[:, :3].astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        return placed


def read_image(folder: TableFolder, reading: Reading) -> NDArray[Any]:
    """Decode and return the image of a camera: uint8 (height, width, 3), RGB; of 16 bits, as depth is, uint16 (height, width).

    Raises:
        DatasetError: the file is missing or damaged.
    """
    import cv2

    data = _content(folder, reading)
    as_rgb: int | None = getattr(cv2, "IMREAD_COLOR_RGB", None)  # since OpenCV 4.11; spares a pass
    kind = cv2.IMREAD_COLOR if as_rgb is None else as_rgb
    header = data[12:26].tobytes()
    if header.startswith(b"IHDR") and header.endswith(_GREY_16):  # OpenCV would keep the upper 8 bits
        kind = cv2.IMREAD_ANYDEPTH
    image = cv2.imdecode(data, kind | cv2.IMREAD_IGNORE_ORIENTATION) if len(data) else None
    if image is None:
        raise DatasetError(
            f"{reading.path}: expected an image, but it cannot be decoded; `bagassets verify` finds and removes damaged "
            "files, and the next build makes them again."
        )
    if as_rgb is None and image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    folder.recent.append(image)
    return np.asarray(image)


def read_points(folder: TableFolder, reading: Reading) -> Points:
    """Read and return the points of a lidar or radar, float32 in the frame of the sensor, metres.

    Raises:
        DatasetError: the file is missing or damaged.
    """
    read = _lidar_points if reading.modality == "lidar" else _radar_points
    values, fields = read(_content(folder, reading), reading.path)
    return Points.of(values, fields, reading.find_pose(), reading.ego_SE3_sensor)


def _content(folder: TableFolder, reading: Reading) -> NDArray[np.uint8]:
    """Read a file; if it is missing although the dataset is as it was opened, a build may be putting it back right now."""
    for _ in range(_TRIES):
        try:
            return np.fromfile(reading.path, dtype=np.uint8)
        except FileNotFoundError:
            if not folder.is_current():
                raise folder.outdated(reading.path) from None
        except OSError as err:
            raise DatasetError(
                f"{reading.path}: this file of the dataset cannot be read ({err.strerror}); check the disk and its permissions."
            ) from err
    raise folder.missing(reading.path)


def _lidar_points(data: NDArray[np.uint8], path: Path) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """Return the points (N, 5) of a lidar file of nuScenes, and the names of the fields.

    Raises:
        DatasetError: it is none.
    """
    size = 4 * len(_LIDAR_FIELDS)
    if len(data) % size:
        raise DatasetError(
            f"{path}: expected points of {size} bytes, got {len(data)} bytes; `bagassets verify` finds such files."
        )
    return data.view("<f4").reshape(-1, len(_LIDAR_FIELDS)).astype(np.float32, copy=False), _LIDAR_FIELDS


def _radar_points(data: NDArray[np.uint8], path: Path) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """Return the targets (N, fields) of a radar file of nuScenes, whatever their states, and the names of the fields.

    Raises:
        DatasetError: it is none.
    """
    head, _, body = data.tobytes().partition(b"DATA binary\n")
    try:
        lines = {words[0]: words[1:] for line in head.decode().splitlines() if (words := line.split())}
        fields = tuple(lines["FIELDS"])
        kinds = [
            f"<{_PCD_KINDS[kind]}{size}" for kind, size in zip(lines["TYPE"], lines["SIZE"], strict=True)
        ]
        dtype = np.dtype(list(zip(fields, kinds, strict=True)))
        table = np.frombuffer(body, dtype=dtype, count=int(lines["POINTS"][0]))
    except (KeyError, ValueError) as err:
        raise DatasetError(
            f"{path}: expected a radar file of nuScenes, but it cannot be read ({err}); `bagassets verify` finds such files."
        ) from err
    points = np.stack([table[name].astype(np.float32) for name in fields], axis=1)
    # A file without targets has one of NaN.
    return points[~np.isnan(points).any(axis=1)], fields
