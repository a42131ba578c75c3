"""Pixels of compressed images, for tests."""

from bagassets.decode.compressed_image import checked_size, decode_pixels


def pixels_of(encoded, encoding):
    """Return the pixels of a JPEG or PNG that is whole; raise DecodeError for any other."""
    checked_size(encoded, encoding)
    return decode_pixels(encoded, encoding)
