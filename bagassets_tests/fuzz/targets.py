"""What is fuzzed: each target takes bytes, and nothing but a sentence of ours may leave it.

Seeds are small valid inputs, made anew each time.
"""

import json
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

import cv2
import numpy as np
from mcap.writer import CompressionType

from bagassets.assets.boxes.files.box_files import read_json_boxes, read_parquet_boxes
from bagassets.assets.boxes.files.kitti import read_kitti_labels, read_kitti_tracklets
from bagassets.assets.boxes.files.nuscenes_tables import TableSet, read_table
from bagassets.assets.boxes.files.sustechpoints import read_sustechpoints
from bagassets.assets.boxes.files.times import read_times
from bagassets.base.cache import NAME, Cache, Changes
from bagassets.base.errors import BagAssetsError, DecodeError
from bagassets.base.fingerprints import PlanNeeded
from bagassets.decode.compressed_image import checked_size, decode_pixels
from bagassets.decode.fields import check_points
from bagassets.decode.hesai import MODELS, HesaiLidar, HesaiPackets, packet_and_model
from bagassets.decode.loading import load_decoder
from bagassets.decode.ncom import decode_ncom
from bagassets.decode.ouster import OusterLidar
from bagassets.decode.packets import PAYLOADS, VELODYNE_PACKET_SIZE, Packets, sender
from bagassets.decode.poses import decode_transform
from bagassets.decode.velodyne import PacketFilter, RevolutionDecoder
from bagassets.decode.video_units import UnitReader
from bagassets.geometry.calibration_files.read import read_calibration_file
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.kernels.returns import PACKET
from bagassets.recipe.load import load_recipe, parse_recipe
from bagassets.recipe.model import Limits
from bagassets.recordings.digest_record import ATTRIBUTE, DigestIndex, read_attribute
from bagassets.recordings.discover import discover
from bagassets.recordings.open import open_recording
from bagassets.recordings.salvage.examine import examine
from bagassets.recordings.salvage.open import open_salvaged
from bagassets_tests import calibration_texts, damaged_files, label_files
from bagassets_tests.calibration_texts import kalibr_camera
from bagassets_tests.fuzz.decoders import cases
from bagassets_tests.hesai_data import LAYOUTS, corrections
from bagassets_tests.hesai_data import packet as hesai_packet
from bagassets_tests.ouster_data import metadata, packet
from bagassets_tests.small_drive import RECIPE

OUSTER = OusterLidar.parse(metadata())
LIMITS = Limits(chunk_bytes=4_000_000, message_bytes=1_000_000, image_pixels=1_000_000, cloud_points=100_000)


@dataclass(frozen=True)
class Target:
    """Something that reads bytes.

    Attributes:
        seeds: returns valid inputs; it may use a folder.
        run: reads an input; of ours, only a sentence may leave it.
    """

    seeds: Callable[[Path], list[bytes]]
    run: Callable[[bytes], None]


def _scratch():
    """A folder in memory, which is empty for each input."""
    return tempfile.TemporaryDirectory(
        prefix="fuzz-", dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    )


def _read(opened):
    with opened:
        opened.check_content()
        for message in opened.messages(list(opened.topics)):
            bytes(message.data)
        opened.span_ns()


def _attempt(read):
    said = "."
    try:
        read()
    except BagAssetsError as err:
        said = str(err)
    if not said.strip() or "Traceback" in said:
        raise ValueError(f"an error without a sentence: {said!r}")


def _recording(name):
    """Read a file as recordings are: by the ordinary readers, those for damaged ones, and the doctor."""

    def run(data):
        with _scratch() as folder:
            path = Path(folder) / name
            path.write_bytes(data)
            _attempt(lambda: _read(open_recording(path, (), LIMITS)))
            _attempt(lambda: _read(open_salvaged(path, (), LIMITS)))
            if crc32(data) % 8 == 0:  # that reads both ways, too
                _attempt(lambda: examine(path))

    return run


def _bag_folder(data):
    """Read a bag folder with this `metadata.yaml`, beside a sound database."""
    with _scratch() as folder:
        path = Path(folder) / "a"
        path.mkdir()
        (path / "metadata.yaml").write_bytes(data)
        (path / "a.db3").write_bytes(_database())
        _attempt(lambda: _read(open_recording(path, (), LIMITS)))
        _attempt(lambda: _read(open_salvaged(path, (), LIMITS)))
        recipe = parse_recipe(RECIPE.format(name="fuzz", root=folder), Path(folder) / "recipe.yaml")
        _attempt(lambda: discover(recipe.bags))


_MADE: dict[str, bytes] = {}


def _database():
    if "db3" not in _MADE:
        with _scratch() as folder:
            made = damaged_files.write_folder(Path(folder) / "a", damaged_files.entries()[:4])
            _MADE["db3"] = next(made.glob("*.db3")).read_bytes()
    return _MADE["db3"]


def _bags(folder):
    some = damaged_files.entries()[:8]
    kinds = (None, "BZ2", "LZ4")
    return [damaged_files.write_bag(folder / f"{kind}.bag", kind, some).read_bytes() for kind in kinds]


