"""What the times of points count, and from when: decided for a topic, from the many, the few lost and counted.

A lidar turns once in 0.1 s, from its header stamp on, on a vehicle at 10 m/s along x: whatever way its driver tells times,
the sweeps end when they did, and a deskewed point is where it was seen from the end.
"""

import numpy as np
import pytest

from bagassets.base.errors import LossLimitError, RecipeError
from bagassets_tests.sweep_data import cloud, raw
from bagassets_tests.sweep_run import CLOUD, PERIOD_NS, START_NS, Runner, driving, lidar, request

NUMBER = 600
SWEEPS = 8
LAST_NS = 99_840_000
OFFSETS_NS = np.linspace(0, LAST_NS, NUMBER).astype(np.int64)
SPEED_MPS = 10.0
ANGLES = np.linspace(0, 2 * np.pi, NUMBER, endpoint=False)
XYZ = {"x": 20 * np.cos(ANGLES), "y": 20 * np.sin(ANGLES), "z": np.full(NUMBER, 1.0)}
FEW = np.arange(7, NUMBER, 40)  # 15 of 600


@pytest.fixture
def run(tmp_path):
    return Runner(tmp_path)


def turns(tell, *, name="timestamp", start_ns=START_NS, xyz=XYZ, sweeps=SWEEPS, period_ns=PERIOD_NS):
    """Messages whose points have the times that `tell(number, header_ns)` returns."""
    for number in range(sweeps):
        header_ns = start_ns + number * period_ns
        told = tell(number, header_ns)
        columns = {axis: values.astype(np.float32) for axis, values in xyz.items()}
        yield raw(cloud(header_ns, columns | {name: told}), CLOUD, header_ns + PERIOD_NS + 5_000_000)


def spoilt(values, where, by):
    values = values.copy()
    values[where] = by
    return values


def date_s(_, header_ns):
    return (header_ns + OFFSETS_NS) / 1e9


def since_header(_number, _header_ns):
    return OFFSETS_NS.astype(np.uint32)


def ends(result):
    return np.array([row["end_ns"] for row in result.index])


def begins(result):
    return np.array([row["start_ns"] for row in result.index])


def headers(start_ns=START_NS, sweeps=SWEEPS, period_ns=PERIOD_NS):
    return start_ns + np.arange(sweeps) * period_ns


def dropped(result):
    return result.summary["points"]["dropped"]


def untimed(result):
    assert set(dropped(result)) <= {"no usable time"}
    return dropped(result).get("no usable time", 0)


def assert_true(result, start_ns=START_NS, accuracy_ns=300):
    assert np.abs(begins(result) - headers(start_ns)).max() <= accuracy_ns
    assert np.abs(ends(result) - headers(start_ns) - LAST_NS).max() <= accuracy_ns


RANDOM = np.random.default_rng(4)
GARBAGE = {
    "zeros among dates in seconds": ("timestamp", lambda n, h: spoilt(date_s(n, h), FEW, 0.0)),
    "a single zero": ("timestamp", lambda n, h: spoilt(date_s(n, h), [3], 0.0)),
    "no numbers": ("timestamp", lambda n, h: spoilt(date_s(n, h), FEW, np.nan)),
    "infinite": ("timestamp", lambda n, h: spoilt(date_s(n, h), FEW, np.inf)),
    "huge": ("timestamp", lambda n, h: spoilt(date_s(n, h), FEW, -1.7e308)),
    "zeros among dates in nanoseconds": (
        "timestamp",
        lambda _, h: spoilt((h + OFFSETS_NS).astype(np.uint64), FEW, 0),
    ),
    "dates of 2554": ("timestamp", lambda _, h: spoilt((h + OFFSETS_NS).astype(np.uint64), FEW, 2**64 - 1)),
    "3.6 s in the first sweep": ("t", lambda n, h: spoilt(since_header(n, h), FEW, 3_604_361_924) if n == 0 else since_header(n, h)),
    "1.1 s in three sweeps": ("t", lambda n, h: spoilt(since_header(n, h), FEW, 1_100_000_000) if 1 < n < 5 else since_header(n, h)),
    "1.1 s in all": ("t", lambda n, h: spoilt(since_header(n, h), FEW, 1_100_000_000)),
    "anything": ("t", lambda n, h: spoilt(since_header(n, h), FEW, RANDOM.integers(0.4e9, 2**32, len(FEW)))),
    "anything near": ("t", lambda n, h: spoilt(since_header(n, h), FEW, RANDOM.integers(0.25e9, 2e9, len(FEW)))),
    "zeros since boot": ("timestamp", lambda n, _: spoilt(3298.3 + n / 10 + OFFSETS_NS / 1e9, FEW, 0.0)),
}  # fmt: skip


