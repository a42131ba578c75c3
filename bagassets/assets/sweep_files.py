"""The files of a lidar or radar channel, and the counts of its messages and points."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import pyarrow as pa

from bagassets.assets.asset import omitted
from bagassets.assets.channel import Counts
from bagassets.assets.channel_index import FILE_COLUMNS, file_row
from bagassets.base.columns import table_of_rows
from bagassets.base.json_types import JsonObject
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Limits
from bagassets.recipe.model_base import Clock
from bagassets.store.artifact import ArtifactWriter

Motion = tuple[Trajectory, SE3]
"""The ego poses, and the pose of a sensor."""

_COLUMNS = FILE_COLUMNS | {"points": pa.int32()}
_RADAR_SCHEMA = pa.schema(_COLUMNS)
LIDAR_SCHEMA = pa.schema(_COLUMNS | {"start_ns": pa.int64(), "end_ns": pa.int64()})
"""Columns of `index.parquet` of a lidar; that of a radar is without the last two."""


@dataclass(frozen=True, kw_only=True)
class SensorSettings:
    """Settings of any lidar or radar in the recipe.

    Attributes:
        topic: topic of its messages.
        clock: which time of a message counts.
        lost_messages: share of the messages that may be lost.
        cloud_points: points of the largest message that is read.
    """

    topic: str
    clock: Clock
    lost_messages: float
    cloud_points: int = omitted(Limits().cloud_points)


@dataclass(frozen=True, kw_only=True)
class SensorUse:
    """Everything besides its messages that shapes the files of a lidar or radar; subclasses add to it.

    Attributes:
        channel: canonical name.
        modality: modality of the channel.
        msgtype: type of the messages, `pkg/msg/Type`.
        decoder: the plug-in that decodes them; None for a built-in decoder.
        ego_SE3_sensor: its mount from `calibration.json`, if its files are corrected for its motion: those of a lidar that
            is deskewed, and of a radar whose velocities are relative to it; else None.
    """

    channel: str
    modality: Literal["lidar", "radar"]
    msgtype: str
    decoder: Mapping[str, str] | None = omitted()
    ego_SE3_sensor: SE3 | None = omitted()


class PointCounts(Counts):
    """Counts of points, of which none are merged: read = written + sum of lost, which are called dropped."""

    def lose(self, reason: str, number: int = 1) -> None:
        """Count dropped points by their reason, if there are any."""
        if number:
            super().lose(reason, number)

    def as_json(self) -> JsonObject:
        """Return the counts as JSON."""
        return {"read": self.read, "written": self.written, "dropped": dict(self.lost)}


class SweepFiles:
    """Writes the files of one channel, and counts messages and points.

    Of two readings whose stamps are equal in microseconds, the unit of nuScenes, the first is kept:
    they would be one row there.

    Args:
        out: writes the artifact.
        extension: extension of the files, `.pcd.bin` or `.pcd`.
        with_span: True if the index has begin and end of each revolution.

    Attributes:
        counts: counts of messages (for packet lidars: of packets).
        points: counts of points.
        bytes: total size of the files.
    """

    def __init__(self, out: ArtifactWriter, extension: str, *, with_span: bool) -> None:
        self.counts = Counts()
        self.points = PointCounts()
        self.bytes = 0
        self._out = out
        self._extension = extension
        self._schema = LIDAR_SCHEMA if with_span else _RADAR_SCHEMA
        self._rows: list[JsonObject] = []
        self._stamps_us: set[int] = set()

    def write(
        self,
        stamp_ns: int,
        log_time_ns: int,
        data: bytes | memoryview,
        points: int,
        *,
        parts: int = 1,
        span_ns: tuple[int, int] | None = None,
    ) -> None:
        """Write one reading made of `parts` messages, or count it as lost if there is one with its stamp."""
        if stamp_ns // 1000 in self._stamps_us:
            self.lose("duplicate stamp", parts, points)
            return
        self._stamps_us.add(stamp_ns // 1000)
        entry = self._out.write(f"{stamp_ns}{self._extension}", data)
        row = file_row(entry, stamp_ns, log_time_ns) | {"points": points}
        if span_ns is not None:
            row |= {"start_ns": span_ns[0], "end_ns": span_ns[1]}
        self._rows.append(row)
        self.counts.written += 1
        self.counts.merged += parts - 1
        self.points.written += points
        self.bytes += entry.size

    def lose(self, reason: str, parts: int = 1, points: int = 0) -> None:
        """Count a reading and its remaining points as lost."""
        self.counts.lose(reason, parts)
        self.points.lose(reason, points)

    def finish(self, description: JsonObject) -> None:
        """Write `index.parquet`, sorted by stamp, and `channel.json`."""
        rows = sorted(self._rows, key=lambda row: row["stamp_ns"])
        self._out.write_table("index.parquet", table_of_rows(rows, self._schema))
        self._out.write_json("channel.json", description)