def _mcaps(folder):
    some = damaged_files.entries()[:8]
    kinds = [(kind, {}) for kind in CompressionType] + [(CompressionType.NONE, {"use_chunking": False})]
    return [
        damaged_files.write_mcap(
            folder / f"{number}.mcap", kind, some, enable_crcs=crcs, **options
        ).read_bytes()
        for number, (kind, options) in enumerate(kinds)
        for crcs in (True, False)
    ]


def _databases(folder):
    some = damaged_files.entries()
    return [
        next(damaged_files.write_folder(folder / str(number), some[:number]).glob("*.db3")).read_bytes()
        for number in (1, 4, 20)
    ]


def _metadata(folder):
    return [
        (damaged_files.write_folder(folder / "a", damaged_files.entries()[:4]) / "metadata.yaml").read_bytes()
    ]


# --- decoders ----------------------------------------------------------------------------


def _decode(data):
    """Read a message as steps do; the first two bytes of an input choose decoder and topic."""
    number = int.from_bytes(data[:2], "little") % len(cases())
    case, key = cases()[number], f"topic {number}"
    if key not in _MADE:
        _MADE[key] = case.topic(LIMITS)
    _attempt(lambda: decoded(case.line, _MADE[key], data[2:]))


def decoded(line, topic, data):
    """Read a message of a topic."""
    topic.header(data)
    topic.unstamped(data)
    if len(data) > topic.large_bytes and (reason := topic.refusal(data)):
        raise DecodeError(reason)
    message = topic.decode(data)
    decoder = load_decoder(line)
    if line.family in {"cloud", "radar"}:
        check_points(message, LIMITS.cloud_points)
    match line.family:
        case "boxes":
            _each(decoder.items(message), lambda item: decoder.decode(message, item))
        case "transforms":
            _each(decoder(message), decode_transform)
        case "packets":
            topic.packet(data, PAYLOADS)
            topic.packets([data, data], PAYLOADS)
            sender(message)
            _revolution([payload for _, payload in decoder(message) if len(payload) == VELODYNE_PACKET_SIZE])
        case "ouster":
            OUSTER.decode(np.stack([OUSTER.read(decoder(message))]))
        case "radar":
            decoder(message, topic.msgtype, None)
        case "video":
            packet = decoder(message)
            UnitReader().read(packet.codec, packet.data)
        case "image":
            reading = decoder(message)
            if reading.encoded is not None:
                _pixels(reading.encoded, reading.encoding)
        case _:
            decoder(message)


def _each(items, read):
    """Read what is in a message, one of which may be bad; raise the first error."""
    problems = []
    for item in items:
        try:
            read(item)
        except DecodeError as err:
            problems.append(err)
    if problems:
        raise problems[0]


def _revolution(payloads):
    """Decode Velodyne packets by themselves."""
    data = np.frombuffer(b"".join(payloads), PACKET)
    kept = np.delete(data, list(PacketFilter(None).refusals(data)))
    times_ns = np.arange(len(kept), dtype=np.int64)
    RevolutionDecoder(None).decode(Packets(times_ns, kept), times_ns)


def _pixels(encoded, encoding):
    width, height = checked_size(encoded, encoding)
    if width * height <= LIMITS.image_pixels:
        decode_pixels(encoded, encoding)


def _serialized(_folder):
    return [number.to_bytes(2, "little") + seed for number, case in enumerate(cases()) for seed in case.seeds]


def _packets(data):
    """Bytes of devices: inertial systems, units of video of two codecs, packets and metadata of lidars."""
    _attempt(lambda: decode_ncom(data))
    for codec in ("h264", "hevc"):
        _attempt(lambda codec=codec: UnitReader().read(codec, data))
    _attempt(lambda: OUSTER.decode(np.stack([OUSTER.read(data)])))
    _attempt(lambda: OusterLidar.parse(data))
    if (taken := packet_and_model(data)) is not None:
        _hesai_revolution(*taken)
    _attempt(lambda: HesaiLidar.parse(MODELS[0], data))


def _hesai_revolution(taken, model):
    """Decode a packet of a Hesai with the one before it."""
    lidar = HesaiLidar(model, ((0.0, 0.0),) * model.channels)
    data = np.frombuffer(taken * 2, model.packet)
    kept = np.delete(data, list(lidar.refusals(data)))
    packets = HesaiPackets.of(np.zeros(len(kept), dtype=np.int64), kept, by_log_time=False)
    if len(kept):
        lidar.decode(packets, packets.host_ns)


def _device_seeds(_folder):
    return [
        b"\xe7" + bytes(71),
        b"\0\0\0\1\x67\x42\x00\x1e\x8c\x8d\x40\0\0\0\1\x68\xce\x3c\x80\0\0\0\1\x65\x88\x84",
        packet(0),
        metadata(),
        *map(hesai_packet, LAYOUTS),
        corrections(40),
    ]


