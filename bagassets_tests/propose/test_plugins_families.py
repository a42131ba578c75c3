"""Decoder plug-ins of every family: through their steps, checked, and in proposals."""

import sys

import numpy as np
import pytest

from bagassets.assets.ego_poses import load_trajectory
from bagassets_tests.plugin_build import build, channel, project
from bagassets_tests.plugin_drive import write_recording
from bagassets_tests.plugin_install import Site
from bagassets_tests.small_drive import START_NS

FIRST_NS = START_NS + 12_000_000
MESSAGES = 19


@pytest.fixture
def site(monkeypatch, tmp_path):
    site = Site(monkeypatch, tmp_path / "site-packages")
    yield site
    site.close()


FAMILIES = """
import math
import numpy as np
from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.fields import stamp_and_frame, stamp_ns
from bagassets.decode.model import BoxReading, CloudReading, PoseReading, RadarReading
from bagassets.base.errors import DecodeError
from bagassets.geometry.se3 import SE3

def cloud(message):
    stamp, frame = stamp_and_frame(message.header)
    points = np.zeros((len(message.x), 5), np.float32)
    points[:, 0], points[:, 1] = message.x, message.y
    return CloudReading(stamp, frame, points, None)

def radar(message):
    none = np.zeros(len(message.range_m))
    return RadarReading(stamp_ns(message.time), "radar", {"x": message.range_m.copy(), "y": none, "z": none})

def pose(message):
    half = message.heading_rad / 2
    turn = (math.cos(half), 0.0, 0.0, math.sin(half))
    return PoseReading(stamp_ns(message.time), "map", "", SE3(turn, (message.east_m, 0.0, 0.0)))

def one(message, item):
    kind, x = item
    if kind == "nothing":
        return None
    if kind == "broken":
        raise DecodeError("its kind is broken")
    stamp, frame = stamp_and_frame(message.header)
    return BoxReading(stamp, frame, SE3((1.0, 0.0, 0.0, 0.0), (x, 0.0, 0.0)), (1.0, 2.0, 3.0), kind, kind)

boxes = BoxDecoder(lambda message: zip(message.kinds, message.x), one)
"""  # fmt: skip
FAMILY_RECIPE = """
name: plugins
bags: {root: bags, settle_s: 0}
limits: {lost_messages: 0.5}
rigs:
  - name: car
    ego_pose: {source: pose, topic: /fix}
    annotations: [{topic: /things}]
    channels:
      CAM_FRONT: {modality: camera, topic: /cam/image_raw}
      LIDAR_TOP: {modality: lidar, topic: /scan}
      RADAR_FRONT: {modality: radar, topic: /targets, frame: lidar}
"""


def scan(kit, stamp_ns, _number):
    x, y = np.array([1, 2, 3], np.float32), np.array([4, 5, 6], np.float32)
    return kit.make("acme_msgs/msg/Scan", header=kit.header(stamp_ns, "lidar"), x=x, y=y)


def targets(kit, stamp_ns, number):
    return kit.make(
        "acme_msgs/msg/Targets",
        time=kit.time(stamp_ns),
        range_m=np.array([20.0, 30.0 + number]),
        speed_mps=np.zeros(2),
    )


def fix(kit, stamp_ns, number):
    return kit.make("acme_msgs/msg/Fix", time=kit.time(stamp_ns), east_m=0.5 * number, heading_rad=0.0)


def things(kit, stamp_ns, number):
    return kit.make(
        "acme_msgs/msg/Things",
        header=kit.header(stamp_ns, "base_link"),
        kinds=["car", "nothing", "broken"],
        x=np.array([10.0, 0.0, 0.0]),
    )


EXTRA = (
    ("/scan", "acme_msgs/msg/Scan", scan),
    ("/targets", "acme_msgs/msg/Targets", targets),
    ("/fix", "acme_msgs/msg/Fix", fix),
    ("/things", "acme_msgs/msg/Things", things),
)
POINTS = {
    "cloud__acme_msgs__Scan": "cloud",
    "radar__acme_msgs__Targets": "radar",
    "pose__acme_msgs__Fix": "pose",
    "boxes__acme_msgs__Things": "boxes",
}


