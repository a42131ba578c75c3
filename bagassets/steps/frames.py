"""The step `frames`: one camera channel of a recording becomes image files and an index.

Files: `<stamp_ns>.jpg` or `<stamp_ns>.png`, `index.parquet`, `channel.json`.
"""

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import pyarrow as pa

from bagassets.bags.inventory import Inventory
from bagassets.bags.model import RawMessage, Recording
from bagassets.decode.compressed_image import decode_compressed_image
from bagassets.decode.image import decode_image
from bagassets.decode.model import ImageReading
from bagassets.decode.registry import plugin_decoder
from bagassets.errors import BagAssetsError, DecodeError, LossLimitError
from bagassets.recipe.model import CameraChannel, Limits
from bagassets.recipe.model_base import Clock
from bagassets.steps.channel import Counts, Request
from bagassets.steps.grey_survey import GreySurvey
from bagassets.steps.image_output import (
    ImageOutput,
    intrinsic_matrix,
    raw_pixels,
    require_calibration,
)
from bagassets.steps.topic_types import require_type
from bagassets.store.action import Step
from bagassets.store.artifact import ArtifactWriter, FileEntry
from bagassets.trace import span

__all__ = ["STEP", "FrameExtractor", "request"]

STEP = Step("frames", 5, ("opencv-python-headless", "pyarrow"))

_SCHEMA = pa.schema(
    {
        "stamp_ns": pa.int64(),
        "log_time_ns": pa.int64(),
        "file": pa.string(),
        "size": pa.int64(),
        "digest": pa.string(),
        "width": pa.int32(),
        "height": pa.int32(),
    }
)
_DECODERS = {
    "sensor_msgs/msg/Image": decode_image,
    "sensor_msgs/msg/CompressedImage": decode_compressed_image,
}


def request(
    name: str,
    channel: CameraChannel,
    clock: Clock,
    limits: Limits,
    inventory: Inventory,
    *,
    camera: Mapping[str, Any] | None,
) -> Request:
    """Return what the step reads of this recording.

    Args:
        name: canonical channel.
        channel: its part of the recipe.
        clock: which time of a message counts.
        limits: accepted losses and sizes.
        inventory: what is in the recording.
        camera: intrinsics of the channel in `calibration.json`, or None.

    Raises:
        CalibrationError: the channel is to be undistorted and has no intrinsics, or those of an image larger
            than `limits` allow.
        DecodeError: the topic does not carry images.
        PluginError: several decoder plug-ins claim its type.
    """
    topic = inventory.topic(channel.topic)
    plugin = require_type(name, channel.topic, topic.msgtype, "image")
    params: dict[str, Any] = channel.model_dump(
        mode="json", include={"topic", "output", "quality", "undistort", "target", "to_8bit"}
    )
    if channel.output == "png":
        del params["quality"]  # PNG has none, so a change of it makes nothing stale
    lens = None
    if camera is not None:
        lens = {key: camera[key] for key in ("model", "width", "height", "k", "d", "binning", "roi")}
    params |= {
        "channel": name,
        "msgtype": topic.msgtype,
        "clock": clock,
        "lost_messages": limits.lost_messages,
        **limits.changed("image_pixels"),
        "camera": lens,
        **plugin,
    }
    require_calibration(params)
    return Request(params, (channel.topic,))


# Images of one channel that wait or are worked on: enough to keep threads busy, and the memory bounded.
_MOST_IN_FLIGHT = 4
_LARGE_BYTES = 40_000_000  # of these one waits


@dataclass(frozen=True, slots=True)
class _Written:
    """An image file in the artifact."""

    entry: FileEntry
    extension: str
    width: int
    height: int


