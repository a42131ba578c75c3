"""Images that show a number, which survives any codec: with numpy alone, for other environments, too."""

import numpy as np

BLOCKS, BLOCK = (4, 4), 16


def painted(number, size=(64, 64)):
    """Return an image, (H, W, 3), that shows a number below 65,536 as black and white blocks, over a slow gradient."""
    height, width = size
    image = np.zeros((height, width, 3), np.uint8)
    image[:, :, 0] = np.linspace(30, 90, width).astype(np.uint8)
    for bit in range(BLOCKS[0] * BLOCKS[1]):
        row, column = divmod(bit, BLOCKS[1])
        if number >> bit & 1:
            image[row * BLOCK : (row + 1) * BLOCK, column * BLOCK : (column + 1) * BLOCK] = 235
    return image


def number_in(image):
    """Return the number that an image, (H, W, 3) of 0..255, shows."""
    number = 0
    for bit in range(BLOCKS[0] * BLOCKS[1]):
        row, column = divmod(bit, BLOCKS[1])
        inner = image[row * BLOCK + 4 : (row + 1) * BLOCK - 4, column * BLOCK + 4 : (column + 1) * BLOCK - 4]
        number |= int(inner[..., 1].mean() > 128) << bit
    return number
