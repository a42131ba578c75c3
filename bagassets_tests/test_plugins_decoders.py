"""Decoder plug-ins: installed, used, upgraded, clashing and broken."""

import json
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from bagassets.bags.digest import recording_digest, recording_stat
from bagassets.bags.discover import discover
from bagassets.decode.boxes import box_message_types
from bagassets.decode.clouds import CLOUD_DECODERS
from bagassets.engine.code_version import code_version
from bagassets.engine.recording_build import BuildFailure, RecordingBuild
from bagassets.errors import PluginError
from bagassets.forkserver import spec
from bagassets.nuscenes.check import check_dataset
from bagassets.plugins import BUILT_IN, installed_decoders
from bagassets.plugins import FAMILIES as FAMILY_NAMES
from bagassets.quick.build import code_stamp
from bagassets.recipe import load_recipe
from bagassets.steps import frames, pose_sources
from bagassets.steps.ego_poses import load_trajectory
from bagassets.steps.nuscenes_dataset import BagPart, assemble
from bagassets.store.store import Store
from bagassets_tests.plugin_drive import RECIPE, write_recording
from bagassets_tests.plugin_install import EXAMPLE, Site, pip_install, wheel_of
from bagassets_tests.small_drive import START_NS

FIRST_NS = START_NS + 12_000_000
MESSAGES = 19


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("recording") / "drive")


@pytest.fixture
def site(monkeypatch, tmp_path):
    site = Site(monkeypatch, tmp_path / "site-packages")
    yield site
    site.close()


def project(folder, recording, text=RECIPE):
    bags = folder / "bags"
    bags.mkdir(parents=True)
    (bags / "drive").symlink_to(recording)
    (folder / "recipe.yaml").write_text(text)
    return load_recipe(folder / "recipe.yaml")


def build(recipe, *, dry=False):
    """Return asset -> result, and asset -> error."""
    (found,) = discover(recipe.bags).found.values()
    digest, stat = recording_digest(found).digest, recording_stat(found)
    results = RecordingBuild(recipe, Store(recipe.store_path), found, digest, stat, dry=dry).build()
    made = {}
    try:
        for result in results:
            made[result.asset] = result
    except BuildFailure as failure:
        return made, {asset: str(err) for asset, err in failure.errors.items()}
    return made, {}


def channel(recipe, made, asset, name):
    entry = made[asset].artifact.read_json("channels.json")[name]
    return entry, Store(recipe.store_path).artifact(entry["artifact"])


# --- the worked example ------------------------------------------------------------------


def test_the_example_is_installed_by_pip_and_its_images_reach_the_dataset(tmp_path, site, recording):
    pip_install(wheel_of(EXAMPLE, tmp_path / "wheels"), site.folder)
    site._modules.add("acme_decoders")
    site.restart()
    assert [str(plugin) for plugin in installed_decoders().plugins] == [
        "decoder image.acme_msgs.RawFrame of acme-decoders 1.0"
    ]
    recipe = project(tmp_path / "project", recording)
    made, errors = build(recipe)
    assert errors == {}
    entry, images = channel(recipe, made, "frames", "CAM_ACME")
    assert entry["counts"] == {"read": MESSAGES, "written": MESSAGES, "merged": 0, "lost": {}}
    for number in (0, MESSAGES - 1):
        image = cv2.imread(str(images.path(f"{FIRST_NS + number * 100_000_000}.png")))
        assert image.shape == (8, 16, 3)
        assert image[2:-2, 2:-2].reshape(-1, 3).tolist() == [[10 + number, 100, 200]] * 48
    part = BagPart("drive", "drive", made["nuscenes_tables"].artifact.digest)
    assemble([part], recipe.nuscenes, Store(recipe.store_path), recipe.nuscenes.output)
    assert check_dataset(recipe.nuscenes.output, "v1.0-test") == []
    assert len(list((recipe.nuscenes.output / "samples" / "CAM_ACME").iterdir())) == 4
    assert len(list((recipe.nuscenes.output / "sweeps" / "CAM_ACME").iterdir())) == MESSAGES - 4