@pytest.mark.parametrize("deskew", [False, True])
@pytest.mark.parametrize("kind", GARBAGE)
def test_the_few_times_that_are_garbage_are_lost_and_counted(run, kind, deskew):
    name, tell = GARBAGE[kind]
    asked = request(lidar(header_stamp_is="start", deskew=deskew), CLOUD)
    result = run(asked, turns(tell, name=name), driving(SPEED_MPS))
    assert_true(result)
    sweeps = {"3.6 s in the first sweep": 1, "1.1 s in three sweeps": 3}.get(kind, SWEEPS)
    assert untimed(result) == sweeps * (1 if kind == "a single zero" else len(FEW))
    # Where the lidar saw them, and from its place at the end: it is nearer to what lies ahead.
    if deskew:
        moved_m = (LAST_NS - OFFSETS_NS) / 1e9 * SPEED_MPS
        truth = XYZ["x"] - moved_m
        if kind == "a single zero":
            truth = np.delete(truth, 3)
        elif result.index[2]["points"] < NUMBER:
            truth = np.delete(truth, FEW)
        assert np.abs(result.points(2)[:, 0] - truth).max() < 1e-5


UPTIMES_S = (0.0, 1.0, 50.0, 3298.37, 10_000.0, 9.3e4, 1.1e6, 3.1e7)
COARSE_S = 2e4  # single precision is too coarse by then


@pytest.mark.parametrize(
    ("kind", "uptime_s"),
    [
        (kind, uptime_s)
        for kind in ("f8 s", "f8 ms", "f8 us", "f8 ns", "u8 ns", "f4 s")
        for uptime_s in UPTIMES_S
        if kind != "f4 s" or uptime_s < COARSE_S
    ],
)
def test_time_since_boot_keeps_its_differences(run, kind, uptime_s):
    number_type, unit = kind.split()
    unit_ns = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1}[unit]

    def tell(_number, header_ns):
        since_boot_ns = round(uptime_s * 1e9) + (header_ns - START_NS) + OFFSETS_NS
        return (since_boot_ns / unit_ns).astype(number_type)

    result = run(request(lidar(header_stamp_is="start"), CLOUD), turns(tell))
    assert_true(result, accuracy_ns=1_000_000 if number_type == "f4" else 300)


@pytest.mark.parametrize(
    ("kind", "start_ns"),
    [
        (kind, start_ns)
        for kind in ("f8 s", "f4 s", "u8 ns", "u4 ns", "f8 ms")
        for start_ns in (0, 20_000_000, 1_900_000_000, 47_000_000_000)
        if kind != "u4 ns" or start_ns < 2**31
    ],
)
def test_the_clock_of_a_simulator_starts_at_zero_for_headers_and_points(run, kind, start_ns):
    number_type, unit = kind.split()
    unit_ns = {"s": 1e9, "ms": 1e6, "ns": 1}[unit]
    if number_type == "u4" and start_ns > 2**31:
        pytest.skip("such times do not fit")

    def tell(_number, header_ns):
        return ((header_ns + OFFSETS_NS) / unit_ns).astype(number_type)

    result = run(request(lidar(), CLOUD), turns(tell, start_ns=start_ns))
    assert_true(result, start_ns, accuracy_ns=10_000 if number_type == "f4" else 300)


@pytest.mark.parametrize("start_ns", [400_000_000, 1_900_000_000])
def test_a_single_cloud_of_a_simulator_is_in_time(run, start_ns):
    result = run(
        request(lidar(), CLOUD), turns(lambda _, h: (h + OFFSETS_NS) / 1e9, start_ns=start_ns, sweeps=1)
    )
    assert result.index[0]["end_ns"] == start_ns + LAST_NS
    result = run(request(lidar(), CLOUD), turns(lambda *_: OFFSETS_NS / 1e9, start_ns=start_ns, sweeps=1))
    assert result.index[0]["end_ns"] == start_ns + LAST_NS


