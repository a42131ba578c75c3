"""Clouds that a transport has compressed are read like any others, or refused in a sentence."""

import gzip
import tracemalloc
import zlib
from dataclasses import dataclass, fields

import numpy as np
import pytest
import yaml
import zstandard
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bagassets.base.errors import DecodeError
from bagassets.decode.pointcloud2 import decode_pointcloud2
from bagassets.decode.radar import decode_radar
from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.recipe import load_recipe
from bagassets.recordings.open import open_recording
from bagassets.store.store import Store
from bagassets_tests.fuzz.decoders import RECORDED_TEXTS
from bagassets_tests.sample_drives import build_recordings
from bagassets_tests.small_drive import LATENCY_NS, RECIPE, messages, write_drive, write_messages
from bagassets_tests.sweep_data import Field, Header, cloud

TYPE = "point_cloud_interfaces/msg/CompressedPointCloud2"
TWO = {"x": np.float32([1, 2]), "y": np.float32([3, 4]), "z": np.float32([5, 6])}


def zstd_without_size(data):
    """As a publisher writes it that does not know beforehand how much there will be."""
    packing = zstandard.ZstdCompressor().compressobj()
    return packing.compress(data) + packing.flush()


WAYS = {
    "zlib": ("zlib", zlib.compress),
    "zlib with the head of gzip": ("zlib", gzip.compress),
    "zstd": ("zstd", zstandard.ZstdCompressor().compress),
    "zstd without its size": ("zstd", zstd_without_size),
}


@dataclass
class Compressed:
    header: Header
    height: int
    width: int
    fields: list[Field]
    is_bigendian: bool
    point_step: int
    row_step: int
    compressed_data: np.ndarray
    is_dense: bool
    format: str


def compressed(raw, packed, way, **other):
    values = {field.name: getattr(raw, field.name) for field in fields(raw) if field.name != "data"}
    packed = np.frombuffer(packed, np.uint8)
    return Compressed(**{**values, "compressed_data": packed, "format": way, **other})


@pytest.mark.parametrize("way", WAYS)
def test_a_cloud_is_as_it_was(way):
    name, pack = WAYS[way]
    count = 3000
    dice = np.random.default_rng(1)
    columns = {axis: dice.normal(size=count).astype(np.float32) for axis in "xyz"}
    columns |= {
        "ring": np.arange(count, dtype=np.uint16) % 16,
        "t": np.arange(count, dtype=np.uint32) * 30_000,
    }
    raw = cloud(10**18, columns)
    before = decode_pointcloud2(raw)
    after = decode_pointcloud2(compressed(raw, pack(raw.data.tobytes()), name))
    assert before.times_ns is not None
    np.testing.assert_array_equal(after.points, before.points)
    np.testing.assert_array_equal(after.times_ns, before.times_ns)
    assert (after.stamp_ns, after.frame_id) == (before.stamp_ns, before.frame_id)


def test_so_is_one_without_a_row_step_and_one_without_points():
    raw = cloud(10**18, TWO)
    packed = compressed(raw, zlib.compress(raw.data.tobytes()), "zlib", row_step=0)
    np.testing.assert_array_equal(decode_pointcloud2(packed).points[:, :3], np.stack([*TWO.values()], axis=1))
    for name, pack in WAYS.values():
        empty = compressed(raw, pack(b""), name, width=0, row_step=0)
        assert len(decode_pointcloud2(empty).points) == 0


def test_targets_of_a_radar_are_read_as_well():
    raw = cloud(10**18, {**TWO, "vx": np.float32([7, 8]), "vy": np.float32([0, 0])})
    packed = compressed(raw, zlib.compress(raw.data.tobytes()), "zlib")
    before, after = decode_radar(raw, "sensor_msgs/msg/PointCloud2"), decode_radar(packed, TYPE)
    assert len(before.targets["x"]) == 2
    assert after.targets.keys() == before.targets.keys()
    for name, values in before.targets.items():
        np.testing.assert_array_equal(after.targets[name], values)


