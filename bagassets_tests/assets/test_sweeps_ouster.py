"""Packets of an Ouster through the step `sweeps`: revolutions, clocks, parts of a turn, deskewing, what is lost."""

import json
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bagassets.assets.ouster_sweeps import lidar_of
from bagassets.assets.sweeps import SWEEPS
from bagassets.base.errors import LossLimitError, RecipeError
from bagassets.decode.ouster import OusterLidar
from bagassets.recipe.model import Rig
from bagassets_tests.facts import MadeUpFacts, calibrated, use_of
from bagassets_tests.ouster_data import (
    COLUMN_NS,
    COLUMNS,
    PACKETS,
    PER_PACKET,
    RANGE_MM,
    TURN_NS,
    message,
    messages,
    metadata,
    packet,
    seen,
)
from bagassets_tests.sweep_run import CLOUD, MOUNT, START_NS, Runner, driving, inventory, lidar

FILE = Path("/os.json")


@pytest.fixture
def run(tmp_path):
    return Runner(tmp_path)


def request(described=None, msgtype=PACKETS, *, clock="log", limit=0.0, **fields):
    fields = {"metadata": FILE, **fields}
    rig = Rig(name="car", channels={"LIDAR_TOP": lidar(**fields)}, ego_pose={"source": "fixed"})
    facts = MadeUpFacts(
        inventory(msgtype),
        calibration=calibrated(LIDAR_TOP={"ego_SE3_sensor": MOUNT}),
        artifacts={"ego_poses": SimpleNamespace(digest="p")},
        files={FILE: described or metadata()},
    )
    return use_of(SWEEPS, rig, facts, "LIDAR_TOP", clock=clock, limits={"lost_messages": limit})