def test_relative_times_of_a_simulator_are_relative(run):
    result = run(request(lidar(), CLOUD), turns(lambda *_: OFFSETS_NS / 1e9, start_ns=0))
    assert_true(result, 0)


def test_headers_without_stamps_are_no_clock(run):
    """They are zero; a clock of points that starts at zero is not theirs."""

    def without_stamps(messages):
        for message in messages:
            message.data.message.header.stamp.sec = message.data.message.header.stamp.nanosec = 0
            yield message

    tell = lambda n, _: n / 10 + OFFSETS_NS / 1e9
    result = run(request(lidar(header_stamp_is="start"), CLOUD, clock="log"), without_stamps(turns(tell)))
    assert np.abs(begins(result) - headers() - PERIOD_NS - 5_000_000).max() <= 300


# --- what looks like garbage and is none -----


def test_clean_clouds_keep_every_point(run):
    for name, tell in (("timestamp", date_s), ("t", since_header)):
        result = run(request(lidar(), CLOUD), turns(tell, name=name))
        assert_true(result)
        assert result.summary["points"]["written"] == SWEEPS * NUMBER


@pytest.mark.parametrize("share", [1 / NUMBER, 0.3, 0.7])
def test_genuine_zeros_of_relative_times_are_times(run, share):
    zeros = np.arange(NUMBER) < share * NUMBER
    result = run(request(lidar(), CLOUD), turns(lambda n, h: spoilt(since_header(n, h), zeros, 0), name="t"))
    assert_true(result)
    assert untimed(result) == 0


@pytest.mark.parametrize(
    ("first_s", "then_s"), [(0.1, 0.2), (0.2, 0.1), (0.05, 0.2), (0.1, 0.15), (0.1, 0.17)]
)
def test_a_lidar_that_turns_slower_or_faster_loses_nothing(run, first_s, then_s):
    lasts_s = [first_s] * 6 + [then_s] * 4
    stamps_ns = START_NS + np.round(np.cumsum([0, *lasts_s[:-1]]) * 1e9).astype(np.int64)
    messages = [
        raw(cloud(int(stamp), {a: v.astype(np.float32) for a, v in XYZ.items()} | {"t": (OFFSETS_NS * (s / 0.1)).astype(np.uint32)}), CLOUD, int(stamp))
        for stamp, s in zip(stamps_ns, lasts_s, strict=True)
    ]  # fmt: skip
    result = run(request(lidar(), CLOUD), messages)
    assert untimed(result) == 0
    assert np.abs(ends(result) - stamps_ns - np.round(LAST_NS * np.array(lasts_s) / 0.1)).max() <= 2


def test_sweeps_of_which_most_points_come_at_once_lose_nothing(run):
    """A wall near by fills one twentieth of the turn; the sky has few points."""
    offsets = np.sort(np.r_[np.linspace(0.04, 0.045, NUMBER - 20), np.linspace(0.0, 0.0998, 20)])
    result = run(request(lidar(), CLOUD), turns(lambda *_: offsets.astype(np.float32), name="time"))
    assert untimed(result) == 0
    assert np.abs(ends(result) - headers() - 99_800_000).max() <= 5


@pytest.mark.parametrize("number", [1, 2, 3, 10])
def test_a_sensor_with_few_points_keeps_them(run, number):
    xyz = {axis: values[:number] for axis, values in XYZ.items()}
    pick = np.random.default_rng(number)
    told = [np.sort(pick.choice(OFFSETS_NS, number, replace=False)) for _ in range(30)]
    tell = lambda n, _: told[n].astype(np.uint32)
    result = run(request(lidar(), CLOUD), turns(tell, name="t", xyz=xyz, sweeps=30))
    assert untimed(result) == 0
    if number > 1:
        assert np.array_equal(ends(result), headers(sweeps=30) + [times.max() for times in told])


def test_a_clock_that_is_set_while_recording_moves_no_sweep(run):
    """Before it hears of the time, the lidar counts from boot; then it tells the date."""
    tell = lambda n, h: date_s(n, h) if n > 3 else 77.0 + n / 10 + OFFSETS_NS / 1e9
    assert_true(run(request(lidar(header_stamp_is="start"), CLOUD), turns(tell)))


