"""Radar through the step `sweeps`."""

from dataclasses import dataclass

import numpy as np
import pytest

from bagassets.assets.radar_file import read_radar_file
from bagassets.recipe.model import RadarChannel
from bagassets_tests.sweep_data import (
    Header,
    cloud,
    header,
    raw,
)
from bagassets_tests.sweep_run import (
    CLOUD,
    START_NS,
    Runner,
    driving,
    request,
)


@pytest.fixture
def run(tmp_path):
    return Runner(tmp_path)


def radar_cloud(stamp_ns, number):
    columns = {name: np.arange(1.0, number + 1) for name in ("x", "y", "rcs")}
    return raw(cloud(stamp_ns, columns, "radar"), CLOUD, stamp_ns + 5)


def test_each_radar_message_becomes_a_file(run):
    messages = [radar_cloud(START_NS + n * 50_000_000, n + 1) for n in range(3)]
    result = run(request(RadarChannel(topic="/sensor"), CLOUD), messages)
    assert [row["points"] for row in result.index] == [1, 2, 3]
    assert [row["stamp_ns"] for row in result.index] == [START_NS + n * 50_000_000 for n in range(3)]
    assert "start_ns" not in result.index[0]
    assert result.index[0]["file"].endswith(".pcd")
    assert read_radar_file(result.files / result.index[2]["file"])["rcs"].tolist() == [1, 2, 3]
    assert result.channel["modality"] == "radar"


def test_a_radar_message_without_targets_becomes_a_file_without_targets(run):
    result = run(request(RadarChannel(topic="/sensor"), CLOUD), [radar_cloud(START_NS, 0)])
    assert result.index[0]["points"] == 0
    assert len(read_radar_file(result.files / result.index[0]["file"])) == 0


def test_of_radar_readings_published_while_they_fill_the_fullest_is_kept(run):
    messages = [radar_cloud(START_NS, n) for n in (1, 2, 4, 3)] + [radar_cloud(START_NS + 50_000_000, 2)]
    result = run(request(RadarChannel(topic="/sensor"), CLOUD), messages)
    assert [row["points"] for row in result.index] == [4, 2]
    assert result.lost == {"duplicate stamp": 3}


@dataclass
class EsrTrack:
    header: Header
    track_id: int
    track_range: float
    track_angle: float = 0.0
    track_range_rate: float = -1.0


def esr_tracks(cycles):
    """Messages of an ESR: 64 numbers every 50 ms, of which a few have a target."""
    for cycle in range(cycles):
        for number in range(1, 65):
            stamp = START_NS + cycle * 50_000_000 + number * 100_000
            distance = 10.0 + number if number % 10 == 0 else 0.0
            track = EsrTrack(header(stamp, "radar"), number, distance)
            yield raw(track, "delphi_esr_msgs/msg/EsrTrack", stamp)


def test_single_tracks_are_collected_into_cycles(run):
    messages = list(esr_tracks(3))
    result = run(
        request(RadarChannel(topic="/sensor"), "delphi_esr_msgs/msg/EsrTrack"), messages, driving(0.0)
    )
    assert [row["stamp_ns"] for row in result.index] == [
        START_NS + n * 50_000_000 + 100_000 for n in range(3)
    ]
    assert [row["points"] for row in result.index] == [6, 6, 6]
    targets = read_radar_file(result.files / result.index[1]["file"])
    assert targets["id"].tolist() == [10, 20, 30, 40, 50, 60]
    assert targets["x"].tolist() == [20, 30, 40, 50, 60, 70]
    assert result.summary["counts"] == {"read": 192, "written": 3, "merged": 189, "lost": {}}
    assert result.summary["points"]["dropped"] == {"no measurement": 174}


def test_a_pause_between_single_tracks_ends_a_cycle(run):
    late = EsrTrack(header(START_NS + 300_000_000, "radar"), 64, 5.0)
    early = EsrTrack(header(START_NS, "radar"), 1, 5.0)
    messages = [raw(track, "delphi_esr_msgs/msg/EsrTrack", START_NS) for track in (early, late)]
    result = run(
        request(RadarChannel(topic="/sensor"), "delphi_esr_msgs/msg/EsrTrack"), messages, driving(0.0)
    )
    assert [row["points"] for row in result.index] == [1, 1]


def test_the_log_clock_holds_for_radar(run):
    result = run(request(RadarChannel(topic="/sensor"), CLOUD, "log"), [radar_cloud(START_NS, 1)])
    assert result.index[0]["stamp_ns"] == START_NS + 5
