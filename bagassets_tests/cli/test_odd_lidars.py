"""Lidars of the sample that do what real ones do: their sweeps are those of the unchanged drive, deskewed, too."""

import json
from contextlib import ExitStack
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

from bagassets.cli.inspect import inspect
from bagassets.decode.pointcloud2 import point_fields
from bagassets.geometry.trajectory import Trajectory
from bagassets.propose.scan import scan_recording
from bagassets.recordings.discover import find_one
from bagassets.recordings.open import open_recording
from bagassets.sample.messages import Messages
from bagassets.sample.oddities import ODDITIES, UNTIMED
from bagassets.sample.recorder import open_recorder
from bagassets.sample.schedule import drive_events
from bagassets.sample.truth import Truth
from bagassets.sample.world import World
from bagassets_tests.sweep_data import raw
from bagassets_tests.sweep_run import CLOUD, Runner, lidar, request

pytestmark = pytest.mark.once

START_NS = 1_750_000_000_000_000_000
TRUTH = Truth(World(5), START_NS, {})
TURN_NS = round(1e8 * 719 / 720)  # from the first to the last column of a revolution
POINTS = "/lidar_top/points"
SWEEPS = 7


@cache
def plain_events():
    return tuple(drive_events(TRUTH, 0.7))


def events(odd=None):
    plain = iter(plain_events())
    return plain if odd is None else ODDITIES[odd](plain, TRUTH)


def clouds(odd=None):
    messages = Messages(ros1=False)
    return [raw(e.make(messages), CLOUD, e.log_time_ns) for e in events(odd) if e.topic == POINTS]


def trajectory(start_ns):
    stamps = START_NS + np.arange(-10, 120) * 10_000_000
    poses = [TRUTH.odom_SE3_ego(int(stamp)) for stamp in stamps]
    positions, rotations = (
        np.array([getattr(p, name) for p in poses]) for name in ("translation", "rotation")
    )
    return Trajectory(stamps - START_NS + start_ns, positions, rotations, max_gap_ns=10**9, extrapolate_ns=0)


def sweeps(folder, odd=None, start_ns=START_NS, **fields):
    asked = request(lidar(deskew=True, **fields), CLOUD)
    return Runner(folder)(asked, clouds(odd), trajectory(start_ns))


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    result = sweeps(tmp_path_factory.mktemp("plain"))
    headers = START_NS + np.arange(len(result.index)) * 100_000_000
    assert len(headers) == SWEEPS
    assert np.abs([row["end_ns"] for row in result.index] - headers - TURN_NS).max() <= 1
    return result


@pytest.mark.parametrize(
    ("odd", "fields", "spoilt"),
    [
        ("dates-with-zeros", {}, range(SWEEPS)),
        ("garbage-times", {}, [0, 3, 4, 5]),
        ("uptime", {"header_stamp_is": "start"}, []),
        ("simulated-clock", {}, []),
        ("zero-points", {}, []),
        ("unit-intensity", {"intensity_scale": 256}, []),
    ],
)
def test_sweeps_are_those_of_the_unchanged_drive(plain, tmp_path, odd, fields, spoilt):
    start_ns = 0 if odd == "simulated-clock" else START_NS
    result = sweeps(tmp_path, odd, start_ns, **fields)
    for number, (row, other) in enumerate(zip(result.index, plain.index, strict=True)):
        for moment in ("stamp_ns", "start_ns", "end_ns"):
            assert abs(row[moment] - start_ns - (other[moment] - START_NS)) <= 300
        finite = np.isfinite(clouds_x(number))
        kept = np.ones(len(finite), bool)
        kept[UNTIMED] = number not in spoilt
        wanted = plain.points(number)[kept[finite]]
        assert np.abs(result.points(number) - wanted).max() < 2e-5
    lost = {"no usable time": len(spoilt) * int(np.isfinite(clouds_x(0)[UNTIMED]).sum())} if spoilt else {}
    measured = result.summary["points"]["dropped"]
    assert {reason: number for reason, number in measured.items() if reason != "no measurement"} == lost


def clouds_x(number):
    """The coordinates of the points of the unchanged drive, NaN where they are no measurements."""
    return point_fields(clouds()[number].data.message)["x"][0]


def record(path, odd):
    with ExitStack() as stack:
        recorder = open_recorder(path, "mcap", "none", stack)
        for one in events(odd):
            recorder.write(one.topic, one.msgtype, one.log_time_ns, one.make(recorder.messages))
    return path


SAID = {
    "dates-with-zeros": "(timestamp) count s by the clock of the header stamps, 0.100 s a cloud; 0.",
    "uptime": "(t) count ns by another clock (-1749996701.6 s), of which only differences are used, 0.100 s a cloud.",
    "zero-points": ": the times of its points (t) count ns since the header stamp, 0.100 s a cloud.",
}


@pytest.mark.parametrize("odd", SAID)
def test_inspect_says_what_the_times_of_points_are(tmp_path, odd):
    path = record(tmp_path / "drive.mcap", odd)
    said = CliRunner().invoke(inspect, [str(path)], catch_exceptions=False)
    (line,) = (line for line in said.output.splitlines() if "times of" in line)
    assert line.startswith(f"note: {POINTS}: ")
    assert SAID[odd] in line
    notes = json.loads(CliRunner().invoke(inspect, [str(path), "--json"]).output)["notes"]
    assert line.removeprefix("note: ") in notes


@pytest.mark.parametrize(("odd", "scale"), [(None, 1), ("unit-intensity", 256)])
def test_init_sees_the_range_of_intensities(tmp_path, odd, scale):
    with open_recording(find_one(record(tmp_path / "drive.mcap", odd))) as recording:
        topic = scan_recording(recording).topics[POINTS]
    recorded = [point_fields(message.data.message)["intensity"] for message in clouds()[:5]]
    assert topic.most_intensity == np.max([values.max() for values in recorded]) / scale
    assert topic.timed is True