@pytest.mark.parametrize("offset_s", [-37.0, 18.0])
def test_a_clock_of_another_time_scale_agrees_with_the_headers(run, offset_s):
    """TAI is 37 s ahead of UTC, GPS time 18 s."""
    tell = lambda n, h: date_s(n, h) + offset_s
    assert_true(run(request(lidar(header_stamp_is="start"), CLOUD), turns(tell)))


@pytest.mark.parametrize("number", [0, 1])
def test_clouds_without_points_tell_nothing(run, number):
    """A lidar that takes seconds to start sends some."""
    few = list(
        turns(
            lambda n, h: since_header(n, h)[:number],
            name="t",
            xyz={a: v[:number] for a, v in XYZ.items()},
            sweeps=40,
        )
    )
    messages = [*few, *list(turns(since_header, name="t", sweeps=50))[40:]]
    result = run(request(lidar(), CLOUD), messages)
    assert np.abs(ends(result)[-10:] - headers(sweeps=50)[40:] - LAST_NS).max() <= 1


def test_times_that_are_not_set_at_first_are_used_later(run):
    tell = lambda n, h: since_header(n, h) * np.uint32(n > 6)
    result = run(request(lidar(), CLOUD), turns(tell, name="t", sweeps=30))
    assert np.abs(ends(result) - headers(sweeps=30) - LAST_NS * (np.arange(30) > 6)).max() <= 1


def test_clouds_that_start_in_a_burst_are_no_question(run):
    """The host stamps what waited while the driver started."""
    told = OFFSETS_NS / 1e9
    stamps = [START_NS + n * 1_000_000 if n < 6 else START_NS + n * PERIOD_NS for n in range(30)]
    messages = [
        raw(cloud(s, {a: v.astype(np.float32) for a, v in XYZ.items()} | {"time": told}), CLOUD, s)
        for s in stamps
    ]
    result = run(request(lidar(), CLOUD), messages)
    assert np.abs(ends(result) - stamps - LAST_NS).max() <= 1
    assert untimed(result) == 0


def test_a_count_that_overflows_costs_a_part_of_one_cloud(run):
    """Nanoseconds in 32 bits start again after 4.3 s."""
    tell = lambda n, _: ((2**32 - 160_000_000 + n * PERIOD_NS + OFFSETS_NS) % 2**32).astype(np.uint32)
    result = run(request(lidar(header_stamp_is="start"), CLOUD), turns(tell, name="t", sweeps=30))
    exact = np.delete(np.arange(30), 1)
    assert np.abs(ends(result) - headers(sweeps=30) - LAST_NS)[exact].max() <= 1
    assert 0.35 * NUMBER < untimed(result) < 0.45 * NUMBER


def test_a_cloud_whose_points_have_one_time_is_in_time(run):
    """One column was received of it; with deskewing the recording failed."""
    tell = lambda n, h: np.full(NUMBER, 40_000_000, np.uint32) if n == 6 else since_header(n, h)
    result = run(request(lidar(deskew=True), CLOUD), turns(tell, name="t"), driving(SPEED_MPS))
    assert ends(result)[6] == begins(result)[6] == headers()[6] + 40_000_000


# --- what cannot be used, and what is not sure -----


def test_a_cloud_whose_times_do_not_agree_is_lost(run):
    wild = np.arange(NUMBER, dtype=np.uint32) * 7_000_000
    tell = lambda n, h: wild if n == 6 else since_header(n, h)
    result = run(request(lidar(), CLOUD, limit=0.2), turns(tell, name="t"))
    assert result.lost == {"the times of its points do not agree": 1}
    with pytest.raises(LossLimitError, match="the times of its points do not agree"):
        run(request(lidar(), CLOUD), turns(tell, name="t"))


def test_a_cloud_all_of_whose_times_are_garbage_is_lost(run):
    tell = lambda n, h: since_header(n, h) + np.uint32(3_500_000_000 if n == 0 else 0)
    result = run(request(lidar(), CLOUD, limit=0.2), turns(tell, name="t"))
    assert result.lost == {
        "the times of its points do not count from its stamp as those of other clouds do": 1
    }


