"""`point_cloud_interfaces/CompressedPointCloud2` of point_cloud_transport: a `PointCloud2` whose data are compressed as a whole."""

import zlib

import numpy as np
import zstandard
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import byte_array
from bagassets.recordings.damage import DamageError
from bagassets.recordings.decompress import TooLargeError, decompress, decompress_zlib
from bagassets.recordings.model import Message

_MOST_BYTES = 1 << 28  # of a cloud: sixteen times what 128 lasers with 2048 points of 64 bytes take
# Others than these lose something, so what is in a dataset would not be what the sensor measured.
_LOSSY = {
    "draco": "Draco moves points, and drops those that are equal",
    "cloudini": "Cloudini rounds numbers",
}


def cloud_data(cloud: Message) -> NDArray[np.uint8]:
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
