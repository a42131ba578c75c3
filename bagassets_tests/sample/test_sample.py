"""Sample drives as recordings: the same from the same seed, in every format and compression."""

import hashlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bagassets.base.errors import RecordingError
from bagassets.cli.sample import sample
from bagassets.recipe.model import Bags
from bagassets.recordings.discover import discover, find_one
from bagassets.recordings.open import open_recording
from bagassets.sample.arm_oddities import ARM_ODDITIES
from bagassets.sample.drive import PROFILES, Target, drive_start_ns, write_recordings
from bagassets.sample.oddities import ODDITIES
from bagassets.sample.recorder import COMPRESSIONS, RecordingFormat
from bagassets_tests.services import eventually

pytestmark = pytest.mark.once

SHORT_S = 0.25


def content(path):
    """(log time, topic, type, payload without the encapsulation) of every message."""
    with open_recording(find_one(path) if isinstance(path, Path) else path) as recording:
        return [
            (m.log_time_ns, m.topic, m.msgtype, bytes(m.data))
            for m in recording.messages(list(recording.topics))
        ]


def file_digests(path):
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    return {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


@pytest.mark.parametrize("file_format", ["ros1", "ros2", "mcap"])
def test_a_seed_is_a_drive(tmp_path, file_format):
    write_recordings([Target(tmp_path / "1" / "d", file_format)], seed=4, duration_s=SHORT_S)
    write_recordings([Target(tmp_path / "2" / "d", file_format)], seed=4, duration_s=SHORT_S)
    write_recordings([Target(tmp_path / "3" / "d", file_format)], seed=5, duration_s=SHORT_S)
    assert file_digests(tmp_path / "1" / "d") == file_digests(tmp_path / "2" / "d")
    assert file_digests(tmp_path / "1" / "d") != file_digests(tmp_path / "3" / "d")


@pytest.mark.parametrize(
    ("file_format", "compression"),
    [(f, c) for f, known in COMPRESSIONS.items() for c in known if f != "foxglove"],
)
def test_every_compression_holds_the_same_messages(tmp_path, file_format, compression):
    name = {"ros1": "d.bag", "ros2": "d", "mcap": "d.mcap"}[file_format]
    targets = [
        Target(tmp_path / "plain" / name, file_format),
        Target(tmp_path / name, file_format, compression),
    ]
    write_recordings(targets, duration_s=SHORT_S)
    assert content(tmp_path / name) == content(tmp_path / "plain" / name)


def test_parts_are_the_drive_cut_as_recorders_do(tmp_path):
    names: dict[str, RecordingFormat] = {"d.bag": "ros1", "d.db3": "ros2", "d.mcap": "mcap"}
    targets = [Target(tmp_path / "whole" / name, kind) for name, kind in names.items()]
    targets += [Target(tmp_path / kind / name, kind, parts=3) for name, kind in names.items()]
    write_recordings(targets, duration_s=0.9)
    for name, kind in names.items():
        (cut,) = discover(Bags(root=tmp_path / kind)).recordings.values()
        numbered = [Path(name).with_stem(f"d_{number}").name for number in range(3)]
        assert [part.relative for part in cut.parts] == numbered
        assert sorted(path.name for path in (tmp_path / kind).iterdir()) == numbered
        assert content(cut) == content(tmp_path / "whole" / name)


def test_a_command_writes_parts(tmp_path):
    result = CliRunner().invoke(sample, [str(tmp_path / "d.db3"), "--duration", "0.2", "--parts", "2"])
    assert f"Wrote {tmp_path / 'd.db3'} in 2 parts" in result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d_0.db3", "d_1.db3"]


def test_a_folder_has_no_parts_beside_it(tmp_path):
    result = CliRunner().invoke(sample, [str(tmp_path / "d"), "--parts", "2"])
    assert (result.exit_code, "a folder is one recording" in result.output) == (2, True)


def test_every_format_has_the_same_topics_times_and_counts(tmp_path):
    paths = {"ros1": tmp_path / "d.bag", "ros2": tmp_path / "d", "mcap": tmp_path / "d.mcap"}
    write_recordings([Target(path, file_format) for file_format, path in paths.items()], duration_s=SHORT_S)
    ros1, ros2, mcap = ([m[:3] for m in content(path)] for path in paths.values())
    assert ros1 == ros2 == mcap
    assert [m[0] for m in ros1] == sorted(m[0] for m in ros1)
    assert {m[1] for m in ros1} == {
        "/annotations", "/cam_front/camera_info", "/cam_front/image_raw", "/cam_front_left/camera_info",
        "/cam_front_left/image_raw", "/cam_front_right/camera_info", "/cam_front_right/image_raw/compressed",
        "/gnss/fix", "/imu/data", "/lidar_top/points", "/odom", "/radar_front/points", "/tf", "/tf_static",
    }  # fmt: skip
    assert content(paths["ros2"]) == content(paths["mcap"])


def test_what_is_there_is_not_overwritten(tmp_path):
    (tmp_path / "d.bag").write_text("precious")
    with pytest.raises(RecordingError, match=r"d\.bag: exists already"):
        write_recordings([Target(tmp_path / "d.bag", "ros1")], duration_s=SHORT_S)
    assert (tmp_path / "d.bag").read_text() == "precious"


def test_an_unknown_compression_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(
        RecordingError, match="ros1 recordings do not support the compression zstd; use none, lz4, bz2"
    ):
        write_recordings([Target(tmp_path / "d.bag", "ros1", "zstd")], duration_s=SHORT_S)
    assert list(tmp_path.iterdir()) == []


def test_lz4_frames_are_those_that_ros_1_reads_and_carry_checksums(tmp_path):
    """Each byte of a chunk that is changed is noticed; roslz4 refuses other flags than these."""
    path = tmp_path / "d.bag"
    write_recordings([Target(path, "ros1", "lz4")], duration_s=SHORT_S)
    data = path.read_bytes()
    frames = [at for at in range(len(data)) if data.startswith(b"\x04\x22\x4d\x18", at)]
    assert frames
    assert {data[at + 4] for at in frames} == {
        0b0110_0100
    }  # version 1, blocks apart, checksum of the content
    assert {data[at + 5] >> 4 for at in frames} <= {4, 5, 6, 7}
    for at in np.random.default_rng(3).integers(frames[0] + 7, data.index(b"op=\x04", frames[0]), 40):
        damaged = bytearray(data)
        damaged[at] ^= 0x10
        path.write_bytes(damaged)
        with pytest.raises(RecordingError):
            content(path)


class TestThroughput:
    @pytest.fixture(scope="class")
    @classmethod
    def drive(cls, tmp_path_factory):
        folder = tmp_path_factory.mktemp("tas")
        paths = {"ros1": folder / "d.bag", "mcap": folder / "d.mcap"}
        targets = [Target(path, file_format) for file_format, path in paths.items()]
        return write_recordings(targets, 2, "tas", 0.6), paths

    def test_it_makes_90_megabytes_a_second(self, drive):
        _, paths = drive
        rate = sum(len(m[3]) for m in content(paths["mcap"])) / 0.6 / 1e6
        assert 80 < rate < 110

    @pytest.mark.parametrize("file_format", ["ros1", "mcap"])
    def test_stamps_are_written_into_every_copy(self, drive, file_format):
        truth, paths = drive
        with open_recording(find_one(paths[file_format])) as recording:
            scans, images = [], []
            for message in recording.messages(list(recording.topics)):
                if message.topic == "/lidar_top/velodyne_packets":
                    scans.append(recording.decode(message))
                elif message.topic == "/cam_back/image_raw":
                    images.append(recording.decode(message))
        starts = [
            scan.header.stamp.sec * 10**9 + scan.header.stamp.nanosec - truth.start_ns for scan in scans
        ]
        assert starts == [i * 100_000_000 for i in range(6)]
        for start, scan in zip(starts, scans, strict=True):
            stamps = [p.stamp.sec * 10**9 + p.stamp.nanosec - truth.start_ns for p in scan.packets]
            assert stamps == [start + i * 173_400 for i in range(577)]
            device_us = [int.from_bytes(bytes(p.data[1200:1204]), "little") for p in scan.packets]
            assert np.diff(device_us).min() >= 173
            assert device_us[0] == (truth.start_ns + start) // 1000 % 3_600_000_000
        assert len(images) == 6
        assert not np.array_equal(images[0].data, images[1].data)
        assert np.array_equal(images[0].data, images[5].data)


def test_the_command_writes_a_drive_and_says_what_next(tmp_path):
    done = CliRunner().invoke(
        sample, [str(tmp_path / "x.mcap"), "--duration", "0.3", "--seed", "7", "--compression", "zstd"]
    )
    assert done.exit_code == 0, done.output
    assert "bagassets inspect" in done.output
    first = content(tmp_path / "x.mcap")[0]
    assert first[0] == drive_start_ns(7)


@pytest.mark.parametrize(("name", "kind"), [("a.bag", b"#ROSBAG V2.0"), ("a.mcap", b"\x89MCAP")])
def test_the_command_takes_the_format_from_the_name(tmp_path, name, kind):
    assert CliRunner().invoke(sample, [str(tmp_path / name), "--duration", "0.2"]).exit_code == 0
    assert Path(tmp_path / name).read_bytes().startswith(kind)


def test_profiles_are_documented_on_the_command_line():
    text = CliRunner().invoke(sample, ["--help"]).output
    assert all(profile in text for profile in PROFILES)


def test_the_page_about_tests_lists_every_oddity():
    page = (Path(__file__).parents[2] / "docs" / "tests.md").read_text("utf-8")
    rows = page.partition("## Oddities")[2].partition("\n## ")[0].splitlines()
    listed = [row.split("`")[1] for row in rows if row.startswith("| `")]
    assert sorted(listed) == sorted([*ODDITIES, *ARM_ODDITIES])


def test_an_unknown_oddity_is_answered_with_those_that_are(tmp_path):
    result = CliRunner().invoke(sample, [str(tmp_path / "d.bag"), "--odd", "purple"])
    assert result.exit_code == 2
    assert "no oddity of the car is named purple; known: " in result.output
    assert not (tmp_path / "d.bag").exists()


INTERRUPTED = """
import signal, sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from bagassets.sample.demo import missing_drives, write_drives

def interrupted(*args):
    signal.raise_signal(signal.SIGINT)
    return submit(*args)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    submit, ProcessPoolExecutor.submit = ProcessPoolExecutor.submit, interrupted
    try:
        list(write_drives(Path(sys.argv[1]), missing_drives(Path()), 600.0))
    except KeyboardInterrupt:
        print("interrupted")
"""


def test_an_interrupt_while_the_processes_of_a_demo_start_is_for_all_of_them(tmp_path):
    (tmp_path / "demo.py").write_text(INTERRUPTED)
    command = [sys.executable, tmp_path / "demo.py", tmp_path / "bags"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")


def test_a_killed_demo_leaves_no_process_behind(tmp_path):
    code = "import sys; from pathlib import Path; from bagassets.sample.demo import *\n"
    code += "if __name__ == '__main__': list(write_drives(Path(sys.argv[1]), missing_drives(Path()), 60.0))\n"
    (tmp_path / "demo.py").write_text(code)
    command = [sys.executable, tmp_path / "demo.py", tmp_path / "bags"]
    process = subprocess.Popen(command, start_new_session=True)
    eventually(lambda: any((tmp_path / ".writing").glob("*")), "a recording is being written")
    process.kill()
    process.wait()

    def is_gone():
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return True
        return False

    try:
        eventually(is_gone, "its workers have ended")
    finally:
        if not is_gone():
            os.killpg(process.pid, signal.SIGKILL)