def _image(data):
    """The structure of JPEG and PNG, and their pixels if that is whole."""
    for encoding in ("jpeg", "png"):
        _attempt(lambda encoding=encoding: _pixels(data, encoding))


def _images(_folder):
    pixels = np.arange(24 * 32 * 3, dtype=np.uint8).reshape(24, 32, 3)
    return [
        cv2.imencode(name, some)[1].tobytes()
        for name in (".jpg", ".png")
        for some in (pixels, pixels[..., 0])
    ]


# --- texts and records --------------------------------------------------------------------


def _labels(data):
    """Every format of label files, chosen by the first byte."""
    readers = (
        read_json_boxes,
        read_parquet_boxes,
        read_sustechpoints,
        read_kitti_tracklets,
        lambda rest: read_kitti_labels(rest, tracking=True),
        lambda rest: read_kitti_labels(rest, tracking=False),
        read_times,
        lambda rest: read_table(TableSet("a"), "sample_annotation.json", rest),
    )
    reader = readers[data[0] % len(readers)] if data else readers[0]
    _attempt(lambda: list(reader(data[1:])))


def _label_seeds(folder):
    writers = (
        label_files.write_boxes_json,
        label_files.write_boxes_parquet,
        label_files.write_sustechpoints,
        label_files.write_kitti_tracklets,
        label_files.write_kitti_tracking,
        label_files.write_kitti_objects,
        lambda _: None,
        label_files.write_nuscenes,
    )
    seeds = [b"\6" + b"1700000000000000000\n2023-11-14T22:13:20Z\n"]
    for number, write in enumerate(writers):
        (place := folder / str(number)).mkdir()
        write(place)
        files = sorted(path for path in place.rglob("*") if path.is_file())
        seeds += [bytes([number]) + path.read_bytes()[:20_000] for path in files[:2]]
    return seeds


PINHOLE = CameraModel("plumb_bob", 64, 48, 40.0, 40.0, 32.0, 24.0, (-0.1, 0.01, 0.0, 0.0, 0.0))


def _calibration(data):
    for name in ("a.yaml", "a.json", "a.txt", "sensors.txt"):
        _attempt(lambda name=name: read_calibration_file(data, name))


def _calibrations(folder):
    chain = calibration_texts.camchain(kalibr_camera(PINHOLE, "/cam"), kalibr_camera(PINHOLE, "/other"))
    texts = (calibration_texts.ros(PINHOLE), calibration_texts.opencv(PINHOLE, folder / "a.yml"), chain)
    return [text.encode() if isinstance(text, str) else text for text in texts]


def _recipe(data):
    def read():
        with _scratch() as folder:
            path = Path(folder) / "recipe.yaml"
            path.write_bytes(data)
            load_recipe(path)

    _attempt(read)


def _recipes(_folder):
    more = "splits: {train: 0.8, val: 0.2}\nlimits: {lost_messages: 0.5}\nvision: {output: v}\n"
    return [
        RECIPE.format(name="test", root="bags").encode(),
        (RECIPE.format(name="a", root=".") + more).encode(),
    ]


def _digest_record(data):
    """A digest record as an attribute of a file, and as a database of a project."""
    with _scratch() as folder:
        path = Path(folder) / "a.bag"
        path.write_bytes(b"x")
        try:
            os.setxattr(path, ATTRIBUTE, data[:4000])
        except OSError:  # a file system without
            pass
        else:
            read_attribute(path, path.stat())
            read_attribute(path)
        (Path(folder) / "digests.sqlite").write_bytes(data)
        index = DigestIndex(Path(folder))
        index.get(path, path.stat())
        index.suspects_edit(path, path.stat())
        index.put(path, path.stat(), "0" * 64)
        (Path(folder) / NAME).write_bytes(data)
        cache, changes = Cache(folder), Changes()
        with suppress(PlanNeeded):
            cache.all("kind")
        cache.remove_if_damaged()
        changes.put("kind", "key", b"content")
        cache.write(changes)


def _digest_records(folder):
    path = folder / "a.bag"
    path.write_bytes(b"x")
    DigestIndex(folder).put(path, path.stat(), "0" * 64)
    record = {"digest": "0" * 64, "size": 1, "mtime_ns": 5, "ctime_ns": 6, "written_ns": 7}
    changes = Changes()
    changes.put("kind", "key", b"content")
    Cache(folder).write(changes)
    files = [(folder / name).read_bytes() for name in ("digests.sqlite", NAME)]
    return [json.dumps(record).encode(), *files]


TARGETS = {
    "rosbag1": Target(_bags, _recording("a.bag")),
    "mcap": Target(_mcaps, _recording("a.mcap")),
    "sqlite": Target(_databases, _recording("a.db3")),
    "metadata": Target(_metadata, _bag_folder),
    "decoders": Target(_serialized, _decode),
    "packets": Target(_device_seeds, _packets),
    "images": Target(_images, _image),
    "labels": Target(_label_seeds, _labels),
    "calibration": Target(_calibrations, _calibration),
    "recipe": Target(_recipes, _recipe),
    "digests": Target(_digest_records, _digest_record),
}
