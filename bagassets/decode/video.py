"""Video in messages: H.264, H.265, AV1 and VP9.

They are `foxglove.CompressedVideo`, `ffmpeg_image_transport_msgs/FFMPEGPacket`, and `sensor_msgs/CompressedImage` whose `format`
names a codec.

A message is one picture of a stream, by itself undecodable unless it is a key frame. So a stream is decoded once, in order,
and each picture stands at the time of its own message. Where packets are missing, what follows refers to what is not there,
and would show other pictures without an error: up to the next key frame it is lost.

PyAV, which decodes, is imported for the first packet.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError, RecordingError
from bagassets.decode.fields import byte_array, head
from bagassets.decode.registry import own_types
from bagassets.decode.video_units import Codec, UnitReader, Units
from bagassets.recordings.model import Message

if TYPE_CHECKING:
    from av.video.codeccontext import VideoCodecContext
    from av.video.frame import VideoFrame

# Names of formats, and of the encoders that FFMPEGPacket names; in newer ones a semicolon and pixel formats follow.
_CODECS: dict[str, Codec] = {
    "h264": "h264", "libx264": "h264", "libx264rgb": "h264", "x264": "h264", "avc": "h264",
    "h265": "hevc", "hevc": "hevc", "libx265": "hevc", "x265": "hevc",
    "av1": "av1", "libsvtav1": "av1", "libaom-av1": "av1", "librav1e": "av1", "vp9": "vp9", "libvpx-vp9": "vp9",
}  # fmt: skip
_IMAGES_OR_VIDEO = frozenset(own_types("image")) & frozenset(own_types("video"))
_DECODERS = {"av1": "libdav1d"}  # the one that is called av1 needs a graphics card
# A longer pause between two packets means that some are missing, in periods of the stream, where nothing else tells.
MOST_PERIODS = 1.5
BEFORE_KEY = "its stream begins without a key frame, which it refers to"
AFTER_GAP = "packets before it are missing, and so is the picture that it refers to"
AFTER_ERROR = "a packet before it cannot be decoded, and so the picture that it refers to"
REFUSED = "the packet cannot be decoded"
NO_PICTURE = "there is no picture in it"


@dataclass(frozen=True, slots=True, eq=False)
class VideoPacket:
    """One message of a stream.

    Attributes:
        stamp_ns: its stamp.
        frame_id: sensor frame, without leading slash.
        codec: of the stream.
        data: of one picture; of H.264 and H.265 in the byte stream format (Annex B), of AV1 in the low-overhead format.
    """

    stamp_ns: int
    frame_id: str
    codec: Codec
    data: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What became of a packet.

    Attributes:
        packet: the packet.
        log_time_ns: of its message.
        pixels: (H, W, 3) BGR; None if it is lost.
        reason: why it is lost.
        is_damage: it could not be decoded itself.
    """

    packet: VideoPacket
    log_time_ns: int
    pixels: NDArray[np.uint8] | None = None
    reason: str = ""
    is_damage: bool = False


def codec_of(message: Message) -> Codec | None:
    """Return the codec that a message names as its format or encoding; None if that is none which is read."""
    plain = _format(message).partition(";")[0].strip().lower()
    return _CODECS.get(plain) or _CODECS.get(plain.partition("_")[0])  # h264_nvenc, hevc_vaapi


def codec_in_image(message: Message, msgtype: str) -> Codec | None:
    """Return the codec of the video that a message of a type for images holds; None if it holds an image."""
    return codec_of(message) if msgtype in _IMAGES_OR_VIDEO else None


def _format(message: Message) -> str:
    return str(getattr(message, "format", "") or getattr(message, "encoding", ""))


def decode_video_packet(message: Message) -> VideoPacket:
    """Return the packet in a message of video.

    Raises:
        DecodeError: it is of another codec.
    """
    stamp_ns, frame_id = head(message)
    codec = codec_of(message)
    if codec is None:
        name = _format(message)
        raise DecodeError(f"video format '{name}' is not supported (H.264, H.265, AV1 and VP9 are)")
    return VideoPacket(stamp_ns, frame_id, codec, byte_array(message.data).tobytes())


def decoder_version(where: str) -> str:
    """Return what decodes and encodes video, for the keys of actions; wheels of PyAV bring their own ffmpeg.

    Args:
        where: what has video, or will have, for the error.

    Raises:
        DecodeError: it is not installed.
    """
    try:
        return f"av {version('av')}"
    except PackageNotFoundError:
        raise DecodeError(
            f"{where}: video needs PyAV, which is not installed here; install it with `pip install 'bagassets[video]'`, in every "
            "environment that builds."
        ) from None


