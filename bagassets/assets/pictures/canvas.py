"""Drawing for all pictures: colours, text, scaling, and JPEGs below a given size."""

from bisect import bisect_left
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DatasetError
from bagassets.geometry.se3 import Floats

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

# Blue, green, red, as OpenCV has them.
BACKGROUND: Colour = (28, 24, 22)
FAINT: Colour = (62, 56, 52)
DIM: Colour = (150, 142, 136)
TEXT: Colour = (236, 232, 230)
ACCENT: Colour = (90, 210, 120)
WARNING: Colour = (70, 80, 235)

_PALETTE: tuple[Colour, ...] = (
    (60, 160, 255), (255, 190, 70), (120, 230, 130), (230, 130, 230), (90, 220, 245), (200, 200, 90),
    (140, 140, 255), (170, 255, 220),
)  # fmt: skip
_TURBO: NDArray[np.uint8] = (
    cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_TURBO).reshape(256, 3).astype(np.uint8)
)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_FONT_HEIGHT_PX = 22.0  # of a capital at scale 1
_REDUCED = ((8, cv2.IMREAD_REDUCED_COLOR_8), (4, cv2.IMREAD_REDUCED_COLOR_4), (2, cv2.IMREAD_REDUCED_COLOR_2))
_NEAREST_GREY = 40  # of depth, that black may be none
_QUALITIES = (85, 75, 65, 55, 45, 35, 25, 15)


def blank(width: int, height: int) -> Image:
    """Return an empty (height, width, 3) picture."""
    row = np.full((width, 3), BACKGROUND, dtype=np.uint8)
    # By whole rows, several times faster than by pixels.
    return np.broadcast_to(row, (height, width, 3)).copy()


def pixels_in(path: Path, flags: int) -> NDArray[np.generic] | None:
    """Return an image file as OpenCV decodes it with some flags, never turned as its EXIF may say; None if there is none.

    A disk that fails is an OSError.
    """
    content = np.frombuffer(path.read_bytes() if path.exists() else b"", np.uint8)
    return cv2.imdecode(content, flags | cv2.IMREAD_IGNORE_ORIENTATION) if len(content) else None


def read_image(path: Path) -> NDArray[Any]:
    """Return an image file as (H, W, 3) BGR, of 8 or 16 bits; of grey ones all three are equal.

    Raises:
        DatasetError: it cannot be read.
    """
    image = pixels_in(path, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if image is None:
        raise DatasetError(f"{path}: this image cannot be read; build again to replace it.")
    return np.asarray(image)


def within(low: int, high: int, image: NDArray[Any]) -> Image:
    """Return an image of 16 bits with 8: the level `low` is dark grey, `high` white; 0, no depth, is black."""
    shares = np.clip((np.arange(1 << 16) - low) / max(high - low, 1), 0.0, 1.0)
    shown = np.rint(_NEAREST_GREY + (255 - _NEAREST_GREY) * shares).astype(np.uint8)
    shown[0] = 0
    return np.asarray(shown[image])


def read_reduced(path: Path, width: int, least_width: int) -> NDArray[Any]:
    """Return an image file as `read_image` does; a JPEG of at least twice `least_width` at half, a quarter or an eighth of its size.

    That is several times faster.

    Args:
        path: the file.
        width: in its header, in pixels.
        least_width: in pixels.

    Raises:
        DatasetError: it cannot be read.
    """
    flag = next((flag for factor, flag in _REDUCED if width // factor >= least_width), None)
    small = pixels_in(path, flag) if flag is not None and path.suffix == ".jpg" else None
    return read_image(path) if small is None else np.asarray(small)


def scaled_to(image: Image, width: int) -> Image:
    """Return a picture scaled to a width, its sides in proportion.

    It is first averaged over squares of whole pixels, for which those at the right and lower edge are repeated, and then
    interpolated. Averages over parts of pixels, as of `cv2.INTER_AREA`, are rounded differently on arm64.
    """
    height, factor = max(1, round(image.shape[0] * width / image.shape[1])), image.shape[1] // width
    if factor > 1:
        below, beside = (-size % factor for size in image.shape[:2])
        whole = cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE)
        size = whole.shape[1] // factor, whole.shape[0] // factor
        image = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA))
    if (image.shape[1], image.shape[0]) == (width, height):
        return image
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR))


def text(
    image: Image,
    words: str,
    x: float,
    y: float,
    *,
    size_px: float = 13,
    colour: Colour = TEXT,
    halo: bool = False,
) -> None:
    """Write text whose baseline starts at (x, y); a dark halo makes it legible on any image.

    Letters outside ASCII, which the font does not have, become question marks.
    """
    plain = words.encode("ascii", "replace").decode()
    scale, at = size_px / _FONT_HEIGHT_PX, (round(x), round(y))
    if halo:
        cv2.putText(image, plain, at, _FONT, scale, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(image, plain, at, _FONT, scale, colour, 1, cv2.LINE_AA)


def text_width(words: str, size_px: float = 13) -> int:
    """Return the width of a text in pixels."""
    (width, _), _ = cv2.getTextSize(words, _FONT, size_px / _FONT_HEIGHT_PX, 1)
    return int(width)


def turbo(shares: Floats) -> NDArray[np.uint8]:
    """Return (N, 3) colours of (N,) numbers between 0 (blue) and 1 (red)."""
    return _TURBO[np.clip(np.asarray(shares) * 255.0, 0, 255).astype(np.uint8)]


def colour_of(number: int) -> Colour:
    """Return one of a few distinct colours."""
    return _PALETTE[number % len(_PALETTE)]


def jpeg(image: Image, quality: int = 88) -> bytes:
    """Return a picture as JPEG."""
    encoded, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not encoded:
        raise DatasetError(
            f"a picture of {image.shape} pixels cannot be encoded as JPEG; please report this."
        )
    return data.tobytes()


def jpeg_within(image: Image, most_bytes: int, width: int) -> bytes:
    """Return a picture as JPEG of at most `most_bytes`: first with less quality, then smaller.

    Args:
        image: the picture.
        most_bytes: limit, at least 1000.
        width: width to begin with, if the picture is wider.
    """
    width = min(width, image.shape[1])
    while True:
        data = _best_within(scaled_to(image, width), most_bytes)
        if data is not None:
            return data
        width = max(16, width * 3 // 4)


def _best_within(image: Image, most_bytes: int) -> bytes | None:
    """Return a picture as JPEG of the best quality that fits, None if none does; less quality takes no more bytes."""
    encoded = cache(partial(jpeg, image))
    best = bisect_left(_QUALITIES, True, key=lambda quality: len(encoded(quality)) <= most_bytes)
    return encoded(_QUALITIES[best]) if best < len(_QUALITIES) else None
