"""Damage within a chunk of an MCAP file is found by its checksum, and fails that recording alone."""

import random
from zlib import crc32

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType

from bagassets.base.errors import RecordingError
from bagassets.engine.execute import BuildFailure
from bagassets.recordings.open import open_recording
from bagassets_tests.recorded_bags import NOON_NS, text, write_ros2
from bagassets_tests.small_drive import RECIPE
from bagassets_tests.tiny_mcap import write_tiny
from bagassets_tests.whole.test_end_to_end import build_of, make_project

# Where the fields of a chunk's record lie: its times, size and checksum come first.
CHECKSUM_AT = 1 + 8 + 24


def chunks_of(path):
    with path.open("rb") as stream:
        return sorted(make_reader(stream).get_summary().chunk_indexes, key=lambda one: one.chunk_start_offset)


def overwrite(path, offset, data):
    with path.open("r+b") as stream:
        stream.seek(offset)
        stream.write(data)


@pytest.fixture
def plain(tmp_path):
    """An uncompressed file of several chunks."""
    return write_tiny(tmp_path / "a.mcap", compression=CompressionType.NONE, chunk_size=20_000)


def damage(path):
    """Put noise into the payload of a chunk in the middle; return where the chunk begins."""
    chunks = chunks_of(path)
    assert len(chunks) > 2
    chunk = chunks[len(chunks) // 2]
    middle = chunk.chunk_start_offset + chunk.chunk_length // 2
    overwrite(path, middle, random.Random(1).randbytes(min(3000, chunk.chunk_length // 4)))
    return chunk.chunk_start_offset


def read_all(path, *, check):
    with open_recording(path) as recording:
        if check:
            recording.check_content()
        return list(recording.messages(list(recording.topics)))


def test_a_sound_file_passes(plain):
    assert read_all(plain, check=True) == read_all(plain, check=False)


def test_noise_in_a_chunk_is_reported_with_file_offset_and_advice(plain):
    offset = damage(plain)
    with pytest.raises(RecordingError) as caught:
        read_all(plain, check=True)
    output = str(caught.value)
    assert output.startswith(f"{plain}: ")
    assert f"chunk at byte {offset} " in output
    assert "mcap recover" in output


def test_without_a_checksum_there_is_nothing_to_check(plain):
    for chunk in chunks_of(plain):
        overwrite(plain, chunk.chunk_start_offset + CHECKSUM_AT, bytes(4))
    assert len(read_all(plain, check=True)) == len(read_all(plain, check=False))


def test_the_inventory_checks_what_it_reads(tmp_path):
    recipe = make_project(tmp_path, text=RECIPE)
    recipe.bags.root.mkdir()
    path = write_tiny(recipe.bags.root / "a.mcap", compression=CompressionType.NONE, chunk_size=20_000)
    offset = damage(path)
    with pytest.raises(BuildFailure, match=f"chunk at byte {offset} ") as caught:
        list(build_of(recipe, "a.mcap").build())
    assert list(caught.value.errors) == ["inventory"]


def test_a_ros2_folder_of_mcap_files(tmp_path):
    folder = write_ros2(tmp_path / "folder", [text(NOON_NS + i) for i in range(3)], "MCAP")
    (file,) = folder.glob("*.mcap")
    chunk = chunks_of(file)[0]
    header = CHECKSUM_AT + 4 + 4 + len(chunk.compression) + 8
    with file.open("rb") as stream:
        stream.seek(chunk.chunk_start_offset + header)
        data = stream.read(chunk.compressed_size)
    overwrite(file, chunk.chunk_start_offset + CHECKSUM_AT, (crc32(data) ^ 1).to_bytes(4, "little"))
    with pytest.raises(RecordingError) as caught:
        read_all(folder, check=True)
    output = str(caught.value)
    assert output.startswith(f"{file}: ")
    assert f"chunk at byte {chunk.chunk_start_offset} " in output