def test_packets_become_complete_revolutions(run):
    result = run(request(), messages(3.5, begin=32, logged_ns=START_NS))
    # half a turn, three turns
    assert result.lost == {"incomplete revolution": 2}
    assert result.summary["counts"]["read"] == result.summary["messages"] == 14
    assert [row["points"] for row in result.index] == [4 * COLUMNS] * 3
    for number, row in enumerate(result.index, start=1):
        begin_ns = START_NS + number * TURN_NS
        assert (row["start_ns"], row["end_ns"]) == (begin_ns, begin_ns + COLUMNS * COLUMN_NS)
        assert row["stamp_ns"] == row["end_ns"]
        assert row["log_time_ns"] == begin_ns + (COLUMNS - 1) * COLUMN_NS
    for index, point in enumerate(result.points()):
        np.testing.assert_allclose(point[:3], seen(index // 4, 3 - index % 4), atol=1e-6)
        assert point[3:].tolist() == [43 - index % 4, index % 4]


def test_jitter_of_the_network_does_not_move_revolutions(run):
    late = [
        one._replace(log_time_ns=one.log_time_ns + (number % 2) * 3_000_000 * (number % 5 == 0))
        for number, one in enumerate(messages(2, logged_ns=START_NS))
    ]
    assert [row["start_ns"] for row in run(request(), late).index] == [START_NS, START_NS + TURN_NS]


@pytest.mark.parametrize("ahead_ns", [0, 37_000_000_000])
def test_with_header_clock_the_times_are_those_of_a_lidar_that_is_synchronized(run, ahead_ns):
    start_ns = START_NS + ahead_ns
    result = run(request(clock="header"), messages(1, logged_ns=START_NS + 4_000_000, start_ns=start_ns))
    assert [row["start_ns"] for row in result.index] == [START_NS]


def test_a_lidar_that_is_not_synchronized_has_no_times_for_the_header_clock(run):
    with pytest.raises(
        LossLimitError, match=r"lost 4 of 4 messages.*no header.*set clock: log in the recipe"
    ):
        run(request(clock="header"), messages(1, logged_ns=START_NS))


@pytest.mark.parametrize(("window", "cut"), [((48, 15), 32), ((16, 47), 0), ((17, 32), 0)])
def test_a_part_of_each_turn_is_one_sweep(run, window, cut):
    described = metadata(column_window=list(window))
    result = run(request(described), messages(4, logged_ns=START_NS, window=window))
    columns = (window[1] - window[0]) % COLUMNS + 1
    assert {row["points"] for row in result.index} == {4 * columns}
    assert {row["end_ns"] - row["start_ns"] for row in result.index} == {columns * COLUMN_NS}
    assert len(result.index) == (4 if cut == 0 else 3)
    # Beginning amid a sweep, half of the first one is missing, and of the last one.
    assert result.lost == ({} if cut == 0 else {"incomplete revolution": 2})


def test_columns_beyond_the_window_of_the_metadata_are_within_the_revolution(run):
    result = run(request(metadata(column_window=[20, 40])), messages(4, logged_ns=START_NS))
    rows = result.index[1:]  # the first is half a turn, and complete by its window
    assert [row["points"] for row in rows] == [4 * COLUMNS] * 3
    assert {row["end_ns"] - row["start_ns"] for row in rows} == {TURN_NS}


def test_a_lidar_that_reports_a_single_column_has_a_moment_for_a_sweep(run):
    described = metadata(column_window=[20, 20])
    result = run(request(described), messages(2, logged_ns=START_NS, window=(20, 20)))
    assert [(row["points"], row["start_ns"], row["end_ns"]) for row in result.index] == [
        (4, *[START_NS + 20 * COLUMN_NS + number * TURN_NS] * 2) for number in range(2)
    ]


@pytest.mark.parametrize("window", [(0, COLUMNS - 1), (20, 20)])
def test_a_turn_without_a_valid_column_is_incomplete(run, window):
    described = metadata(column_window=list(window))
    whole = list(messages(3, logged_ns=START_NS, window=window))
    invalid = message(packet(COLUMNS + 16, window=(0, 0)), COLUMNS + 16, START_NS)
    turn = len(whole) // 3
    result = run(request(described), [*whole[:turn], invalid, *whole[2 * turn :]])
    assert len(result.index) == 2
    assert result.lost == {"incomplete revolution": 1}


def test_the_cut_angle_moves_the_revolutions_by_packets(run):
    result = run(request(cut_angle_deg=100.0), messages(3, logged_ns=START_NS))
    assert [row["start_ns"] for row in result.index] == [
        START_NS + 16 * COLUMN_NS + number * TURN_NS for number in range(2)
    ]
    assert result.lost == {"incomplete revolution": 1 + 3}


def test_points_are_deskewed_by_the_times_of_their_columns(run):
    speed = 10.0
    result = run(
        request(deskew=True), messages(1, logged_ns=START_NS), trajectory=driving(speed, seconds=2.0)
    )
    stamp_ns = result.index[0]["stamp_ns"]
    for index, point in enumerate(result.points()):
        measured_ns = START_NS + index // 4 * COLUMN_NS
        moved = np.array([speed * (measured_ns - stamp_ns) * 1e-9, 0.0, 0.0])
        np.testing.assert_allclose(point[:3], seen(index // 4, 3 - index % 4) + moved, atol=1e-4)


def test_what_is_missing_makes_a_revolution_incomplete_by_its_width(run):
    whole = list(messages(3, logged_ns=START_NS))
    del whole[5]  # 16 columns of 64: 90 degrees
    result = run(request(), whole)
    assert [row["start_ns"] for row in result.index] == [START_NS, START_NS + 2 * TURN_NS]
    assert result.lost == {"incomplete revolution": 3}


def test_a_few_columns_that_are_missing_at_an_edge_do_not_move_it(run):
    # Of the lidar's window only what is inside is valid: columns 2 to 61 of a whole turn.
    result = run(request(), messages(2, logged_ns=START_NS, window=(2, COLUMNS - 3)))
    assert [row["points"] for row in result.index] == [4 * (COLUMNS - 4)] * 2
    assert [(row["start_ns"], row["end_ns"]) for row in result.index] == [
        (START_NS + number * TURN_NS, START_NS + (number + 1) * COLUMNS * COLUMN_NS) for number in range(2)
    ]


def test_late_packets_belong_to_their_revolution_and_doubled_ones_count_once(run):
    whole = list(messages(3, logged_ns=START_NS))
    expected = [row["digest"] for row in run(request(), whole).index]
    swapped = [*whole[:3], whole[4], whole[3], *whole[5:]]
    result = run(request(), [*swapped[:7], swapped[6], *swapped[7:]])
    assert [row["digest"] for row in result.index] == expected
    assert result.lost == {"recorded twice": 1}


@pytest.mark.parametrize("first_frame", [65_534, 0])
def test_numbers_of_turns_may_begin_again(run, first_frame):
    result = run(request(), messages(5, logged_ns=START_NS, first_frame=first_frame))
    assert len(result.index) == 5
    assert not result.lost


def test_a_lidar_that_was_started_again_goes_on(run):
    before = list(messages(2, logged_ns=START_NS, first_frame=500))
    after = messages(2, logged_ns=START_NS + 5 * TURN_NS, first_frame=0, start_ns=1_000)
    result = run(request(), [*before, *after])
    assert [row["start_ns"] for row in result.index] == [
        START_NS + number * TURN_NS for number in (0, 1, 5, 6)
    ]


@pytest.mark.parametrize("clock", ["log", "header"])
@pytest.mark.parametrize("first", [2, 3, 4])
def test_a_revolution_in_which_the_lidar_is_synchronized_is_refused(run, clock, first):
    before = list(messages(1, logged_ns=START_NS))[:first]
    after = list(messages(3, logged_ns=START_NS, start_ns=START_NS))[first:]
    result = run(request(limit=1.0, clock=clock), [*before, *after])
    kept = (1, 2) if first < 4 or clock == "header" else (0, 1, 2)
    assert [row["start_ns"] for row in result.index] == [START_NS + number * TURN_NS for number in kept]
    assert all(row["end_ns"] - row["start_ns"] == TURN_NS for row in result.index)


def test_what_hit_nothing_is_no_point(run):
    result = run(request(), messages(1, logged_ns=START_NS, range_mm=0))
    assert result.lost == {"no point in it": 4}
    assert result.summary["points"]["dropped"] == {"no measurement": 4 * COLUMNS}


def test_drivers_before_2023_send_a_byte_too_many(run):
    whole = list(messages(2, logged_ns=START_NS))
    longer = [message(packet(first) + b"\0", first, START_NS) for first in range(0, 2 * COLUMNS, PER_PACKET)]
    results = [run(request(), one) for one in (whole, longer)]
    assert results[0].index == results[1].index
    assert len(results[0].index) == 2


def test_packets_that_are_none_of_the_lidar_are_counted(run):
    whole = list(messages(2, logged_ns=START_NS))
    odd = [message(bytes(48), 0, START_NS), message(packet(0)[:-1], 0, START_NS)]
    result = run(request(limit=0.25), [*whole, *odd])
    assert len(result.index) == 2
    assert {reason.split(",")[0] for reason in result.lost} == {
        "its packet has 48 bytes",
        "its packet has 1023 bytes",
    }
    with pytest.raises(LossLimitError, match="lost 2 of 10 messages; the first: its packet has 48 bytes"):
        run(request(), [*whole, *odd])


@pytest.mark.parametrize("column_ns", [0, -COLUMN_NS])
def test_columns_whose_times_are_not_in_order_are_refused(run, column_ns):
    backwards = [
        message(packet(first, column_ns=column_ns), first, START_NS)
        for first in range(0, COLUMNS, PER_PACKET)
    ]
    with pytest.raises(LossLimitError, match="the times of its columns do not follow their order"):
        run(request(), backwards)


def test_metadata_is_required_and_read_from_the_file_or_the_topic_beside():
    with pytest.raises(
        RecipeError, match=r"LIDAR_TOP: the packets in /sensor say nothing.*no /metadata; name a file"
    ):
        request(metadata=None)
    with pytest.raises(RecipeError, match=r"/gone.json: the metadata cannot be read"):
        request(metadata=Path("/gone.json"))
    assert request().inputs != request(metadata(column_window=[0, 31])).inputs
    assert request().topics == ("/sensor",)


def test_metadata_that_cannot_be_used_names_the_channel(run):
    with pytest.raises(
        RecipeError,
        match=r"LIDAR_TOP: the file in `metadata` does not say.*/sensor.*no metadata of an Ouster",
    ):
        run(request(b"{}"), [])


def published(*messages):
    """What the topic beside the packets says of the lidar."""
    use = replace(request().params, metadata=None, metadata_topic="/metadata")

    @contextmanager
    def recording(topics):
        assert topics == ("/metadata",)
        yield SimpleNamespace(messages=lambda _: messages, decode=lambda message: message)

    return lidar_of(use, SimpleNamespace(messages=recording))


def test_metadata_may_be_published_again():
    again = json.dumps(json.loads(metadata()) | {"sensor_info": {"status": "RUNNING"}}, indent=1)
    texts = [SimpleNamespace(data=text) for text in (metadata().decode(), again)]
    assert vars(published(*texts)) == vars(OusterLidar.parse(metadata()))
    other = SimpleNamespace(data=metadata(column_window=[0, 31]).decode())
    with pytest.raises(
        RecipeError, match=r"/metadata does not say.*describes the lidar in 2 ways; name a file"
    ):
        published(*texts, other)
    with pytest.raises(RecipeError, match="it is empty"):
        published()


@pytest.mark.parametrize("odd", [SimpleNamespace(text="{}"), SimpleNamespace(data=np.zeros(2, np.uint8))])
def test_what_is_published_as_metadata_may_be_something_else(odd):
    with pytest.raises(RecipeError, match=r"LIDAR_TOP: /metadata does not say.*no metadata of an Ouster"):
        published(odd)


@pytest.mark.parametrize(
    ("field", "value", "msgtype", "what"),
    [
        ("model", "VLP-16", PACKETS, "Velodyne packets"),
        ("metadata", FILE, CLOUD, "packets of Ouster and Hesai"),
        ("header_stamp_is", "start", PACKETS, "clouds"),
        ("zero_points", "keep", "velodyne_msgs/msg/VelodyneScan", "clouds"),
    ],
)
def test_fields_for_other_packets_are_refused(field, value, msgtype, what):
    with pytest.raises(
        RecipeError, match=f"LIDAR_TOP: {field} can be set for {what} only, but /sensor carries {msgtype}"
    ):
        request(msgtype=msgtype, **{field: value})


def test_the_lidar_of_these_tests_is_what_they_say():
    assert OusterLidar.parse(metadata()).columns == COLUMNS
    assert len(packet(0)) == OusterLidar.parse(metadata()).packet.itemsize
    assert RANGE_MM == 10_000
