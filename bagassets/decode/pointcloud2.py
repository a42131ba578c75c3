"""`sensor_msgs/PointCloud2`, compressed or not, its forerunner `PointCloud`, and `foxglove.PointCloud`: clouds of any layout.

Fields are found by name, without regard to case, whatever their type, order, offset, padding
and byte order. The result has x, y, z in metres, intensity and ring:

* intensity stays as recorded: nuScenes' own files hold 0 to 255, and so do most drivers; for one that
  publishes 0 to 1 or 16-bit reflectivities the recipe has `intensity_scale`. It is
  `NO_INTENSITY` where the cloud has none, or where it is not finite.
* ring is the number of the laser; it is `NO_RING` where the cloud does not tell. It is not
  guessed from the rows of an organised cloud, because drivers disagree on what a row is.

Per-point times are described in `bagassets.decode.point_times`.
"""

import zlib
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import zstandard
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import Column, byte_array, head, pose_of
from bagassets.decode.model import CloudReading
from bagassets.decode.point_times import Moment, PointClock, point_times_ns, recorded_times, survey
from bagassets.geometry.se3 import SE3, rotate
from bagassets.recordings.damage import DamageError
from bagassets.recordings.decompress import TooLargeError, decompress, decompress_zlib
from bagassets.recordings.model import Message

POINT_CLOUDS = (
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/PointCloud",
    "point_cloud_interfaces/msg/CompressedPointCloud2",
    "foxglove_msgs/msg/PointCloud",
)
NO_INTENSITY = 0.0
NO_RING = -1.0

# Names of drivers: intensity (most), reflectivity (Ouster, Livox), i (LeddarTech), signal (Ouster), remission.
_INTENSITY_NAMES = ("intensity", "intensities", "i", "reflectivity", "reflectance", "remission", "signal")
# ring (Velodyne, Ouster, Hesai, RoboSense), channel (Nebula), line (Livox), laser_id and beam (others).
_RING_NAMES = ("ring", "channel", "laser_id", "laserid", "line", "beam", "beam_id", "ring_id", "row")

# sensor_msgs/PointField 1 to 8; 9 to 11 are PCL's extensions for 64-bit integers and booleans.
_TYPES = dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8", "i8", "u8", "u1"), start=1))
# foxglove.NumericType
_FOXGLOVE_TYPES = dict(enumerate(("u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8"), start=1))

_MOST_BYTES = 1 << 28  # of a cloud: sixteen times what 128 lasers with 2048 points of 64 bytes take
# Others than these lose something, so what is in a dataset would not be what the sensor measured.
_LOSSY = {
    "draco": "Draco moves points, and drops those that are equal",
    "cloudini": "Cloudini rounds numbers",
}


def point_fields(cloud: Message) -> dict[str, Column]:
    """Return field name in lower case -> (height, width) view of the values, without copies.

    Of a field with several elements per point the first is taken, of two fields of the same
    name the first. If the data have just the size of rows without gaps, `row_step` does not count: several drivers leave it
    zero, or give it in points.

    Raises:
        DecodeError: sizes contradict each other, a field lies outside its point, or see `_cloud_data`.
    """
    if hasattr(cloud, "channels"):
        return _listed_fields(cloud)
    data = _cloud_data(cloud)
    if hasattr(cloud, "point_stride"):
        step = int(cloud.point_stride)
        height, width = 1, len(data) // max(1, step)
        row_step = len(data)
        named = [
            (field.name, field.offset, _FOXGLOVE_TYPES.get(int(field.type)), 1) for field in cloud.fields
        ]
    else:
        height, width = int(cloud.height), int(cloud.width)
        step, row_step = int(cloud.point_step), int(cloud.row_step)
        named = [
            (field.name, field.offset, _TYPES.get(int(field.datatype)), int(field.count))
            for field in cloud.fields
        ]
    if len(data) == height * width * step:
        row_step = width * step
    if row_step < width * step or len(data) != row_step * height:
        raise DecodeError("its data has another size than height, width, point_step and row_step say")
    order = ">" if getattr(cloud, "is_bigendian", False) else "<"
    views: dict[str, Column] = {}
    for written, at, kind, count in named:
        name, offset = str(written).lower(), int(at)
        if kind is None:
            raise DecodeError(f"its field {name} has an unknown datatype")
        dtype = np.dtype(order + kind)
        if offset + dtype.itemsize * max(1, count) > step:
            raise DecodeError(f"its field {name} does not lie within point_step")
        if name in views:
            continue
        if height * width == 0:
            views[name] = np.zeros((height, width), dtype)
        else:
            views[name] = np.ndarray(
                (height, width), dtype, buffer=data, offset=offset, strides=(row_step, step)
            )
    return views


def _listed_fields(cloud: Message) -> dict[str, Column]:
    """Return the same of a `PointCloud`, a list of points with channels of one number for each."""
    points = np.array([(point.x, point.y, point.z) for point in cloud.points], np.float32).reshape(-1, 3)
    fields: dict[str, Column] = dict(zip("xyz", points.T, strict=True))
    for channel in cloud.channels:
        if len(channel.values) != len(points):
            raise DecodeError(f"its channel {channel.name} has another number of values than it has points")
        fields.setdefault(str(channel.name).lower(), np.asarray(channel.values))
    return {name: values.reshape(1, -1) for name, values in fields.items()}


def decode_pointcloud2(
    message: Message, header_stamp_is: Moment | None = None, stamp_is: Moment = "end"
) -> CloudReading:
    """Return the points of a lidar cloud, with their times as far as they follow from this cloud alone.

    Args:
        message: of a type in `POINT_CLOUDS`.
        header_stamp_is: the moment of the revolution that the header stamp means, according to the recipe;
            point times are read accordingly.
        stamp_is: the moment of the revolution for its stamp.

    Raises:
        DecodeError: see `read_pointcloud2` and `with_times`.
    """
    reading = read_pointcloud2(message)
    if reading.recorded is None:
        return reading
    return with_times(reading, survey([reading.recorded]), header_stamp_is, stamp_is)