UNUSABLE = {
    "no cloud has two of them": lambda *_: OFFSETS_NS / 1e9 * np.nan,
    "they are later than any date": lambda *_: 1e10 + OFFSETS_NS / 1e9,
    "they do not differ": lambda *_: np.zeros(NUMBER),
    "those of one cloud spread over more than two seconds": lambda *_: (
        np.arange(NUMBER, dtype=np.uint32) * 7_000_000
    ),
    "they are too large for single precision": lambda n, h: (
        date_s(n, h).astype(np.float32) + np.float32(128) * (np.arange(NUMBER) % 2).astype(np.float32)
    ),
}


@pytest.mark.parametrize("problem", UNUSABLE)
def test_times_that_cannot_be_used_are_not_said_to_be_missing(run, problem):
    result = run(request(lidar(), CLOUD), turns(UNUSABLE[problem]))
    assert np.array_equal(ends(result), headers())
    assert result.summary["points"]["written"] == SWEEPS * NUMBER
    with pytest.raises(RecipeError, match=f"have times that cannot be used, as {problem}, so they cannot"):
        run(request(lidar(deskew=True), CLOUD), turns(UNUSABLE[problem]), driving(SPEED_MPS))


def test_what_the_recipe_says_of_times_that_cannot_be_used_is_refused(run):
    said = {"unit": "ns", "since": "header"}
    with pytest.raises(
        RecipeError, match=r"point_times says what the times .* cannot be used, as they do not differ; "
    ):
        run(request(lidar(point_times=said), CLOUD), turns(UNUSABLE["they do not differ"]))


DOUBTFUL = {
    "8% of them lie apart": ("t", lambda n, h: spoilt(since_header(n, h), np.arange(48) * 10, 1_500_000_000)),
    "they last 1.9 s a cloud, but clouds come every 0.1 s": ("t", lambda n, h: spoilt(since_header(n, h), np.arange(60) * 10, 1_500_000_000)),
    "they last 0.0001 s a cloud as nanoseconds, and 0.1 s as microseconds": ("t", lambda *_: (OFFSETS_NS // 1000).astype(np.uint32)),
    "they last 1.5 s a cloud, but clouds come every 0.1 s": ("time", lambda *_: (OFFSETS_NS / LAST_NS * 1.5).astype(np.float32)),
    "they last 0.4 s a cloud, but clouds come every 0.1 s": ("time", lambda *_: OFFSETS_NS / 1e9 * 4),
}  # fmt: skip


@pytest.mark.parametrize("doubt", DOUBTFUL)
def test_what_is_not_sure_is_asked(run, doubt):
    name, tell = DOUBTFUL[doubt]
    with pytest.raises(
        RecipeError,
        match=f"not sure what the times of the points of /sensor are: {doubt}.*; say it in point_times",
    ):
        run(request(lidar(), CLOUD), turns(tell, name=name))


def test_more_than_a_few_that_are_garbage_later_are_asked_for(run):
    """In the first clouds all was well."""
    tell = lambda n, h: (
        spoilt(since_header(n, h), np.arange(200), 1_500_000_000) if n > 25 else since_header(n, h)
    )
    with pytest.raises(RecipeError, match=r"not sure .*: 6% of them lie apart"):
        run(request(lidar(), CLOUD), turns(tell, name="t", sweeps=32))
    told = lidar(point_times={"unit": "ns", "since": "header"})
    assert untimed(run(request(told, CLOUD), turns(tell, name="t", sweeps=32))) == 1200


def test_the_recipe_says_what_times_are(run):
    name, tell = DOUBTFUL["they last 0.0001 s a cloud as nanoseconds, and 0.1 s as microseconds"]
    told = lidar(point_times={"unit": "us", "since": "header"})
    assert_true(run(request(told, CLOUD), turns(tell, name=name)), accuracy_ns=1000)
    told = lidar(point_times={"unit": "ns", "since": "header"})
    assert np.array_equal(
        ends(run(request(told, CLOUD), turns(tell, name=name))), headers() + LAST_NS // 1000
    )
    ignored = run(request(lidar(point_times="ignore"), CLOUD), turns(tell, name=name))
    assert np.array_equal(ends(ignored), headers())
    clock = lidar(point_times={"unit": "s", "since": "clock"}, header_stamp_is="start")
    assert_true(run(request(clock, CLOUD), turns(lambda *_: 0.3 + OFFSETS_NS / 1e9)))
