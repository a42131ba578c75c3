"""The asset `frames`: the images of each camera as files, with an index.

Files of one camera: `<stamp_ns>.jpg` or `<stamp_ns>.png`, `index.parquet`, `channel.json`.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial

import cv2
import pyarrow as pa

from bagassets.assets.asset import Asset, Facts, Use, uses_of
from bagassets.assets.calibration import CALIBRATION
from bagassets.assets.channel import Counts, channel_face, require_decoder, settings_of
from bagassets.assets.channel_index import FILE_COLUMNS, file_row
from bagassets.assets.grey_survey import GreySurvey
from bagassets.assets.image_output import (
    CameraSettings,
    CameraUse,
    EncodedImage,
    ImageOutput,
    intrinsic_matrix,
    raw_pixels,
)
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.quality.channel_rules import channels_complete
from bagassets.assets.quality.check import RecordingCheck
from bagassets.base.columns import table_of_rows
from bagassets.base.errors import BagAssetsError, CalibrationError, DecodeError, LossLimitError
from bagassets.base.json_types import JsonObject
from bagassets.base.trace import span
from bagassets.decode.depth import DepthLosses
from bagassets.decode.loading import keyed_decoder
from bagassets.decode.model import ImageReading
from bagassets.decode.registry import AnyFamily
from bagassets.decode.video import Picture, VideoPacket, VideoStream, decoder_version
from bagassets.recipe.model import CameraChannel, Recipe, Rig
from bagassets.recordings.model import Message, RawMessage
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import ArtifactWriter, FileEntry

INDEX_SCHEMA = pa.schema(FILE_COLUMNS | {"width": pa.int32(), "height": pa.int32()})
"""Columns of `index.parquet` of a camera."""


@dataclass(frozen=True)
class FramesParams:
    """Parameters of `frames`: camera -> its settings."""

    channels: Mapping[str, CameraSettings]

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "FramesParams":
        """Return the parameters of a rig."""
        channels = {}
        for name, channel in sorted(rig.channels.items()):
            if isinstance(channel, CameraChannel):
                quality = None if channel.output == "png" else channel.quality
                own = {**dict(channel), "clock": recipe.clock_of(rig, channel), "quality": quality}
                channels[name] = settings_of(CameraSettings, {**dict(recipe.limits), **own})
        return cls(channels)


def use(params: FramesParams, facts: Facts) -> dict[str, Use[CameraUse] | Exception]:
    """Return what the images of each camera in a recording depend on."""
    present = {
        name: settings
        for name, settings in params.channels.items()
        if facts.inventory.has_readable(settings.topic)
    }
    return uses_of(present, partial(_use_of_camera, facts))


def _use_of_camera(facts: Facts, name: str, settings: CameraSettings) -> Use[CameraUse]:
    """Return what the images of one camera depend on: from upstream only its message type and its own lens.

    Raises:
        CalibrationError: undistortion is on but there are no intrinsics, or they are for a larger image than `limits` allow.
        DecodeError: its topic does not carry images, or it carries video, and what decodes it is not installed.
        PluginError: several decoder plug-ins claim the type of its messages.
    """
    topic = facts.inventory.topic(settings.topic)
    decoder = require_decoder(name, settings.topic, topic.msgtype, "image", "video")
    is_video = decoder.family == "video" or topic.video is not None
    camera = facts.calibration.channels[name].camera
    lens = None if camera is None else camera.lens
    use = CameraUse(
        channel=name,
        settings=settings,
        msgtype=topic.msgtype,
        decoder=decoder.key,
        camera=lens,
        camera_from="" if camera is None else camera.source,
        video=decoder_version(f"{name} ({settings.topic})") if is_video else None,
        period_ns=topic.period_ns if is_video else None,
        from_zero=topic.starts_at_zero and settings.clock == "header",
    )
    if lens is not None and lens.width * lens.height > settings.image_pixels:
        raise CalibrationError(
            f"{use}: its intrinsics are for an image of {lens.width} x {lens.height} pixels; correct them, or "
            "raise limits.image_pixels in the recipe."
        )
    if settings.undistort and lens is None:
        raise CalibrationError(
            f"{use}: there are no intrinsics to undistort with; name `camera_info`, give `intrinsics`, or set "
            "`undistort: false` in the recipe."
        )
    return Use(use, (settings.topic,))


# Images of one channel in the queue or in work: enough to keep threads busy, few enough to bound memory.
_MOST_IN_FLIGHT = 4
_LARGE_BYTES = 40_000_000  # of images this large, only one waits
Reading = ImageReading | VideoPacket
Written = tuple[FileEntry, EncodedImage]  # an image in the artifact, without its data


class FrameExtractor:
    """Turns the messages of one camera into the files of an artifact.

    Args:
        use: everything that shapes the files.
        recording: decodes the messages.
        out: writes the artifact.
        pool: threads that convert, encode and write; None to do so in the calling thread.
    """

    def __init__(
        self,
        use: CameraUse,
        recording: Recording,
        out: ArtifactWriter,
        pool: Executor | None = None,
    ) -> None:
        cv2.setNumThreads(1)  # parallel over images, not inside one
        self.topics: tuple[str, ...] = (use.settings.topic,)
        self._use = use
        self._by_log_time = use.settings.clock == "log"
        self._recording = recording
        self._video: VideoStream | None = None
        if use.video is not None:
            self._video = VideoStream(str(use), use.settings.image_pixels, use.period_ns)
        family: AnyFamily = "image" if self._video is None else "video"
        self._decoder: Callable[[Message], Reading] = keyed_decoder(family, use.msgtype, use.decoder)
        self._out = out
        self._counts = Counts()
        rule = use.settings.to_8bit
        self._percentiles = None if rule is None else rule.percentiles
        surveys = self._percentiles is not None and self._video is None  # the pictures of video have 8 bit
        self._survey = GreySurvey(out.scratch) if surveys else None
        self._output = ImageOutput(use, None if rule is None else rule.range)
        self._pool = pool
        self._in_flight: deque[tuple[int, int, Future[Written]]] = deque()
        self._rows: list[JsonObject] = []
        self._stamps_us: set[int] = set()
        self._frame_id = ""
        self._failed = 0
        self._first_error: str | None = None
        self._extension = ".jpg"
        self._depth: DepthLosses | None = None

    def add(self, message: RawMessage) -> None:
        """Take the next message; one that cannot be decoded is counted as lost."""
        if self._survey is None:
            self._convert(message)
            return
        pixels = None
        with suppress(DecodeError):  # counted as lost when its turn comes
            reading = self._decode(message)
            if isinstance(reading, ImageReading):
                pixels = raw_pixels(reading, self._use.settings.image_pixels)
        self._survey.add(message, pixels)

    def _convert(self, message: RawMessage) -> None:
        self._counts.read += 1
        try:
            reading = self._decode(message)
        except DecodeError as err:
            self._fail(err)
            return
        if isinstance(reading, ImageReading):
            self._take_reading(reading, message.log_time_ns, lasts=_outlasts_the_call(message.data))
        elif self._video is not None:
            self._take_pictures(self._video.add(reading, message.log_time_ns))

    def _take_pictures(self, pictures: Iterable[Picture]) -> None:
        for picture in pictures:
            packet = picture.packet
            if picture.pixels is not None:
                reading = ImageReading(packet.stamp_ns, packet.frame_id, picture.pixels, None, "bgr8")
                self._take_reading(reading, picture.log_time_ns, lasts=True)
            elif picture.is_damage:
                self._fail(DecodeError(picture.reason))
            else:
                self._counts.lose(picture.reason)

    def _take_reading(self, reading: ImageReading, log_time_ns: int, *, lasts: bool) -> None:
        """Have an image written; unless it `lasts`, it is valid during this call only."""
        if not (reading.stamp_ns or self._by_log_time or self._use.from_zero):
            self._fail(DecodeError("its header stamp is zero; set `clock: log` in the recipe"), "zero stamp")
            return
        stamp_us = reading.stamp_ns // 1000
        if stamp_us in self._stamps_us:
            self._counts.lose("duplicate stamp")
            return
        self._stamps_us.add(stamp_us)
        self._frame_id = self._frame_id or reading.frame_id
        if self._pool is None:
            self._take(reading.stamp_ns, log_time_ns, partial(self._write, reading))
            return
        if not lasts:
            pixels, encoded = reading.pixels, reading.encoded
            reading = replace(
                reading,
                pixels=None if pixels is None else pixels.copy(),
                encoded=None if encoded is None else bytes(encoded),
            )
        future = self._pool.submit(self._write, reading)
        self._in_flight.append((reading.stamp_ns, log_time_ns, future))
        held = len(reading.encoded or b"") if reading.pixels is None else reading.pixels.nbytes
        while len(self._in_flight) > (1 if held > _LARGE_BYTES else _MOST_IN_FLIGHT):
            self._collect()

    def finish(self) -> JsonObject:
        """Write pending images and the index; return the summary.

        Raises:
            LossLimitError: more was lost than the recipe allows, or the counts do not add up.
        """
        if self._survey is not None and self._percentiles is not None:
            self._output.grey_range = self._survey.range(*self._percentiles)
            for message in self._survey.messages():
                self._convert(message)
        if self._video is not None:
            self._take_pictures(self._video.finish())
        while self._in_flight:
            self._collect()
        where = f"{self._use.channel}: topic {self._use.settings.topic}"
        if self._failed > self._use.settings.lost_messages * self._counts.read:
            raise LossLimitError(
                f"{where} lost {self._failed} of {self._counts.read} messages; the first: {self._first_error}. "
                "If that is acceptable, raise limits.lost_messages in the recipe; else remove the channel or fix "
                "the recording."
            )
        if not self._counts.balanced:
            raise LossLimitError(
                f"{where}: counts do not add up, {self._counts.as_json()}; this is a bug of the step, please report it."
            )
        rows = sorted(self._rows, key=lambda row: row["stamp_ns"])
        self._out.write_table("index.parquet", table_of_rows(rows, INDEX_SCHEMA))
        facts: JsonObject = {"counts": self._counts.as_json()}
        if self._depth is not None:
            facts["depth"] = {"unit_m": self._use.settings.depth_unit_m, **asdict(self._depth)}
        self._out.write_json(
            "channel.json",
            {
                "channel": self._use.channel,
                "modality": "camera",
                "topic": self._use.settings.topic,
                "frame_id": self._frame_id,
                "fileformat": self._extension.removeprefix("."),
                "camera_intrinsic": intrinsic_matrix(self._output.written),
                **facts,
            },
        )
        return {**facts, "messages": self._counts.read, "bytes": sum(row["size"] for row in rows)}

    def _decode(self, message: RawMessage) -> Reading:
        reading = self._decoder(self._recording.decode(message))
        if self._by_log_time:
            return replace(reading, stamp_ns=message.log_time_ns)
        return reading

    def _collect(self) -> None:
        stamp_ns, log_time_ns, future = self._in_flight.popleft()
        self._take(stamp_ns, log_time_ns, future.result)

    def _write(self, reading: ImageReading) -> Written:
        """Make and write one file; runs in a thread of the pool."""
        with span("image", channel=self._use.channel):
            image = self._output.make(reading)
            entry = self._out.write(f"{reading.stamp_ns}{image.extension}", image.data)
        return entry, replace(image, data=b"")

    def _take(self, stamp_ns: int, log_time_ns: int, result: Callable[[], Written]) -> None:
        """Record one written file, or why it could not be written."""
        try:
            entry, image = result()
        except DecodeError as err:
            self._stamps_us.discard(stamp_ns // 1000)
            self._fail(err)
            return
        except BagAssetsError:
            while self._in_flight:
                self._in_flight.popleft()[2].cancel()
            raise
        self._extension = image.extension
        if image.depth is not None:
            self._depth = (self._depth or DepthLosses()) + image.depth
        row = file_row(entry, stamp_ns, log_time_ns)
        self._rows.append(row | {"width": image.width, "height": image.height})
        self._counts.written += 1

    def _fail(self, err: DecodeError, reason: str | None = None) -> None:
        self._failed += 1
        self._first_error = self._first_error or str(err)
        self._counts.lose(reason or str(err))


def _outlasts_the_call(data: bytes | memoryview) -> bool:
    """Return whether data from a reader stays valid; a view of a reused buffer does not."""
    return isinstance(data.obj if isinstance(data, memoryview) else data, bytes)


FRAMES = Asset(
    name="frames",
    version=6,
    changes={6: "undistorts to the same bytes on every processor"},
    # Of 6 are the maps of `undistortion_maps`.
    spared={6: lambda use: ImageOutput(use, None).undistort is None},
    libraries=("opencv-python-headless", "pyarrow"),
    title="The camera images: undistorted and encoded as the recipe says, indexed by stamp.",
    description="""One artifact per camera, so that a change to one leaves the others alone. Each image is extracted once, whether or not it
becomes a keyframe.""",
    kinds=frozenset({"image", "parquet"}),
    face=channel_face("images", INDEX_SCHEMA),
    reads=(INVENTORY, CALIBRATION),
    families=("image",),
    params=FramesParams.of,
    use=use,
    extract=lambda use, _, recording, out, pool: FrameExtractor(use.params, recording, out, pool),
    checks=(
        RecordingCheck(
            "frames_complete",
            "channels_present",
            "Every message read was written, merged or counted as lost, and every camera has images.",
            "counts do not add up; a channel has no files; more than `limits.reported_losses` (5 %) of its messages were "
            "lost, for whatever reason; the message names a remedy (section `channels_present`, whose `max_lost` takes "
            "precedence)",
            lambda e: channels_complete(e.channels("frames"), e.max_lost, e.clock_of),
            quick=True,
        ),
    ),
)
