"""Livox's own messages: the points that were put in, with their times, whichever driver and format they are of."""

from dataclasses import dataclass

import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import check_points
from bagassets.decode.livox import decode_livox
from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.recipe import load_recipe
from bagassets.recordings.open import open_recording
from bagassets.store.store import Store
from bagassets_tests.fuzz.decoders import RECORDED_TEXTS
from bagassets_tests.sample_drives import build_recordings
from bagassets_tests.small_drive import LATENCY_NS, RECIPE, STORE1, messages, write_messages
from bagassets_tests.sweep_data import Header, header

STAMP_NS = 1_700_000_000_000_000_000


@dataclass
class CustomPoint:
    offset_time: int
    x: float
    y: float
    z: float
    reflectivity: int = 9
    tag: int = 16
    line: int = 3


@dataclass
class CustomMsg:
    header: Header
    points: list[CustomPoint]
    point_num: int


def livox(*points, number=None):
    return CustomMsg(header(STAMP_NS), list(points), len(points) if number is None else number)


def test_points_are_those_that_were_put_in():
    reading = decode_livox(livox(CustomPoint(0, 1, 2, 3), CustomPoint(99_000_001, -4, 5.5, 6, 255, 0, 1)))
    np.testing.assert_array_equal(reading.points, np.float32([[1, 2, 3, 9, 3], [-4, 5.5, 6, 255, 1]]))
    assert reading.times_ns.tolist() == [STAMP_NS, STAMP_NS + 99_000_001]
    assert (reading.stamp_ns, reading.frame_id, reading.dropped) == (STAMP_NS, "lidar", 0)
    assert reading.span_ns == (STAMP_NS, STAMP_NS + 99_000_001)


@pytest.mark.parametrize(
    ("moment", "first_ns"), [("start", 0), ("middle", -50_000_000), ("end", -100_000_000)]
)
def test_the_recipe_may_say_what_the_stamp_means(moment, first_ns):
    reading = decode_livox(livox(CustomPoint(0, 1, 2, 3), CustomPoint(100_000_000, 1, 2, 3)), moment)
    assert reading.times_ns.tolist() == [STAMP_NS + first_ns, STAMP_NS + first_ns + 100_000_000]


def test_the_span_is_that_of_all_shots_and_what_is_not_finite_is_counted():
    nowhere = CustomPoint(200, float("nan"), 0, 0)
    reading = decode_livox(livox(CustomPoint(100, 1, 2, 3), nowhere))
    assert (len(reading.points), reading.dropped) == (1, 1)
    assert reading.span_ns == (STAMP_NS + 100, STAMP_NS + 200)
    assert decode_livox(livox(nowhere)).span_ns == (STAMP_NS + 200, STAMP_NS + 200)
    empty = decode_livox(livox())
    assert (len(empty.points), empty.times_ns, empty.dropped) == (0, None, 0)


def test_what_contradicts_itself_is_refused():
    with pytest.raises(DecodeError, match="another number of points than point_num says"):
        decode_livox(livox(CustomPoint(0, 1, 2, 3), number=2))
    with pytest.raises(DecodeError, match="its points have no field offset_time"):
        decode_livox(livox(header(0)))
    with pytest.raises(DecodeError, match=r"more points than limits\.cloud_points"):
        check_points(livox(CustomPoint(0, 1, 2, 3), CustomPoint(0, 1, 2, 3)), 1)


def write_livox(path, file_format, package):
    """Write the small drive with clouds of a Livox, in which each point was seen 1 ms after the one before."""
    is_ros1, custom = file_format == "ros1", f"{package}/msg/CustomMsg"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    store.register(STORE1.fielddefs if is_ros1 else {})
    store.register(get_types_from_msg(RECORDED_TEXTS[custom], custom))
    message_type, point = store.types[custom], store.types[f"{package}/msg/CustomPoint"]

    def items():
        for topic, msgtype, stamp_ns, message in messages(store, ros1=is_ros1):
            if topic == "/points":
                rows = enumerate(message.data.view(np.float32).reshape(-1, 4).tolist())
                points = [point(n * 1_000_000, x, y, z, int(seen), 0, 0) for n, (x, y, z, seen) in rows]
                made = message_type(message.header, stamp_ns, len(points), 0, np.zeros(3, np.uint8), points)
                yield topic, custom, stamp_ns, stamp_ns + LATENCY_NS, made
            else:
                yield topic, msgtype, stamp_ns, stamp_ns + LATENCY_NS, message

    return write_messages(path, file_format, store, items())


def test_it_is_proposed_and_its_points_are_deskewed_by_their_times(tmp_path):
    summaries = {}
    for name, file_format, package in (
        ("a.mcap", "mcap", "livox_ros_driver2"),
        ("b.bag", "ros1", "livox_ros_driver"),
    ):
        path = write_livox(tmp_path / "bags" / name, file_format, package)
        with open_recording(path) as recording:
            summaries[path.name] = scan_recording(recording)
    text = propose_recipe(summaries, name="test", root="bags").text
    for rig in yaml.safe_load(text)["rigs"]:
        assert rig["channels"]["LIDAR_TOP"]["topic"] == "/points"
    text = RECIPE.format(name="test", root="bags").replace("topic: /points", "topic: /points, deskew: true")
    (tmp_path / "recipe.yaml").write_text(text)
    recipe = load_recipe(tmp_path / "recipe.yaml")
    clouds = {}
    for key, made in build_recordings(recipe).items():
        entry = made["sweeps"].artifact.read_json("channels.json")["LIDAR_TOP"]
        assert entry["counts"]["written"] == entry["counts"]["read"] == 29
        files = Store(recipe.store_path).artifact(entry["artifact"]).files
        clouds[key] = [path.read_bytes() for path in sorted(files.rglob("*.bin"))]
    assert clouds["a.mcap"] == clouds["b.bag"]
    points = np.frombuffer(clouds["a.mcap"][3], np.float32).reshape(-1, 5)
    # 8 m/s straight ahead: what was seen 5 m ahead 1 ms before the last shot is 8 mm nearer by then.
    before_s = (len(points) - 1 - np.arange(len(points))) * 1e-3
    np.testing.assert_allclose(points[:, 0], 5.0 - 8.0 * before_s, atol=2e-5)
    np.testing.assert_array_equal(points[:, 3], 10.0)