class VideoStream:
    """Decodes the packets of one topic.

    Args:
        where: the topic, for errors.
        most_pixels: of a picture; those of a stream with larger ones cannot be decoded.
        period_ns: time between two packets; None to go by the decoder's errors alone.
    """

    def __init__(self, where: str, most_pixels: int, period_ns: int | None) -> None:
        self._where = where
        self._most_pixels = most_pixels
        self._period_ns = period_ns
        self._context: VideoCodecContext | None = None
        self._codec = ""
        self._waiting: dict[int, tuple[VideoPacket, int]] = {}
        self._number = 0
        self._parameters = b""
        self._broken = BEFORE_KEY
        self._last_ns = 0
        self._units = UnitReader()
        self._reference: int | None = None

    def add(self, packet: VideoPacket, log_time_ns: int) -> Iterator[Picture]:
        """Take the next packet in order of log time; yield what is known by now, of it and of those before it.

        Raises:
            RecordingError: the stream has pictures that refer to later ones.
        """
        try:
            units = self._units.read(packet.codec, packet.data)
        except DecodeError as err:
            yield from self.finish()
            yield Picture(packet, log_time_ns, reason=str(err), is_damage=True)
            return
        # In H.265, encoders without delay may use such slices to refer to earlier pictures, and say so.
        if units.has_b_slices and (
            packet.codec == "h264" or (self._context is not None and self._context.has_b_frames)
        ):
            raise RecordingError(
                f"{self._where}: its video has B-frames, which refer to later pictures, so that messages are out of order; record it "
                "without (such as `bf=0`), or leave the channel out."
            )
        if self._is_missing_before(packet, units) and not (units.is_key or self._broken):
            yield from self.finish()
        if not units.has_picture:
            self._parameters += packet.data
            yield Picture(packet, log_time_ns, reason=NO_PICTURE)
            return
        if units.is_reference or units.is_key:
            self._reference = units.frame_number
        if units.is_key and self._broken:
            self._begin(packet.codec)
        if self._broken or packet.codec != self._codec:
            self._broken = self._broken or AFTER_GAP
            yield Picture(packet, log_time_ns, reason=self._broken)
            return
        number, self._number = self._number, self._number + 1
        self._waiting[number] = packet, log_time_ns
        data, self._parameters = self._parameters + packet.data, b""
        yield from self._decoded(data, number)

    def _is_missing_before(self, packet: VideoPacket, units: Units) -> bool:
        """Tell whether a picture is missing that this one may refer to.

        The frame numbers of H.264 (7.4.3) tell it of references, unless so many are missing that the numbers have begun again;
        else the stamps do. A camera that slows down loses nothing where there are numbers.
        """
        gap_ns = packet.stamp_ns - self._last_ns if self._last_ns and packet.stamp_ns else 0
        self._last_ns = packet.stamp_ns
        number, reference, period_ns = units.frame_number, self._reference, self._period_ns
        if number is None or reference is None:
            return period_ns is not None and gap_ns > MOST_PERIODS * period_ns
        if (number - reference) % self._units.frame_numbers > 1:
            return True
        return period_ns is not None and gap_ns > (self._units.frame_numbers - MOST_PERIODS) * period_ns

    def _begin(self, codec: Codec) -> None:
        """Begin with a key frame; parameters that were sent once hold on."""
        import av  # noqa: PLC0415  (70 ms, and not installed everywhere)

        if self._context is None or self._codec != codec:
            decoder = av.CodecContext.create(_DECODERS.get(codec, codec), "r")
            self._context = cast("VideoCodecContext", decoder)
            self._context.thread_count = 1  # others hold pictures back
            # Pictures that the decoder would make up are errors, and those of which an encoder sent another digest.
            self._context.options = {"max_pixels": str(self._most_pixels), "err_detect": "explode+crccheck"}
        else:
            self._context.flush_buffers()
        self._codec, self._broken = codec, ""

    def finish(self) -> Iterator[Picture]:
        """Yield the pictures in the decoder, which then waits for a key frame."""
        if not self._broken:
            yield from self._decoded(None, -1)
        self._broken = self._broken or AFTER_GAP
        yield from self._given_up(list(self._waiting), NO_PICTURE)

    def _decoded(self, data: bytes | None, number: int) -> Iterator[Picture]:
        import av  # noqa: PLC0415

        if self._context is None:
            return
        unit = None
        if data is not None:
            unit = av.Packet(data)
            unit.pts, unit.time_base = number, Fraction(1, 1)
        try:
            frames = self._context.decode(unit)
        except av.FFmpegError:
            frames, self._broken = [], AFTER_ERROR
        for frame in frames:
            number = int(frame.pts or 0)
            if number not in self._waiting:
                continue  # given up
            packet, log_time_ns = self._waiting.pop(number)
            # Without B-frames pictures come in order: of packets before this one, there will be none.
            yield from self._given_up([one for one in self._waiting if one < number], REFUSED)
            if frame.is_corrupt:
                self._broken = AFTER_ERROR
            if not self._broken:
                yield Picture(packet, log_time_ns, _bgr(frame))
            else:
                yield Picture(packet, log_time_ns, reason=self._broken)
        if self._broken:
            yield from self._given_up(list(self._waiting), REFUSED)

    def _given_up(self, numbers: Iterable[int], reason: str) -> Iterator[Picture]:
        for number in numbers:
            packet, log_time_ns = self._waiting.pop(number)
            yield Picture(packet, log_time_ns, reason=reason, is_damage=True)


def _bgr(frame: "VideoFrame") -> NDArray[np.uint8]:
    """Return (H, W, 3) BGR by the matrix and range that are tagged; without tags those of BT.601, limited, as encoders assume.

    The flags have swscale give the same bytes on every processor.
    """
    from av.video.reformatter import ColorRange, Colorspace, Interpolation  # noqa: PLC0415

    matrices = {
        1: Colorspace.ITU709, 4: Colorspace.FCC, 7: Colorspace.SMPTE240M, 9: Colorspace.BT2020, 10: Colorspace.BT2020,
    }  # fmt: skip
    flags = (
        Interpolation.BILINEAR
        | Interpolation.ACCURATE_RND
        | Interpolation.BITEXACT
        | Interpolation.FULL_CHR_H_INT
    )
    converted = frame.reformat(
        format="bgr24",
        src_colorspace=matrices.get(int(frame.colorspace), Colorspace.ITU601),
        src_color_range=ColorRange.JPEG if int(frame.color_range) == 2 else ColorRange.MPEG,
        dst_color_range=ColorRange.JPEG,
        interpolation=flags,
        threads=1,
    )
    return np.asarray(converted.to_ndarray(), np.uint8)
