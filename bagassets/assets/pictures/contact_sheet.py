"""A contact sheet: all cameras over time."""

from collections.abc import Mapping, Sequence

from bagassets.assets.pictures.canvas import BACKGROUND, DIM, Image, blank, scaled_to, text

__all__ = ["contact_sheet"]

GAP_PX = 4
HEADER_PX = 22


def contact_sheet(tiles: Mapping[str, Sequence[Image | None]], seconds: Sequence[float], width: int) -> Image:
    """Return a picture with cameras as rows and moments as columns.

    Args:
        tiles: camera -> its image at each moment, None where it has none.
        seconds: time of each moment since the start of the recording.
        width: of the picture in pixels.
    """
    columns = len(seconds)
    tile_width = (width - GAP_PX * (columns + 1)) // columns
    rows = {
        name: [None if image is None else scaled_to(image, tile_width) for image in images]
        for name, images in tiles.items()
    }
    heights = {
        name: max((t.shape[0] for t in row if t is not None), default=24) for name, row in rows.items()
    }
    sheet = blank(width, HEADER_PX + sum(height + GAP_PX for height in heights.values()) + GAP_PX)
    for column, second in enumerate(seconds):
        text(sheet, f"{second:.1f} s", _left(column, tile_width) + 2, 15, size_px=11, colour=DIM)
    top = HEADER_PX
    for name, row in rows.items():
        for column, tile in enumerate(row):
            left = _left(column, tile_width)
            if tile is None:
                text(sheet, "no image", left + 6, top + 16, size_px=10, colour=DIM)
                continue
            sheet[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
        text(sheet, name, GAP_PX + 5, top + 15, size_px=11, halo=True)
        top += heights[name] + GAP_PX
    sheet[:, width - 1] = BACKGROUND
    return sheet


def _left(column: int, tile_width: int) -> int:
    return GAP_PX + column * (tile_width + GAP_PX)