@pytest.fixture(scope="module")
def family_recording(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("families") / "drive", EXTRA)


def test_every_family_goes_through_its_step(tmp_path, site, family_recording):
    site.install("families", "1.0", FAMILIES, **POINTS)
    recipe = project(tmp_path / "project", family_recording, FAMILY_RECIPE)
    made, errors = build(recipe)
    assert errors == {}

    _, lidar = channel(recipe, made, "sweeps", "LIDAR_TOP")
    stamp_ns = lidar.read_table("index.parquet")["stamp_ns"].to_pylist()[0]
    points = np.frombuffer(lidar.path(f"{stamp_ns}.pcd.bin").read_bytes(), np.float32).reshape(-1, 5)
    assert points[:, :2].tolist() == [[1, 4], [2, 5], [3, 6]]
    assert stamp_ns == FIRST_NS  # as recorded: neither the points nor the recipe tell more

    entry, radar = channel(recipe, made, "sweeps", "RADAR_FRONT")
    assert entry["counts"]["written"] == MESSAGES
    assert radar.read_table("index.parquet")["stamp_ns"].to_pylist()[0] == FIRST_NS
    assert radar.read_table("index.parquet")["points"].to_pylist() == [2] * MESSAGES

    poses = load_trajectory(made["ego_poses"].artifact)
    positions, _, valid = poses.at(np.array([FIRST_NS + 50_000_000]))
    assert valid.all()
    assert positions[0].tolist() == pytest.approx([0.25, 0.0, 0.0], abs=1e-9)

    boxes = made["annotations"].artifact
    table = boxes.read_table("annotations.parquet")
    assert table["category"].to_pylist() == ["car"] * MESSAGES
    assert table["x"].to_pylist() == pytest.approx([10.0 + 0.5 * number for number in range(MESSAGES)])
    counts = boxes.read_json("annotations.json")["counts"]["/things"]
    boxes = counts["boxes"]
    assert (boxes["read"], boxes["written"]) == (2 * MESSAGES, MESSAGES)
    assert boxes["lost"] == {"its kind is broken": MESSAGES}
    assert counts["ignored"] == MESSAGES


def test_an_upgrade_of_one_family_leaves_the_assets_of_the_others_alone(tmp_path, site, family_recording):
    site.install("families", "1.0", FAMILIES, **POINTS)
    recipe = project(tmp_path / "project", family_recording, FAMILY_RECIPE)
    build(recipe)
    rest = {name: value for name, value in POINTS.items() if value != "radar"}
    site.install("families", "1.0", FAMILIES, **rest)
    site.install("radar_family", "1.0", FAMILIES, radar__acme_msgs__Targets="radar")
    made, errors = build(recipe)
    assert errors == {}
    assert {asset for asset, result in made.items() if not result.cached} == {"sweeps"}


def test_azimuths_of_a_radar_that_a_plugin_decodes_are_not_the_recipes_business(
    tmp_path, site, family_recording
):
    site.install("families", "1.0", FAMILIES, **POINTS)
    text = FAMILY_RECIPE.replace("topic: /targets,", "topic: /targets, azimuth_positive: left,")
    _, errors = build(project(tmp_path / "project", family_recording, text))
    assert "azimuth_positive has no effect on /targets" in errors["sweeps"]


