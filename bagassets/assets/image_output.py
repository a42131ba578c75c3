"""From a recorded image to the bytes of its file: convert, undistort, encode.

This is the hot path. It runs in worker threads; OpenCV releases the interpreter lock.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Condition
from typing import Literal, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.assets.asset import for_messages, inlined, omitted
from bagassets.base.errors import DecodeError, RecipeError
from bagassets.base.quantities import utc_text
from bagassets.decode.compressed_image import checked_size, decode_pixels
from bagassets.decode.depth import DepthLosses, in_steps
from bagassets.decode.image import bayer_to_bgra, check_pixels, to_bgr_or_grey
from bagassets.decode.model import ImageReading
from bagassets.geometry.calibration import CameraLens
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.undistortion import Pixels, Undistortion
from bagassets.recipe.model import DEPTH_UNIT_M, GreyRange, Limits
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_calibration import PinholeIntrinsics


@dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """Settings of one camera in the recipe.

    Attributes:
        topic: topic of its images.
        clock: which time of a message is its stamp.
        output: format of the files.
        quality: JPEG quality; None if only PNG is written.
        undistort: True if lens distortion is removed.
        target: the pinhole matrix of undistorted images; None for the camera's own.
        to_8bit: how 16-bit grey becomes 8 bit; None to keep 16 bit.
        lost_messages: share of the messages that may be lost.
        image_pixels: size of the largest image that is read.
        depth_unit_m: depth that a grey level of the files stands for, if it was recorded in metres.
    """

    topic: str
    clock: Clock
    output: Literal["jpeg", "png", "as_recorded"]
    quality: int | None = omitted()
    undistort: bool
    target: PinholeIntrinsics | None
    to_8bit: GreyRange | None
    lost_messages: float
    image_pixels: int = omitted(Limits().image_pixels)
    depth_unit_m: float = omitted(DEPTH_UNIT_M)


@dataclass(frozen=True, kw_only=True)
class CameraUse:
    """Everything besides its messages that shapes the files of one camera.

    Attributes:
        channel: canonical name.
        settings: its settings in the recipe.
        msgtype: type of the messages, `pkg/msg/Type`.
        decoder: the plug-in that decodes them; None for a built-in decoder.
        camera: the calibrated lens; None for a camera without intrinsics.
        camera_from: what the lens is from, as `CalibratedCamera.source`.
        video: what decodes video; None for images.
        period_ns: median time between two packets of video.
        from_zero: a stamp of zero is one.
    """

    channel: str
    settings: CameraSettings = inlined()
    msgtype: str
    decoder: Mapping[str, str] | None = omitted()
    camera: CameraLens | None
    camera_from: str = for_messages("")
    video: str | None = omitted()
    period_ns: int | None = omitted()
    from_zero: bool = omitted(False)

    def __str__(self) -> str:
        return f"{self.channel} ({self.settings.topic})"


@dataclass(frozen=True, slots=True)
class EncodedImage:
    """A finished image file, and, of depth in metres, how many of its pixels have none."""

    data: bytes | memoryview
    extension: str
    width: int
    height: int
    depth: DepthLosses | None = None


def raw_pixels(reading: ImageReading, most_pixels: int) -> Pixels:
    """Return the pixels of a reading, (H, W) grey or (H, W, 3) BGR.

    Raises:
        DecodeError: compressed bytes do not decode, or there are more than `most_pixels`.
    """
    _size_of(reading, most_pixels)
    try:
        return _converted(reading)[0]
    except cv2.error as err:
        raise _refused(err) from err


def _size_of(reading: ImageReading, most_pixels: int) -> tuple[int, int]:
    """Return width and height of an image that is complete and within the limit."""
    if reading.encoded is not None:
        width, height = checked_size(reading.encoded, reading.encoding)
    elif reading.pixels is not None:
        height, width = reading.pixels.shape[:2]
    else:
        raise DecodeError("the image has neither pixels nor compressed bytes")
    check_pixels(width, height, most_pixels)
    return width, height


def _converted(
    reading: ImageReading, depth_unit_m: float = DEPTH_UNIT_M
) -> tuple[Pixels, DepthLosses | None]:
    """Return the pixels of a reading; of depth in metres, its levels, and how many of them are missing."""
    pixels = reading.pixels
    if pixels is None:
        pixels = decode_pixels(reading.encoded or b"", reading.encoding)
        if pixels.dtype != np.float32:
            return cast("Pixels", pixels), None
    if pixels.dtype == np.float32:
        return in_steps(cast("NDArray[np.float32]", pixels), depth_unit_m)
    return to_bgr_or_grey(cast("Pixels", pixels), reading.encoding), None


def _refused(err: cv2.error) -> Exception:
    """Return the error to raise when OpenCV fails to convert an image."""
    if err.code == cv2.Error.StsNoMem:
        return err
    return DecodeError("OpenCV refuses to convert an image of its size and encoding")


# Images up to this size are never held back.
_SMALL_PIXELS = 12_000_000


class _Room:
    """Keeps threads from working on so many large images at a time that memory runs out."""

    def __init__(self) -> None:
        self._taken = 0
        self._changed = Condition()

    @contextmanager
    def room_for(self, pixels: int, most_pixels: int) -> Iterator[None]:
        """Wait until an image fits beside the large images in work, or is the only one.

        Args:
            pixels: pixels of the image.
            most_pixels: limit for the pixels of all large images in work.
        """
        if pixels <= _SMALL_PIXELS:
            yield
            return
        with self._changed:
            self._changed.wait_for(lambda: not self._taken or self._taken + pixels <= most_pixels)
            self._taken += pixels
        try:
            yield
        finally:
            with self._changed:
                self._taken -= pixels
                self._changed.notify_all()


_LARGE_IMAGES = _Room()


class ImageOutput:
    """Makes the image files of one channel.

    Args:
        use: everything that shapes them.
        grey_range: values that become 0 and 255 when 16-bit grey is converted to 8 bit, or None.

    Attributes:
        grey_range: as above; may be set later, before the first image.
        undistort: looks images up through maps; None if nothing would change.
    """

    def __init__(self, use: CameraUse, grey_range: tuple[float, float] | None) -> None:
        settings = use.settings
        self._name = str(use)
        self._camera_from = use.camera_from
        self._format = settings.output
        self._jpeg_options = [] if settings.quality is None else [cv2.IMWRITE_JPEG_QUALITY, settings.quality]
        self._most_pixels = settings.image_pixels
        self._depth_unit_m = settings.depth_unit_m
        self.grey_range = grey_range
        self._recorded = None if use.camera is None else CameraModel.from_calibration(use.camera)
        self.written = self._recorded
        self.undistort: Undistortion | None = None
        if self._recorded is not None and settings.undistort:
            target = settings.target
            pinhole = None if target is None else (target.fx, target.fy, target.cx, target.cy)
            self.written = self._recorded.undistorted(pinhole)
            if self._recorded.distorts or target is not None:
                self.undistort = Undistortion(self._recorded, self.written)

    def make(self, reading: ImageReading) -> EncodedImage:
        """Return the file of one image.

        Raises:
            DecodeError: the image does not decode, or is larger than `limits` allow.
            CalibrationError: its size differs from that of the calibration.
            RecipeError: a JPEG is wanted of 16-bit grey, and `to_8bit` is not set.
        """
        width, height = _size_of(reading, self._most_pixels)
        if self._recorded is not None:
            image = f"{self._name}: the image at {utc_text(reading.stamp_ns)}"
            self._recorded.check_size(width, height, image, self._camera_from)
        # Unchanged without undistortion, if any viewer shows it correctly.
        passes = self._format == "as_recorded" and self.undistort is None and ":" not in reading.encoding
        if passes and reading.encoded is not None:
            extension = ".png" if reading.encoding.startswith("png") else ".jpg"
            return EncodedImage(reading.encoded, extension, width, height)
        try:
            with _LARGE_IMAGES.room_for(width * height, self._most_pixels):
                return self._encoded(reading)
        except cv2.error as err:
            raise _refused(err) from err

    def _encoded(self, reading: ImageReading) -> EncodedImage:
        jpeg = self._format == "jpeg" or (
            self._format == "as_recorded" and reading.encoding.startswith("jpeg")
        )
        # A Bayer mosaic as BGRA, which can be undistorted faster, into BGR.
        mosaic = None if self.undistort is None else reading.pixels
        bgra = None if mosaic is None else bayer_to_bgra(cast("Pixels", mosaic), reading.encoding)
        pixels, depth = _converted(reading, self._depth_unit_m) if bgra is None else (bgra, None)
        if pixels.dtype == np.uint16:
            pixels = self._to_8bit(pixels)
        if self.undistort is not None:
            pixels = self.undistort(pixels)
        if jpeg:
            done, data = cv2.imencode(".jpg", pixels, self._jpeg_options)
        else:
            done, data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 3])
        if not done:
            raise DecodeError("the image cannot be encoded")
        return EncodedImage(data.data, ".jpg" if jpeg else ".png", pixels.shape[1], pixels.shape[0], depth)

    def _to_8bit(self, pixels: Pixels) -> Pixels:
        if self.grey_range is None:
            if self._format == "jpeg":
                raise RecipeError(
                    f"{self._name}: 16-bit images become JPEG only by a rule; give the channel `to_8bit` with a "
                    "range or percentiles, or set `output: png` to keep 16 bit."
                )
            return pixels
        low, high = self.grey_range
        table = np.clip((np.arange(65536) - low) * (255.0 / (high - low)), 0, 255).round().astype(np.uint8)
        scaled: Pixels = table[pixels]
        return scaled


def intrinsic_matrix(camera: CameraModel | None) -> list[list[float]]:
    """Return `camera_intrinsic` as nuScenes has it; empty for a camera without calibration."""
    return [] if camera is None else [[float(v) for v in row] for row in camera.matrix]
