"""The step `frames`: one camera channel of a recording becomes image files and an index.

Files: `<stamp_ns>.jpg` or `<stamp_ns>.png`, `index.parquet`, `channel.json`.
"""

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pyarrow as pa

from bagassets.bags.inventory import Inventory
from bagassets.bags.model import RawMessage, Recording
from bagassets.decode.compressed_image import decode_compressed_image
from bagassets.decode.image import decode_image
from bagassets.decode.model import ImageReading
from bagassets.decode.registry import decoder_params, plugin_decoder
from bagassets.errors import BagAssetsError, DecodeError, LossLimitError
from bagassets.plugins import installed_decoders
from bagassets.recipe.model import CameraChannel, Limits
from bagassets.recipe.model_base import Clock
from bagassets.steps.channel import Counts, Request
from bagassets.steps.image_output import (
    EncodedImage,
    ImageOutput,
    intrinsic_matrix,
    raw_pixels,
    require_calibration,
)
from bagassets.store.action import Step
from bagassets.store.artifact import ArtifactWriter

__all__ = ["STEP", "FrameExtractor", "request"]

STEP = Step("frames", 2, ("opencv-python-headless", "pyarrow"))

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
        limits: accepted losses.
        inventory: what is in the recording.
        camera: intrinsics of the channel in `calibration.json`, or None.

    Raises:
        CalibrationError: the channel is to be undistorted and has no intrinsics.
        DecodeError: the topic does not carry images.
        PluginError: several decoder plug-ins claim its type.
    """
    topic = inventory.topic(channel.topic)
    plugin = decoder_params("image", topic.msgtype)
    if topic.msgtype not in _DECODERS and not plugin:
        raise DecodeError(
            f"{name}: {channel.topic} carries {topic.msgtype}, a camera needs Image or CompressedImage; "
            f"{installed_decoders().advice('image', topic.msgtype)}"
        )
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
        "camera": lens,
        **plugin,
    }
    require_calibration(params)
    return Request(params, (channel.topic,))


class FrameExtractor:
    """Turns the messages of one camera into the files of an artifact.

    Args:
        params: as made by `request`.
        recording: decodes the messages.
        out: the artifact.
        workers: threads that convert and encode; at most twice as many images are in memory.
    """

    def __init__(
        self, params: Mapping[str, Any], recording: Recording, out: ArtifactWriter, workers: int = 1
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
        self._output = ImageOutput(self._params, self._grey_range())
        self._pool = ThreadPoolExecutor(max(1, workers), "encode") if workers > 1 else None
        self._in_flight: deque[tuple[int, int, Future[EncodedImage]]] = deque()
        self._limit = 2 * workers
        self._rows: list[dict[str, Any]] = []
        self._stamps_us: set[int] = set()
        self._frame_id = ""
        self._failed = 0
        self._first_error: str | None = None
        self._extension = ".jpg"

    def add(self, message: RawMessage) -> None:
        """Take the next message; one that cannot be decoded is counted as lost."""
        self._counts.read += 1
        try:
            reading = self._decode(message)
        except DecodeError as err:
            self._fail(err)
            return
        stamp_us = reading.stamp_ns // 1000
        if stamp_us in self._stamps_us:
            self._counts.lose("duplicate stamp")
            return
        self._stamps_us.add(stamp_us)
        self._frame_id = self._frame_id or reading.frame_id
        if self._pool is None:
            self._take(reading.stamp_ns, message.log_time_ns, reading)
            return
        if reading.pixels is not None:  # a view of the message, which is valid during this call only
            reading = replace(reading, pixels=reading.pixels.copy())
        future = self._pool.submit(self._output.make, reading)
        self._in_flight.append((reading.stamp_ns, message.log_time_ns, future))
        while len(self._in_flight) > self._limit:
            self._collect()

    def finish(self) -> dict[str, Any]:
        """Write what is left and the index; return the summary.

        Raises:
            LossLimitError: more was lost than the recipe allows, or the counts do not add up.
        """
        while self._in_flight:
            self._collect()
        if self._pool is not None:
            self._pool.shutdown()
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
        if not reading.stamp_ns and self._counts.read > 1:
            raise DecodeError("its header stamp is zero; set `clock: log` in the recipe")
        return reading

    def _collect(self) -> None:
        stamp_ns, log_time_ns, future = self._in_flight.popleft()
        self._take(stamp_ns, log_time_ns, future)

    def _take(self, stamp_ns: int, log_time_ns: int, work: "ImageReading | Future[EncodedImage]") -> None:
        try:
            image = work.result() if isinstance(work, Future) else self._output.make(work)
        except DecodeError as err:
            self._stamps_us.discard(stamp_ns // 1000)
            self._fail(err)
            return
        except BagAssetsError:
            self._stop()
            raise
        entry = self._out.write(f"{stamp_ns}{image.extension}", image.data)
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
        self._in_flight.clear()
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def _fail(self, err: DecodeError) -> None:
        self._failed += 1
        self._first_error = self._first_error or str(err)
        self._counts.lose(str(err))

    def _grey_range(self) -> tuple[float, float] | None:
        """Return the grey values that become 0 and 255: fixed, or percentiles over the recording."""
        rule = self._params["to_8bit"]
        if rule is None:
            return None
        if rule["range"] is not None:
            return rule["range"][0], rule["range"][1]
        histogram = np.zeros(65536, np.int64)
        for message in self._recording.messages(self.topics):
            try:
                pixels = raw_pixels(self._decoder(self._recording.decode(message)))
            except DecodeError:
                continue  # counted when the message comes in the pass itself
            histogram += np.bincount(pixels.ravel(), minlength=65536)
        share = np.cumsum(histogram) / max(1, int(histogram.sum()))
        low, high = (int(np.searchsorted(share, p / 100.0)) for p in rule["percentiles"])
        return float(low), float(max(high, low + 1))

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