SIX = zlib.compress(cloud(10**18, TWO).data.tobytes())


@pytest.mark.parametrize(
    ("packed", "way", "sentence"),
    [
        (SIX[:-6], "zlib", "its data are damaged: they do not unpack with zlib"),
        (b"no stream", "zlib", "its data are damaged: they do not unpack with zlib"),
        (b"no frame", "zstd", "its data are damaged: they do not unpack with zstd"),
        (zlib.compress(bytes(25)), "zlib", "its data unpack to more than height, width and point_step say"),
        (WAYS["zstd"][1](bytes(25)), "zstd", "its data unpack to more than height, width and point_step say"),
        (zstd_without_size(bytes(25)), "zstd", "its data unpack to more than height, width and point_step say"),
        (zlib.compress(bytes(23)), "zlib", "its data has another size than height, width"),
        (b"DRACO", "draco", r"not read \(Draco moves points, and drops those that are equal\); record the cloud itself"),
        (b"", "cloudini/v1", r"not read \(Cloudini rounds numbers\)"),
        (b"", "\x1b[2J", r"not read \(nothing is known about it\); record the cloud itself, or with zstd or zlib"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_in_a_sentence(packed, way, sentence):
    with pytest.raises(DecodeError, match=sentence):
        decode_pointcloud2(compressed(cloud(10**18, TWO), packed, way))


@pytest.mark.parametrize("way", WAYS)
def test_no_more_is_unpacked_than_a_lidar_sends(way):
    name, pack = WAYS[way]
    packed, raw = pack(bytes(1 << 20)), cloud(10**18, TWO)
    tracemalloc.start()
    with pytest.raises(DecodeError, match="than any lidar sends"):
        decode_pointcloud2(compressed(raw, packed, name))
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < 500_000


def write_compressed(path, also_raw=False):
    """Write the small drive as MCAP with its cloud compressed, on a topic of its own if `also_raw`."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(RECORDED_TEXTS[TYPE], TYPE))

    def items():
        for topic, msgtype, stamp_ns, message in messages(store):
            if also_raw or topic != "/points":
                yield topic, msgtype, stamp_ns, stamp_ns + LATENCY_NS, message
            if topic == "/points":
                values = {name: value for name, value in vars(message).items() if name != "data"}
                packed = np.frombuffer(zlib.compress(message.data.tobytes()), np.uint8)
                made = store.types[TYPE](**values, compressed_data=packed, format="zlib")
                yield "/points/zlib" if also_raw else topic, TYPE, stamp_ns, stamp_ns + LATENCY_NS, made

    return write_messages(path, "mcap", store, items())


def test_a_recording_gives_the_same_files(tmp_path):
    bags = tmp_path / "bags"
    write_drive(bags / "raw.mcap", "mcap")
    write_compressed(bags / "packed.mcap")
    (tmp_path / "recipe.yaml").write_text(RECIPE.format(name="test", root="bags"))
    recipe = load_recipe(tmp_path / "recipe.yaml")
    files = {}
    for key, made in build_recordings(recipe).items():
        entry = made["sweeps"].artifact.read_json("channels.json")["LIDAR_TOP"]
        clouds = Store(recipe.store_path).artifact(entry["artifact"])
        found = {path.name: path.read_bytes() for path in clouds.files.rglob("*.bin")}
        files[key] = entry["counts"], found
    assert len(files["raw.mcap"][1]) == 29
    assert files["packed.mcap"] == files["raw.mcap"]


@pytest.mark.parametrize("also_raw", [False, True])
def test_its_lidar_is_proposed_as_it_came_from_the_sensor(tmp_path, also_raw):
    path = write_compressed(tmp_path / "packed.mcap", also_raw)
    with open_recording(path) as recording:
        text = propose_recipe({path.name: scan_recording(recording)}, name="test", root=tmp_path).text
    (rig,) = yaml.safe_load(text)["rigs"]
    assert rig["channels"]["LIDAR_TOP"] == {"modality": "lidar", "topic": "/points"}
    assert ("/points/zlib" in text) == also_raw
