"""What a cold build reads: chunks decompressed at most twice, memory that does not grow with the recording."""

import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from sample_drives import build_recordings

from bagassets.recipe import load_recipe
from bagassets.recordings import decompress
from bagassets.recordings.open import open_recording
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe

pytestmark = pytest.mark.once

ROOT = Path(__file__).parents[2]


def counted(monkeypatch, compression):
    """Count what is decompressed."""
    real, given = decompress._DECOMPRESSORS[compression], Counter()

    def decompressor(data, most_bytes):
        given[bytes(data)] += 1
        return real(data, most_bytes)

    monkeypatch.setitem(decompress._DECOMPRESSORS, compression, decompressor)
    return given


@pytest.mark.parametrize("compression", ["lz4", "bz2"])
def test_chunks_of_a_ros1_bag_are_decompressed_at_most_twice(tmp_path, monkeypatch, compression):
    write_recordings([Target(tmp_path / "recordings" / "drive.bag", "ros1", compression)], duration_s=1.2)
    (tmp_path / "recipe.yaml").write_text(sample_recipe())
    given = counted(monkeypatch, compression)
    build_recordings(load_recipe(tmp_path / "recipe.yaml"))
    assert len(given) > 2
    assert set(given.values()) == {2}


def test_chunks_of_an_mcap_are_decompressed_at_most_twice(tmp_path, monkeypatch):
    write_recordings([Target(tmp_path / "recordings" / "drive.mcap", "mcap", "zstd")], duration_s=1.2)
    (tmp_path / "recipe.yaml").write_text(sample_recipe())
    given = counted(monkeypatch, "zstd")
    build_recordings(load_recipe(tmp_path / "recipe.yaml"))
    assert len(given) > 2
    assert max(given.values()) <= 2


def test_chunks_whose_times_overlap_are_decompressed_once_a_pass(tmp_path, monkeypatch):
    store, path = get_typestore(Stores.ROS1_NOETIC), tmp_path / "late.bag"
    make = store.types["std_msgs/msg/UInt8MultiArray"]
    layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    dice = np.random.default_rng(0)
    times = np.arange(400) * 10_000_000 + dice.integers(0, 300_000_000, 400)  # up to 0.3 s late
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    writer.chunk_threshold = 50_000
    with writer:
        connection = writer.add_connection("/late", "std_msgs/msg/UInt8MultiArray", typestore=store)
        for stamp_ns in times.tolist():
            message = make(layout, dice.integers(0, 256, 1000, dtype=np.uint8))
            writer.write(connection, stamp_ns, store.serialize_ros1(message, connection.msgtype))
    given = counted(monkeypatch, "lz4")
    with open_recording(path) as recording:
        stamps = [message.log_time_ns for message in recording.messages(["/late"])]
    assert stamps == sorted(times.tolist())
    assert len(given) >= 8
    assert set(given.values()) == {1}


# Not `ru_maxrss`: that of a new process begins with the memory of the one that started it, here of pytest.
MEASURE = """
import sys, tempfile
from pathlib import Path
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets_tests.recording_build import RecordingBuild
from bagassets.recipe import load_recipe
from bagassets.store.store import Store

recipe = load_recipe(Path(sys.argv[1]))
(recording,) = discover(recipe.bags).recordings.values()
with tempfile.TemporaryDirectory(dir=Path(sys.argv[1]).parent) as store:
    build = RecordingBuild(
        recipe, Store(Path(store)), recording, recording_digest(recording).digest, recording_stat(recording), workers=2
    )
    assert len(list(build.build())) > 6
status = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines())
print(int(status["VmHWM"].split()[0]) // 1024)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
@pytest.mark.long
def test_memory_is_bounded_whatever_the_length(tmp_path):
    peaks_mb = []
    for seconds in (0.5, 2.0):
        folder = tmp_path / str(seconds)
        write_recordings(
            [Target(folder / "recordings" / "drive.bag", "ros1")], profile="tas", duration_s=seconds
        )
        text = sample_recipe(throughput=True) + "preview: {enabled: false}\n"
        (folder / "recipe.yaml").write_text(text)
        command = [sys.executable, "-c", MEASURE, str(folder / "recipe.yaml")]
        done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
        peaks_mb.append(int(done.stdout))
    # Three quarters of the longer one, 134 MB, were added; an image takes 15 MB on its way.
    assert peaks_mb[1] - peaks_mb[0] < 60, peaks_mb
