"""Decoder plug-ins: installed, used, upgraded, clashing and broken."""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from bagassets.base import fingerprints
from bagassets.base.errors import PluginError
from bagassets.base.fingerprints import code_fingerprint
from bagassets.base.plugins import FAMILIES as FAMILY_NAMES
from bagassets.base.plugins import installed_decoders
from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.loading import load_decoder
from bagassets.decode.registry import BUILT_IN, families_of, find_decoder, own_types
from bagassets.formats.assembly import assemble
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.store.store import Store
from bagassets_tests.nuscenes_checks import check_dataset
from bagassets_tests.plugin_build import build, channel, project
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
    part = Part("drive", "drive", made["nuscenes_tables"].artifact.digest)
    assemble(NUSCENES, [part], recipe.nuscenes, Store(recipe.store_path), recipe.nuscenes.output)
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
    versions = recording_assets(recipe).versions
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
    assert {
        name for name, version in recording_assets(recipe).versions.items() if version != versions[name]
    } == {"frames"}


def test_an_unrelated_plugin_leaves_all_keys_alone(tmp_path, site, recording):
    site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels"))
    site.restart()
    recipe = project(tmp_path / "project", recording)
    build(recipe)
    versions = recording_assets(recipe).versions
    site.install(
        "other", "3.0", "def decode(message):\n    raise SystemExit\n", image__other_msgs__Frame="decode"
    )
    made, errors = build(recipe, dry=True)
    assert errors == {}
    assert all(result.cached for result in made.values())
    assets = recording_assets(recipe)
    changes = {
        name: change for name in assets.names if (change := assets.version_changes(name, versions[name]))
    }
    assert changes == {"frames": "the installed decoder plug-ins"}, "as status says, and nothing else"


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
        monkeypatch.setattr(fingerprints, "site_folders", lambda: (str(folder),))
    (tmp_path / "recipe.yaml").write_text(RECIPE)
    stamps = []
    for version in (None, "1.0", "1.1"):
        if version is not None:
            site.unpack(wheel_of(EXAMPLE, tmp_path / "wheels", version))
        stamps += [code_fingerprint() for _ in range(2)]
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
        find_decoder("image", "sensor_msgs/msg/Image")
    assert find_decoder("image", "sensor_msgs/msg/CompressedImage").plugin is None


def test_a_plugin_goes_before_a_decoder_of_ours_that_goes_by_the_fields_of_messages(site):
    site.install(
        "exact",
        "1.0",
        "decode = None\n",
        radar__radar_msgs__RadarScan="decode",
        radar__sensor_msgs__PointCloud="decode",
    )
    others = {"radar_msgs/msg/RadarScan": (), "sensor_msgs/msg/PointCloud": ("cloud",)}
    for msgtype, families in others.items():
        assert find_decoder("radar", msgtype).plugin.package == "exact"
        assert families_of(msgtype) == ("radar", *families)
    assert find_decoder("radar", "radar_msgs/msg/RadarTracks").plugin is None


# --- the table ---------------------------------------------------------------------------


@pytest.mark.parametrize("line", BUILT_IN, ids=lambda line: f"{line.family}.{line.msgtype}")
def test_every_decoder_of_the_table_is_there(line):
    loaded = load_decoder(line)
    assert isinstance(loaded, BoxDecoder) if line.family == "boxes" else callable(loaded)


def test_a_server_imports_all_decoders_before_it_forks_workers():
    modules = {line.reference.partition(":")[0] for line in BUILT_IN}
    code = f"""
import sys
from bagassets.defs.launchers.run_worker import preload
preload([])
print({modules!r} - set(sys.modules))
"""
    reported = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert reported.strip() == "set()"


def test_no_line_of_the_table_hides_another():
    names = [(line.family, line.msgtype) for line in BUILT_IN]
    assert len(names) == len(set(names))


def test_the_table_imports_no_decoder_and_asking_it_neither():
    code = """
import sys
from bagassets.decode.registry import expected_types, families_of, find_decoder, types_of
assert find_decoder("image", "sensor_msgs/msg/Image").reference == "bagassets.decode.image:decode_image"
assert families_of("sensor_msgs/msg/PointCloud2") == ("cloud", "radar")
types_of("boxes"), expected_types("cloud")
print(sorted(name for name in sys.modules if name.startswith(("bagassets.", "numpy", "cv2"))))
"""
    reported = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert set(ast.literal_eval(reported)) == {
        "bagassets.base",
        "bagassets.decode",
        "bagassets.decode.registry",
        "bagassets.base.errors",
        "bagassets.base.escaping",
        "bagassets.base.plugins",
    }


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import nothing_of_this_name\n", "ModuleNotFoundError: No module named 'nothing_of_this_name'"),
        ("raise RuntimeError('licence expired')\n", "RuntimeError: licence expired"),
        ("decode_it = 1\n", "AttributeError"),
        ("decode = 1\n", "broken:decode is not a function"),
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
def test_a_misnamed_entry_point_is_reported_where_it_would_have_helped(tmp_path, site, recording, name):
    site.install("typo", "1.0", "decode = None\n", **{name: "decode"})
    _, errors = build(project(tmp_path / "project", recording))
    assert f"Entry point {name.replace('__', '.')!r} of typo 1.0 is not a decoder" in errors["frames"]


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
    ((reported, number),) = entry["counts"]["lost"].items()
    assert number == entry["counts"]["read"] == MESSAGES
    assert reported.startswith("decoder image.acme_msgs.RawFrame of faulty 1.0")
    assert reason in reported


def test_losses_above_the_limit_end_in_a_sentence_with_the_place_to_blame(tmp_path, site, recording):
    site.install("faulty", "1.0", READING + "    return 1 / 0\n", image__acme_msgs__RawFrame="decode")
    _, errors = build(project(tmp_path / "project", recording))
    assert "CAM_ACME: topic /acme lost 19 of 19 messages" in errors["frames"]
    assert "raised ZeroDivisionError at faulty.py:4" in errors["frames"]


# --- the command and the page ---


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
    reported = json.loads(capsys.readouterr().out)
    assert [row["distribution"] for row in reported["decoders"]] == ["acme-decoders", "rival"]
    assert len(reported["problems"]) == 2
    assert main(["decoders"]) == 1
    assert capsys.readouterr().err.count("error: ") == 2


def test_the_page_about_decoders_names_all_families_and_all_types_that_need_no_plugin():
    page = (Path(__file__).parents[2] / "docs" / "decoders.md").read_text("utf-8")
    rows = {line.split("|")[1].strip(" `"): line for line in page.splitlines() if line.startswith("| `")}
    assert rows.keys() == set(FAMILY_NAMES)
    for family in FAMILY_NAMES:
        for msgtype in own_types(family):
            package, name = msgtype.split("/msg/")
            assert package in rows[family], msgtype
            assert name in rows[family], msgtype
    assert (EXAMPLE / "pyproject.toml").read_text().count(re.search(r'"image.*RawFrame"', page)[0]) == 1