def read_pointcloud2(message: Message) -> CloudReading:
    """Return the points of a lidar cloud with their times as recorded; points that are not finite are dropped and counted.

    Raises:
        DecodeError: x, y or z is missing, or the layout contradicts itself.
    """
    stamp, frame_id = head(message)
    fields = point_fields(message)
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise DecodeError(f"it has no field {', '.join(missing)}")
    height, width = fields["x"].shape
    grid = np.empty((height, width, 5), dtype=np.float32)
    with np.errstate(over="ignore"):  # a float64 beyond float32 becomes infinite and is dropped
        for column, axis in enumerate("xyz"):
            grid[:, :, column] = fields[axis]
        _fill(grid[:, :, 3], fields, _INTENSITY_NAMES, NO_INTENSITY)
        _fill(grid[:, :, 4], fields, _RING_NAMES, NO_RING)
    points: NDArray[np.float32] = grid.reshape(-1, 5)
    if hasattr(message, "pose"):
        place(points, pose_of(message.pose))
    finite = _finite_rows(points)
    if finite is not None:
        points = points[finite]
    return CloudReading(
        stamp_ns=stamp,
        frame_id=frame_id,
        points=points,
        times_ns=None,
        dropped=height * width - len(points),
        recorded=recorded_times(fields, finite, stamp),
    )


def place(points: NDArray[np.float32], frame_SE3_points: SE3) -> None:
    """Move (N, 5) points in place to the frame of their sensor, from where Foxglove's messages have their origin."""
    if frame_SE3_points != SE3():
        rotations = np.tile(np.array(frame_SE3_points.rotation), (len(points), 1))
        points[:, :3] = rotate(rotations, points[:, :3].astype(np.float64)) + np.array(
            frame_SE3_points.translation
        )


def with_times(
    reading: CloudReading, clock: PointClock, header_stamp_is: Moment | None, stamp_is: Moment
) -> CloudReading:
    """Return a cloud with the times of its points; those that have none are dropped and counted.

    Arguments and errors are those of `point_times_ns`.
    """
    if reading.recorded is None or clock.problem or not len(reading.points):
        return reading
    times_ns, kept = point_times_ns(reading.recorded, clock, header_stamp_is, stamp_is)
    if kept is None:
        return replace(reading, times_ns=times_ns)
    points = reading.points[kept]
    return replace(reading, points=points, times_ns=times_ns, untimed=len(kept) - len(points))


def without_zero_points(reading: CloudReading) -> CloudReading:
    """Return a cloud without the points at exactly 0, 0, 0, which are counted.

    That is inside of the sensor: drivers put shots there that hit nothing.
    """
    points = reading.points
    if points[:, 0].all():
        return reading
    hit = (points[:, 0] != 0.0) | (points[:, 1] != 0.0) | (points[:, 2] != 0.0)
    recorded = reading.recorded
    return replace(
        reading,
        points=points[hit],
        times_ns=None if reading.times_ns is None else reading.times_ns[hit],
        recorded=None if recorded is None else replace(recorded, values=recorded.values[hit]),
        dropped=reading.dropped + len(points) - int(hit.sum()),
    )


def _finite_rows(points: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """Return which of (N, >=3) points have finite x, y, z, or None if all have."""
    with np.errstate(over="ignore", invalid="ignore"):
        # One test of the sum instead of three; huge but finite numbers may fail it too.
        if np.isfinite(points[:, 0] + points[:, 1] + points[:, 2]).all():
            return None
    x, y, z = (np.isfinite(points[:, column]) for column in range(3))
    return np.asarray(x & y & z)


def _fill(
    column: NDArray[np.float32], fields: Mapping[str, Column], names: tuple[str, ...], default: float
) -> None:
    """Fill in the first field that has one of `names`, in the order of `names`."""
    values = next((fields[name] for name in names if name in fields), None)
    if values is None:
        column[:] = default
        return
    column[:] = values
    if values.dtype.kind == "f":
        column[~np.isfinite(column)] = default


def _cloud_data(cloud: Message) -> NDArray[np.uint8]:
    """Return the data of a cloud (N,), as they were before a transport compressed them.

    Args:
        cloud: a `PointCloud2`, or a `CompressedPointCloud2` of zlib_point_cloud_transport or zstd_point_cloud_transport.

    Raises:
        DecodeError: they are compressed in another way, damaged, or larger than the cloud says.
    """
    if not hasattr(cloud, "compressed_data"):
        return byte_array(cloud.data)
    row_bytes = max(int(cloud.row_step), int(cloud.width) * int(cloud.point_step))
    most_bytes = min(int(cloud.height) * row_bytes, _MOST_BYTES)
    packed, way = byte_array(cloud.compressed_data).tobytes(), str(cloud.format)
    try:
        if way == "zlib":
            return np.frombuffer(decompress_zlib(packed, most_bytes), np.uint8)
        if way == "zstd":
            return np.frombuffer(decompress(packed, way, most_bytes), np.uint8)
    except TooLargeError:
        raise DecodeError(
            "its data unpack to more than height, width and point_step say, or than any lidar sends"
        ) from None
    except (DamageError, zlib.error, zstandard.ZstdError):
        raise DecodeError(f"its data are damaged: they do not unpack with {way}") from None
    losses = next((why for name, why in _LOSSY.items() if way.startswith(name)), "nothing is known about it")
    raise DecodeError(
        f"its data are compressed in a way that is not read ({losses}); record the cloud itself, or with zstd or zlib"
    )