def test_without_the_plugin_the_channel_alone_fails_and_says_what_is_missing(tmp_path, site, recording):
    recipe = project(tmp_path / "project", recording)
    made, errors = build(recipe)
    assert set(errors) == {"frames"}
    assert "acme_msgs/msg/RawFrame" in errors["frames"]
    assert "install a decoder plug-in (image.acme_msgs.RawFrame)" in errors["frames"]
    assert {"ego_poses", "sweeps"} <= made.keys()


def test_planning_imports_nothing_of_a_plugin(tmp_path, site, recording):
    site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels"))
    site.restart()
    recipe = project(tmp_path / "project", recording)
    build(recipe)
    assert "acme_decoders" in sys.modules
    site.restart()
    made, errors = build(recipe, dry=True)
    assert errors == {}
    assert all(result.cached for result in made.values())
    assert "acme_decoders" not in sys.modules


def test_an_upgrade_runs_the_channels_of_the_plugin_again_and_no_others(tmp_path, site, recording):
    site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels"))
    site.restart()
    recipe = project(tmp_path / "project", recording)
    before, _ = build(recipe)
    versions = {asset: code_version(recipe, asset) for asset in before}
    site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels", version="1.1"))
    site.restart()
    after, errors = build(recipe)
    assert errors == {}
    # The same pixels come out, so nothing below the frames changes.
    assert {asset for asset, result in after.items() if not result.cached} == {"frames"}
    acme = [channel(recipe, made, "frames", "CAM_ACME")[0] for made in (before, after)]
    front = [channel(recipe, made, "frames", "CAM_FRONT")[0] for made in (before, after)]
    assert acme[0]["action"] != acme[1]["action"]
    assert acme[0]["artifact"] == acme[1]["artifact"]
    assert front[0] == front[1]
    assert {asset for asset in before if code_version(recipe, asset) != versions[asset]} == {"frames"}


def test_an_unrelated_plugin_leaves_all_keys_alone(tmp_path, site, recording):
    site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels"))
    site.restart()
    recipe = project(tmp_path / "project", recording)
    build(recipe)
    site.install(
        "other", "3.0", "def decode(message):\n    raise SystemExit\n", image__other_msgs__Frame="decode"
    )
    made, errors = build(recipe, dry=True)
    assert errors == {}
    assert all(result.cached for result in made.values())


def test_a_plugin_that_is_upgraded_while_a_process_runs_is_not_keyed_by_the_old_version(
    tmp_path, site, recording
):
    site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels"))
    site.restart()
    installed_decoders()
    site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels", version="1.1"))
    _, errors = build(project(tmp_path / "project", recording))
    assert "version 1.1 was installed while this process ran" in errors["frames"]


@pytest.mark.parametrize("in_pythonpath", [False, True])
def test_a_build_that_seems_to_have_nothing_to_do_notices_an_upgrade(tmp_path, monkeypatch, in_pythonpath):
    folder = tmp_path / "site-packages"
    site = Site(monkeypatch, folder)
    if in_pythonpath:
        monkeypatch.setenv("PYTHONPATH", f"/nowhere:{folder}")
    else:
        monkeypatch.setattr(spec, "_site_folders", lambda: (folder,))
    (tmp_path / "recipe.yaml").write_text(RECIPE)
    stamps = []
    for version in (None, "1.0", "1.1"):
        if version is not None:
            site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels", version))
        stamps += [code_stamp(str(tmp_path / "recipe.yaml")) for _ in range(2)]
    site.close()
    assert stamps[0::2] == stamps[1::2]
    assert len(set(stamps)) == 3


# --- clashes and broken plug-ins ---------------------------------------------------------


