"""Finding the chunk of an MCAP file whose content does not match its checksum."""

from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from bagassets.errors import RecordingError

__all__ = ["checksum_mismatch"]

# Before the fields of a record there are its opcode and its length.
_RECORD_HEADER_BYTES = 1 + 8


def checksum_mismatch(file: Path) -> RecordingError | None:
    """Return the error for the first chunk that does not match its checksum, or None if all do.

    It reads the whole file: call it when reading failed, to tell where.
    """
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        offsets = (
            [] if summary is None else sorted(index.chunk_start_offset for index in summary.chunk_indexes)
        )
        for offset in offsets:
            stream.seek(offset + _RECORD_HEADER_BYTES)
            try:
                get_chunk_data_stream(Chunk.read(ReadDataStream(stream)), validate_crc=True)
            except CRCValidationError:
                return RecordingError(
                    f"{file}: the content of the chunk at byte {offset} does not match its checksum, so the file was "
                    "damaged after it was recorded; copy it again, or save the other chunks with `mcap recover`."
                )
    return None