@pytest.mark.parametrize(
    ("point", "code", "asset", "words"),
    [
        ("cloud__acme_msgs__Scan", "lambda m: CloudReading(1, '', np.zeros((2, 4), np.float32), None)", "sweeps", "points are not (N, 5) float32"),
        ("cloud__acme_msgs__Scan", "lambda m: CloudReading(0, '', np.zeros((2, 5), np.float32), None)", "sweeps", "its header has no stamp"),
        ("cloud__acme_msgs__Scan", "lambda m: CloudReading(1, '', np.zeros((2, 5), np.float32), np.zeros(3, np.int64))", "sweeps", "times_ns are not (N,) int64"),
        ("radar__acme_msgs__Targets", "lambda m: RadarReading(1, '', {'x': np.zeros(1)})", "sweeps", "targets lack x, y or z"),
        ("pose__acme_msgs__Fix", "lambda m: m.time", "ego_poses", "not PoseReading"),
        ("pose__acme_msgs__Fix", "lambda m: PoseReading(1, 'map', '', None)", "ego_poses", "parent_SE3_child is no SE3"),
        ("boxes__acme_msgs__Things", "BoxDecoder(lambda m: [1], lambda m, i: i)", "annotations", "not BoxReading"),
        ("boxes__acme_msgs__Things", "BoxDecoder(lambda m: [1], lambda m, i: BoxReading(1, 'map', SE3(), (1, 2, 3), '', 'car'))", "annotations", "size_m is not three floats"),
        ("boxes__acme_msgs__Things", "lambda m: []", "annotations", "families:boxes is not a BoxDecoder"),
        ("boxes__acme_msgs__Things", "BoxDecoder(lambda m: m.gone, None)", "annotations", "raised AttributeError"),
    ],
)  # fmt: skip
def test_readings_of_every_family_are_checked(tmp_path, site, family_recording, point, code, asset, words):
    name = POINTS[point]
    site.install("families", "1.0", f"{FAMILIES}\n{name} = {code}\n", **POINTS)
    recipe = project(tmp_path / "project", family_recording, FAMILY_RECIPE)
    made, errors = build(recipe)
    if asset in made:  # single boxes that are bad are counted, as the recipe says
        assert words in str(made[asset].artifact.summary()["counts"]["/things"]["boxes"]["lost"])
        assert made[asset].artifact.summary()["boxes"] == 0
    else:
        assert words in errors[asset]


def test_a_proposed_recipe_takes_topics_that_plugins_decode(tmp_path, site, family_recording):
    from bagassets.propose.poses import propose_pose
    from bagassets.propose.rigs import boxes_in
    from bagassets.propose.scan import scan_recording
    from bagassets.propose.sensors import modality_of
    from bagassets.recordings.open import open_recording

    with open_recording(family_recording) as recording:
        seen = scan_recording(recording)
    topics = {name: topic for name, topic in seen.topics.items() if name != "/odom"}
    assert modality_of(topics["/scan"]) is None
    site.install("families", "1.0", FAMILIES, **POINTS)
    assert modality_of(topics["/scan"]) == "lidar"
    assert modality_of(topics["/targets"]) == "radar"
    assert boxes_in(seen) == ["/things"]
    without_odometry = type(seen)(topics, seen.transforms, seen.moving)
    assert propose_pose(without_odometry, "base_link").fields == {"source": "pose", "topic": "/fix"}
    assert "families" not in sys.modules


DEEP = """
import numpy as np
from bagassets.decode.model import ImageReading

def deep(message):
    return ImageReading(1, "behind", np.zeros((4, 4), np.uint16), None, "mono16")

def blind(message):
    return message.no_such_field
"""


def test_proposals_look_through_plugins(tmp_path, site):
    from bagassets.propose.scan import scan_recording
    from bagassets.recordings.open import open_recording

    recording = write_recording(tmp_path / "drive")
    site.install("deep", "1.0", DEEP, image__acme_msgs__RawFrame="deep")
    with open_recording(recording) as opened:
        seen = scan_recording(opened).topics["/acme"]
    assert (seen.is_16_bit, seen.encoding, seen.refusal) == (True, "mono16", None)
    assert "behind" in seen.frames
    site.install("deep", "1.1", DEEP, image__acme_msgs__RawFrame="blind")
    with open_recording(recording) as opened:
        refusal = scan_recording(opened).topics["/acme"].refusal
    assert refusal.startswith("decoder image.acme_msgs.RawFrame of deep 1.1 raised AttributeError at deep.py")
    site.install("deep", "1.2", "import nothing_of_this_name", image__acme_msgs__RawFrame="deep")
    with open_recording(recording) as opened:
        assert "deep:deep cannot be loaded" in scan_recording(opened).topics["/acme"].refusal