def test_two_plugins_for_one_type_cost_its_channels_and_name_both(tmp_path, site, recording):
    site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels"))
    site.install("rival", "0.3", "decode = None\n", image__acme_msgs__RawFrame="decode")
    made, errors = build(project(tmp_path / "project", recording))
    assert set(errors) == {"frames"}
    assert "acme-decoders 1.0 and rival 0.3" in errors["frames"]
    assert "uninstall all but one" in errors["frames"]
    assert "sweeps" in made


def test_a_plugin_cannot_replace_a_decoder_of_ours(site):
    site.install("greedy", "1.0", "decode = None\n", image__sensor_msgs__Image="decode")
    with pytest.raises(PluginError, match=r"greedy 1\.0 would replace the decoder that bagassets has"):
        installed_decoders().find("image", "sensor_msgs/msg/Image")
    assert installed_decoders().find("image", "sensor_msgs/msg/CompressedImage") is None


def test_the_types_that_are_ours_are_listed_completely():
    assert BUILT_IN["image"] == frozenset(frames._DECODERS)
    assert BUILT_IN["cloud"] == frozenset(CLOUD_DECODERS)
    assert BUILT_IN["pose"] == frozenset(pose_sources._DECODERS)
    assert BUILT_IN["boxes"] == frozenset(box_message_types())


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import nothing_of_this_name\n", "ModuleNotFoundError: No module named 'nothing_of_this_name'"),
        ("raise RuntimeError('licence expired')\n", "RuntimeError: licence expired"),
        ("decode_it = 1\n", "AttributeError"),
        ("decode = 1\n", "broken:decode is no function"),
    ],
)
def test_a_plugin_that_does_not_load_is_named_in_one_sentence(tmp_path, site, recording, code, words):
    site.install("broken", "2.0", code, image__acme_msgs__RawFrame="decode")
    made, errors = build(project(tmp_path / "project", recording))
    assert "decoder image.acme_msgs.RawFrame of broken 2.0" in errors["frames"]
    assert words in errors["frames"]
    assert "sweeps" in made


@pytest.mark.parametrize(
    "name", ["imge__acme_msgs__RawFrame", "image__RawFrame", "image__acme_msgs__msg__RawFrame"]
)
def test_a_misnamed_entry_point_is_told_where_it_would_have_helped(tmp_path, site, recording, name):
    site.install("typo", "1.0", "decode = None\n", **{name: "decode"})
    _, errors = build(project(tmp_path / "project", recording))
    assert f"Entry point {name.replace('__', '.')!r} of typo 1.0 is no decoder" in errors["frames"]


LOSSY = RECIPE + "limits: {lost_messages: 1.0}\n"
READING = "from bagassets.decode.model import ImageReading\nimport numpy as np\ndef decode(message):\n"


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("    return message.no_such_field", "raised AttributeError at faulty.py:4"),
        ("    return None", "returned NoneType, not ImageReading"),
        ("    return ImageReading(1.5, 'cam', None, b'', 'jpeg')", "whose stamp_ns is no integer"),
        ("    return ImageReading(1, 'cam', None, b'GIF', 'jpeg')", "whose encoded bytes are not what its encoding says"),
        ("    return ImageReading(1, 'cam', None, None, 'rgb8')", "whose pixels and encoded bytes are both given, or neither"),
        ("    return ImageReading(1, 'cam', np.zeros((4, 4)), None, 'mono8')", "whose pixels do not fit its encoding"),
        ("    return ImageReading(1, 'cam', np.zeros((4, 4), np.uint8), None, 'RGB8')", "whose encoding is none of"),
    ],
)  # fmt: skip
def test_mistakes_of_a_plugin_cost_messages_that_are_counted(tmp_path, site, recording, body, reason):
    site.install("faulty", "1.0", READING + body + "\n", image__acme_msgs__RawFrame="decode")
    recipe = project(tmp_path / "project", recording, LOSSY)
    made, errors = build(recipe)
    assert errors == {}
    entry, _ = channel(recipe, made, "frames", "CAM_ACME")
    assert entry["counts"]["written"] == 0
    ((told, number),) = entry["counts"]["lost"].items()
    assert number == entry["counts"]["read"] == MESSAGES
    assert told.startswith("decoder image.acme_msgs.RawFrame of faulty 1.0")
    assert reason in told