class FrameExtractor:
    """Turns the messages of one camera into the files of an artifact.

    Args:
        params: as made by `request`.
        recording: decodes the messages.
        out: the artifact.
        pool: threads that convert, encode and write; None to do so at once.
    """

    def __init__(
        self,
        params: Mapping[str, Any],
        recording: Recording,
        out: ArtifactWriter,
        pool: Executor | None = None,
    ) -> None:
        cv2.setNumThreads(1)  # parallel over images, not inside one
        self.topics: tuple[str, ...] = (params["topic"],)
        self._params = {"quality": 90, **params}
        self._recording = recording
        self._decoder: Callable[[Any], ImageReading] = (
            plugin_decoder("image", params["msgtype"], params.get("decoder")) or _DECODERS[params["msgtype"]]
        )
        self._out = out
        self._counts = Counts()
        rule = params["to_8bit"]
        self._percentiles: tuple[float, float] | None = None if rule is None else rule["percentiles"]
        self._survey = None if self._percentiles is None else GreySurvey(out.scratch)
        fixed = None if rule is None or rule["range"] is None else (rule["range"][0], rule["range"][1])
        self._output = ImageOutput(self._params, fixed)
        self._pool = pool
        self._in_flight: deque[tuple[int, int, Future[_Written]]] = deque()
        self._rows: list[dict[str, Any]] = []
        self._stamps_us: set[int] = set()
        self._frame_id = ""
        self._failed = 0
        self._first_error: str | None = None
        self._extension = ".jpg"

    def add(self, message: RawMessage) -> None:
        """Take the next message; one that cannot be decoded is counted as lost."""
        if self._survey is None:
            self._convert(message)
            return
        try:
            pixels = raw_pixels(self._decode(message), Limits.of(self._params).image_pixels)
        except DecodeError:
            pixels = None  # counted as lost when its turn comes
        self._survey.add(message, pixels)

    def _convert(self, message: RawMessage) -> None:
        self._counts.read += 1
        try:
            reading = self._decode(message)
        except DecodeError as err:
            self._fail(err)
            return
        if not reading.stamp_ns and self._params["clock"] == "header":
            self._fail(DecodeError("its header stamp is zero; set `clock: log` in the recipe"), "zero stamp")
            return
        stamp_us = reading.stamp_ns // 1000
        if stamp_us in self._stamps_us:
            self._counts.lose("duplicate stamp")
            return
        self._stamps_us.add(stamp_us)
        self._frame_id = self._frame_id or reading.frame_id
        if self._pool is None:
            self._take(reading.stamp_ns, message.log_time_ns, partial(self._write, reading))
            return
        if not _outlasts_the_call(message.data):
            pixels, encoded = reading.pixels, reading.encoded
            reading = replace(
                reading,
                pixels=None if pixels is None else pixels.copy(),
                encoded=None if encoded is None else bytes(encoded),
            )
        future = self._pool.submit(self._write, reading)
        self._in_flight.append((reading.stamp_ns, message.log_time_ns, future))
        held = len(reading.encoded or b"") if reading.pixels is None else reading.pixels.nbytes
        while len(self._in_flight) > (1 if held > _LARGE_BYTES else _MOST_IN_FLIGHT):
            self._collect()

    def finish(self) -> dict[str, Any]:
        """Write what is left and the index; return the summary.

        Raises:
            LossLimitError: more was lost than the recipe allows, or the counts do not add up.
        """
        if self._survey is not None and self._percentiles is not None:
            self._output.grey_range = self._survey.range(*self._percentiles)
            for message in self._survey.messages():
                self._convert(message)
        while self._in_flight:
            self._collect()
        self._check()
        params = self._params
        rows = sorted(self._rows, key=lambda row: row["stamp_ns"])
        self._out.write_table("index.parquet", pa.Table.from_pylist(rows, schema=_SCHEMA))
        facts = {"counts": self._counts.as_json()}
        self._out.write_json(
            "channel.json",
            {
                "channel": params["channel"],
                "modality": "camera",
                "topic": params["topic"],
                "frame_id": self._frame_id,
                "fileformat": self._extension.removeprefix("."),
                "camera_intrinsic": intrinsic_matrix(self._output.written),
                **facts,
            },
        )
        return {**facts, "messages": self._counts.read, "bytes": sum(row["size"] for row in rows)}

    def _decode(self, message: RawMessage) -> ImageReading:
        reading = self._decoder(self._recording.decode(message))
        if self._params["clock"] == "log":
            return replace(reading, stamp_ns=message.log_time_ns)
        return reading

    def _collect(self) -> None:
        stamp_ns, log_time_ns, future = self._in_flight.popleft()
        self._take(stamp_ns, log_time_ns, future.result)

    def _write(self, reading: ImageReading) -> "_Written":
        """Make and write one file; runs in a thread of the pool."""
        with span("image", channel=self._params["channel"]):
            image = self._output.make(reading)
            entry = self._out.write(f"{reading.stamp_ns}{image.extension}", image.data)
        return _Written(entry, image.extension, image.width, image.height)

    def _take(self, stamp_ns: int, log_time_ns: int, result: "Callable[[], _Written]") -> None:
        """Note one file that was written, or why it was not."""
        try:
            image = result()
        except DecodeError as err:
            self._stamps_us.discard(stamp_ns // 1000)
            self._fail(err)
            return
        except BagAssetsError:
            self._stop()
            raise
        entry = image.entry
        self._extension = image.extension
        self._rows.append(
            {
                "stamp_ns": stamp_ns,
                "log_time_ns": log_time_ns,
                "file": entry.path,
                "size": entry.size,
                "digest": entry.digest,
                "width": image.width,
                "height": image.height,
            }
        )
        self._counts.written += 1

    def _stop(self) -> None:
        while self._in_flight:
            self._in_flight.popleft()[2].cancel()

    def _fail(self, err: DecodeError, reason: str | None = None) -> None:
        self._failed += 1
        self._first_error = self._first_error or str(err)
        self._counts.lose(reason or str(err))

    def _check(self) -> None:
        where = f"{self._params['channel']}: topic {self._params['topic']}"
        if self._failed > self._params["lost_messages"] * self._counts.read:
            raise LossLimitError(
                f"{where} lost {self._failed} of {self._counts.read} messages; the first: {self._first_error}. "
                "If that is acceptable raise limits.lost_messages in the recipe, else remove the channel or mend "
                "the recording."
            )
        if not self._counts.balanced:
            raise LossLimitError(
                f"{where}: counts do not add up, {self._counts.as_json()}; this is a bug of the step, please report it."
            )


def _outlasts_the_call(data: bytes | memoryview) -> bool:
    """Tell whether what a reader handed out stays as it is; of a buffer that is used again, it does not."""
    return isinstance(data.obj if isinstance(data, memoryview) else data, bytes)
