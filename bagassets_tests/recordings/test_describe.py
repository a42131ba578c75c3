import pytest

from bagassets.recordings.describe import describe_inventory


def topic(name="/imu", **changes):
    return {
        "name": name, "type": "sensor_msgs/msg/Imu", "count": 100, "rate_hz": 99.5, "max_gap_s": 0.25,
        "header_offset_s": {"min": -0.1, "median": -0.0125, "max": 0.0}, "frame_ids": ["imu_link"],
        "problem": None,
    } | changes  # fmt: skip


def inventory(topics, **changes):
    return {
        "format": "ros1", "size": 1_234_567, "start_ns": 1_700_000_000_123_000_000,
        "end_ns": 1_700_000_021_823_000_000, "duration_s": 21.7, "topics": topics, "gnss": None,
        "daylight": None, "notes": [],
    } | changes  # fmt: skip


def test_header_and_table():
    text = describe_inventory(
        inventory(
            [topic(), topic("/lidar/points", rate_hz=None, max_gap_s=None, header_offset_s=None, count=1)],
            gnss={
                "first": {"lat": 48.1, "lon": 11.5, "alt": 545.25, "stamp_ns": 0},
                "last": {"lat": 48.2, "lon": 11.6, "alt": None, "stamp_ns": 1},
            },
            daylight="day",
            notes=["/imu: something is unusual."],
        )
    )
    assert text == (
        "format    ROS 1 bag\n"
        "size      1.2 MB\n"
        "span      2023-11-14 22:13:20.123Z to 2023-11-14 22:13:41.823Z\n"
        "duration  21.700 s\n"
        "messages  101 on 2 topics\n"
        "GNSS      first 48.100000, 11.500000, 545.2 m; last 48.200000, 11.600000\n"
        "daylight  day\n"
        "\n"
        "topic          type                 count     Hz  max gap  clock offset  frames\n"
        "/imu           sensor_msgs/msg/Imu    100  99.50  0.250 s      -0.013 s  imu_link\n"
        "/lidar/points  sensor_msgs/msg/Imu      1      -        -             -  imu_link\n"
        "\n"
        "note: /imu: something is unusual.\n"
    ).replace("-0.013", f"{-0.0125:+.3f}")


def test_daylight_that_is_not_known_says_why():
    place = {"lat": 48.1, "lon": 11.5, "alt": 545.25, "stamp_ns": 0}
    assert "daylight  unknown (no GNSS)\n" in describe_inventory(inventory([]))
    known = inventory([], gnss={"first": place, "last": place})
    assert "daylight  unknown (the time of the first fix is not set)\n" in describe_inventory(known)


def test_problems_get_a_column_only_if_there_are_any():
    assert "problem" not in describe_inventory(inventory([topic()]))
    lines = describe_inventory(inventory([topic(), topic("/x", problem="no definition")])).splitlines()
    assert lines[-3].endswith("problem")
    assert lines[-1].endswith("no definition")


def test_what_bytes_that_are_no_header_say_is_not_shown():
    cut = topic("/x", problem="its messages do not fit", frame_ids=["%&B0\x00", "]"])
    assert describe_inventory(inventory([cut])).splitlines()[-1].split() == [
        "/x", "sensor_msgs/msg/Imu", "100", "99.50", "0.250", "s", "-", "-", "its", "messages", "do", "not", "fit",
    ]  # fmt: skip
    known = topic("/x", problem="no definition")
    assert "imu_link" in describe_inventory(inventory([known]))


def test_empty_recording():
    text = describe_inventory(inventory([], start_ns=None, end_ns=None, duration_s=0.0))
    assert "span      no messages" in text
    assert "duration" not in text
    assert "messages  0 on 0 topics" in text


@pytest.mark.parametrize(
    ("size", "shown"),
    [(0, "0 B"), (999, "999 B"), (1000, "1.0 kB"), (999_999, "1.0 MB"), (5 * 10**12, "5.0 TB")],
)
def test_sizes(size, shown):
    assert f"size      {shown}\n" in describe_inventory(inventory([], size=size))


def test_a_time_out_of_range_stays_a_number():
    assert f"to {2**62 * 256} ns" in describe_inventory(inventory([topic()], end_ns=2**62 * 256))


def test_escape_sequences_of_a_recording_do_not_reach_the_terminal():
    text = describe_inventory(inventory([topic(frame_ids=["\x1b[31mred\nline"])]))
    assert "\x1b" not in text
    assert "line\n" in text.split("red")[1]