def test_losses_above_the_limit_end_in_a_sentence_with_the_place_to_blame(tmp_path, site, recording):
    site.install("faulty", "1.0", READING + "    return 1 / 0\n", image__acme_msgs__RawFrame="decode")
    _, errors = build(project(tmp_path / "project", recording))
    assert "CAM_ACME: topic /acme lost 19 of 19 messages" in errors["frames"]
    assert "raised ZeroDivisionError at faulty.py:4" in errors["frames"]


# --- the other families ------------------------------------------------------------------

FAMILIES = """
import math
import numpy as np
from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.fields import stamp_and_frame, stamp_ns
from bagassets.decode.model import BoxReading, CloudReading, PoseReading, RadarReading
from bagassets.errors import DecodeError
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
    # Header stamps mean the start of a revolution by default; a file is stamped at its end.
    assert stamp_ns == FIRST_NS + 100_000_000

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
        ("boxes__acme_msgs__Things", "lambda m: []", "annotations", "families:boxes is no BoxDecoder"),
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


# --- around: proposals and the command ---------------------------------------------------


def test_a_proposed_recipe_takes_topics_that_plugins_decode(tmp_path, site, family_recording):
    from bagassets.bags.open import open_recording
    from bagassets.recipe.glance import glance
    from bagassets.recipe.poses import propose_pose
    from bagassets.recipe.propose_rig import _annotations
    from bagassets.recipe.sensors import modality_of

    with open_recording(family_recording) as recording:
        seen = glance(recording)
    topics = {name: topic for name, topic in seen.topics.items() if name != "/odom"}
    assert modality_of(topics["/scan"]) is None
    site.install("families", "1.0", FAMILIES, **POINTS)
    assert modality_of(topics["/scan"]) == "lidar"
    assert modality_of(topics["/targets"]) == "radar"
    assert _annotations(seen) == ["/things"]
    without_odometry = type(seen)(topics, seen.edges, seen.moving)
    assert propose_pose(without_odometry, "base_link").fields == {"source": "pose", "topic": "/fix"}
    assert "families" not in sys.modules


def test_the_command_lists_plugins_and_fails_on_those_that_cannot_be_used(tmp_path, site, capsys):
    from bagassets.cli.main import main

    assert main(["decoders"]) == 0
    assert "No decoder plug-ins are installed" in capsys.readouterr().out
    site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels"))
    site.restart()
    assert main(["decoders"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "type                    becomes  package            decoder",
        "acme_msgs/msg/RawFrame  image    acme-decoders 1.0  acme_decoders:decode_raw_frame",
    ]
    site.install("rival", "0.3", "", image__acme_msgs__RawFrame="decode", imge__acme_msgs__Other="decode")
    assert main(["decoders", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert [row["distribution"] for row in told["decoders"]] == ["acme-decoders", "rival"]
    assert len(told["problems"]) == 2
    assert main(["decoders"]) == 1
    assert capsys.readouterr().err.count("error: ") == 2


def test_the_page_about_decoders_names_all_families_and_all_types_that_need_no_plugin():
    page = (Path(__file__).parent.parent / "docs" / "decoders.md").read_text()
    rows = {line.split("|")[1].strip(" `"): line for line in page.splitlines() if line.startswith("| `")}
    assert rows.keys() == set(FAMILY_NAMES)
    for family, types in BUILT_IN.items():
        for msgtype in types:
            package, name = msgtype.split("/msg/")
            assert package in rows[family], msgtype
            assert name in rows[family], msgtype
    assert (EXAMPLE / "pyproject.toml").read_text().count(re.search(r'"image.*RawFrame"', page)[0]) == 1
