"""Faults by name, and what becomes of each: the table that tests execute, and that docs/reliability.md shows.

A row is done to a small drive, which is then built. `OUTCOMES` says what its outcome may be.
"""

import copy
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bagassets.assets.face import Loss
from bagassets.assets.quality.evidence import Evidence
from bagassets.base.errors import BagAssetsError
from bagassets.engine.execute import BuildFailure, Skipped, execute
from bagassets.engine.graph import Graph
from bagassets.formats.assembly import assemble
from bagassets.formats.catalogue import known_assets, recording_assets
from bagassets.formats.dataset_integrity import find_damage, remove_damaged
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.digest_record import ATTRIBUTE, DigestIndex
from bagassets.recordings.discover import discover
from bagassets.store.canonical import digest_file
from bagassets.store.store import Store
from bagassets_tests import damaged_files
from bagassets_tests.checks import RECORDING_CHECKS
from bagassets_tests.killed_recorder import leave_log
from bagassets_tests.small_drive import RECIPE, as_it_is, write_drive
from bagassets_tests.store_check import check_store

KINDS = {"ros1": "a.bag", "ros2": "a", "mcap": "a.mcap"}
"""Format -> what the recording is called."""
TEXT = RECIPE + "preview: {{enabled: false}}\n"
DURATION_S = 1.0
S = 1_000_000_000


OUTCOMES = {
    "sentence": "something is not made, and one sentence says why",
    "counted": "a dataset is made, and what was lost is counted, with a reason",
    "finding": "a dataset is made, and a check of the recording says what is odd",
    "identical": "the dataset is, byte for byte, that of a drive without the fault",
}


@dataclass
class Result:
    """What became of a build.

    Attributes:
        errors: sentences about what was not made.
        losses: what was lost.
        counts: of channels, of which each must add up.
        findings: sentences of checks.
        dataset: path -> digest of the files in the dataset.
    """

    errors: list[str] = field(default_factory=list)
    losses: list = field(default_factory=list)
    counts: list = field(default_factory=list)
    findings: list[str] = field(default_factory=list)
    dataset: dict[str, str] = field(default_factory=dict)


class Place:
    """A project with one small drive in some format, to do a fault to; of its build only the `wanted` outcome is looked at."""

    def __init__(self, folder, kind, wanted="identical"):
        self.folder, self.kind = folder, kind
        self.text = TEXT.format(name="test", root="bags")
        self.root = folder / "bags"
        self.path = self.root / KINDS[kind]
        self.store_path = folder / ".bagassets" / "store"
        self.after_digest = lambda: None
        self.wanted = wanted
        self.limits = "limits: {lost_messages: 0.5}\n"

    def write(self, change=as_it_is, keep=lambda _topic, _stamp_ns: True, duration_s=DURATION_S):
        return write_drive(self.path, self.kind, duration_s, keep, change)

    def set(self, old, new):
        assert old in self.text, old
        self.text = self.text.replace(old, new)

    def edit(self, path, old, new):
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    @property
    def file(self):
        """The file with the messages."""
        return damaged_files.storage_of(self.path)

    def build(self):
        """Build, as far as that goes."""
        result = Result()
        (self.folder / "recipe.yaml").write_text(self.text)
        try:
            recipe = load_recipe(self.folder / "recipe.yaml")
            found = discover(recipe.bags)
            result.errors += [f"{name}: {reason}" for name, reason in found.excluded]
            store = Store(recipe.store_path)
            index = DigestIndex.of(recipe)
            parts = [self._build_one(recipe, store, index, one, result) for one in found.recordings.values()]
            if all(parts) and self.wanted == "identical":
                assemble(NUSCENES, parts, recipe.nuscenes, store, recipe.nuscenes.output)
                result.dataset = {
                    path.relative_to(recipe.nuscenes.output).as_posix(): digest_file(path)
                    for path in recipe.nuscenes.output.rglob("*")
                    if path.is_file() and path.name not in {"dataset.lock.json", "dataset.md"}
                }
        except BagAssetsError as err:
            result.errors.append(str(err))
        return result

    def _build_one(self, recipe, store, index, recording, result):
        digest = recording_digest(recording, index)
        stat = recording_stat(recording)
        self.after_digest()
        graph = Graph(recording_assets(recipe), recording, digest.digest, stat)
        faces = {asset.name: asset.face for asset in known_assets()}
        made, part = {}, None
        try:
            for one in execute(graph, threads=1):
                if isinstance(one, Skipped):
                    result.errors.append(f"{one.asset}: {one.reason}")
                    continue
                made[one.asset] = one.artifact
                summary = one.artifact.summary()
                result.losses += faces[one.asset].losses(summary)
                result.losses += [Loss("recording", summary["damage"], 0)] if "damage" in summary else []
                result.counts += [one for one in summary.get("channels", {}).values() if "read" in one]
                if one.asset == "nuscenes_tables":
                    part = Part(recording.key, digest.digest, one.artifact.digest)
            if self.wanted == "finding":
                evidence = Evidence(recipe, recipe.rigs[0], store, made.__getitem__)
                result.findings = [
                    one for check in RECORDING_CHECKS for one in check.rule(evidence).sentences
                ]
        except BuildFailure as err:
            result.errors += map(str, err.errors.values())
        return part


@dataclass(frozen=True)
class Fault:
    """A row of the table.

    Attributes:
        area: heading.
        what: the fault, as a clause.
        outcome: one of `OUTCOMES`.
        says: part of the sentence, the finding, or the reason of what was lost.
        do: does it to a place, and returns what became of the build.
        kinds: formats that can have it.
        is_slow: it is left to the long tests.
    """

    area: str
    what: str
    outcome: str
    says: str
    do: Callable[[Place], Result]
    kinds: tuple[str, ...] = tuple(KINDS)
    is_slow: bool = False


# --- ways of doing it --------------------------------------------------------------------


def to_file(damage, recover=None):
    """Damage the file with the messages."""

    def do(place):
        place.write()
        data = damage(place.file.read_bytes())
        place.file.unlink() if data is None else place.file.write_bytes(data)
        if recover:
            place.set("root: bags", f"root: bags, recover: {recover}")
        return place.build()

    return do


def to_messages(topic, change, some=lambda number: number % 4 == 3):
    """Change some messages of a topic: of each, return it, or bytes, or None if it is not written."""

    def do(place):
        place.text += place.limits

        def changed(one, number, message, log_ns):
            if one != topic or not some(number):
                return [(log_ns, message)]
            made = change(copy.deepcopy(message))
            return [] if made is None else [(log_ns, made)]

        place.write(changed)
        return place.build()

    return do


def set_in(message, path, value):
    *names, last = path.split(".")
    for name in names:
        message = message[int(name)] if name.isdigit() else getattr(message, name)
    setattr(message, last, value(getattr(message, last)) if callable(value) else value)


def field_is(path, value):
    """Return a change that gives a field of a message a value."""

    def change(message):
        set_in(message, path, value)
        return message

    return change


def at_times(when):
    """Change log times: topic, number, log time -> log time."""

    def do(place):
        place.write(lambda topic, number, message, log_ns: [(when(topic, number, log_ns), message)])
        return place.build()

    return do


def without(topic):
    def do(place):
        place.write(keep=lambda one, _: one != topic)
        return place.build()

    return do


def with_recipe(old, new):
    def do(place):
        place.write()
        place.set(old, new)
        return place.build()

    return do


def then(damage):
    """Build, damage what was built, and build again."""

    def do(place):
        place.write()
        first = place.build()
        assert not first.errors, first.errors
        damage(place)
        return place.build()

    return do


def some_file(place, pattern):
    return min(place.store_path.glob(pattern))


def overwrite(path, data):
    path.chmod(0o644)
    path.write_bytes(data)


def verified(damage):
    """Damage the store or the dataset, and have `verify` remove what is damaged."""

    def both(place):
        damage(place)
        recipe, store = load_recipe(place.folder / "recipe.yaml"), Store(place.store_path)
        damages = list(check_store(store))
        spoiled = list(find_damage(recipe, store, {one.digest for one in damages}))
        assert damages or spoiled
        for one in damages:
            (store.remove if one.kind == "artifact" else store.forget)(one.digest)
        remove_damaged(spoiled)

    return then(both)


def beforehand(prepare):
    """Do something to the project before it is built."""

    def do(place):
        place.write()
        prepare(place)
        return place.build()

    return do


def with_record(record):
    """Store a digest record that lies with the file."""

    def prepare(place):
        for file in [place.path] if place.path.is_file() else sorted(place.path.iterdir()):
            stat = file.stat()
            text = record(stat)
            with suppress(OSError):
                os.setxattr(file, ATTRIBUTE, text if isinstance(text, bytes) else json.dumps(text).encode())

    return beforehand(prepare)


def between(change):
    """Change the recording after it was digested, before it is read."""

    def do(place):
        place.write()
        place.after_digest = lambda: change(place.file)
        return place.build()

    return do


def by_process(*arguments, kill_after_s=None):
    """Build in a process that is starved or killed, then here."""

    def do(place):
        place.write()
        (place.folder / "recipe.yaml").write_text(place.text)
        command = [
            sys.executable,
            "-m",
            "bagassets_tests.build_process",
            str(place.folder / "recipe.yaml"),
            *arguments,
        ]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        process.stdout.readline()
        if kill_after_s is not None:
            time.sleep(kill_after_s)
            process.kill()
        said = process.communicate(timeout=120)[1]
        assert "Traceback" not in said
        assert list(check_store(Store(place.store_path))) == []
        return place.build()

    return do


def at_once(place):
    """Two builds of one store at the same time."""
    place.write()
    (place.folder / "recipe.yaml").write_text(place.text)
    command = [sys.executable, "-m", "bagassets_tests.build_process", str(place.folder / "recipe.yaml")]
    both = [
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for one in both:
        said = one.communicate(timeout=120)[1]
        assert one.returncode == 0, said
    return place.build()


def cut(share):
    return lambda data: data[: int(len(data) * share)]


def flipped(at):
    def damage(data):
        place = int(len(data) * at) if at < 1 else at
        return data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :]

    return damage


def zeros(begin, end):
    return lambda data: (
        data[: int(len(data) * begin)]
        + bytes(int(len(data) * (end - begin)))
        + data[int(len(data) * begin) + int(len(data) * (end - begin)) :]
    )


def without_index(data):
    return damaged_files.without_index(data, None)


def strictly(do):
    """Do it under the limits that recipes have by default."""

    def strict(place):
        place.limits = ""
        return do(place)

    return strict


def unstamped(message):
    return field_is("header.stamp.sec", 0)(field_is("header.stamp.nanosec", 0)(message))


NAN, NOTHING = float("nan"), b"\0\1\0\0\xff\xff\xff\xff"
CAM, INFO, POINTS, ODOM, STATIC = "/cam/image_raw", "/cam/camera_info", "/points", "/odom", "/tf_static"
every = lambda _: True
F = Fault
FAULTS = [
    F("Files", "the file is empty", "sentence", "copy it again from where it was recorded", to_file(lambda _: b"")),
    F("Files", "a text stands in its place", "sentence", "it cannot be read", to_file(lambda _: b"no recording\n" * 500)),
    F("Files", "a Git LFS pointer stands in its place", "sentence", "git lfs pull", to_file(lambda _: b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n")),
    F("Files", "it has no index, summary or header", "identical", "", to_file(without_index)),
    F("Files", "the same, with `recover: refuse`", "sentence", "it cannot be read", to_file(without_index, "refuse"), ("ros1", "mcap")),
    F("Files", "it was cut at half", "sentence", "recover: all", to_file(cut(0.5))),
    F("Files", "it was cut at 70 %, with `recover: all`", "counted", "can be read", to_file(cut(0.7), "all")),
    F("Files", "its last tenth are zeros", "sentence", "recover: all", to_file(zeros(0.9, 1)), ("ros1", "ros2")),
    F("Files", "the same, with `recover: all`", "counted", "can be read", to_file(zeros(0.9, 1), "all"), ("ros1", "ros2")),
    F("Files", "a hole of zeros is in the middle", "sentence", "recover: all", to_file(zeros(0.5, 0.6))),
    F("Files", "the same, with `recover: all`", "counted", "can be read", to_file(zeros(0.5, 0.6), "all")),
    F("Files", "a bit of its first bytes is flipped", "identical", "", to_file(flipped(3))),
    F("Files", "bytes follow its end", "identical", "", to_file(lambda data: data + b"x" * 4096)),
    F("Files", "a bit is flipped in the only chunk, which has a checksum", "sentence", "does not match its checksum", to_file(flipped(0.3)), ("mcap",)),
    F("Files", "metadata.yaml is torn", "identical", "", beforehand(lambda p: (p.path / "metadata.yaml").write_text("rosbag2_bagfile_information: [")), ("ros2",)),
    F("Files", "metadata.yaml announces more messages than there are", "sentence", "recover: all", beforehand(lambda p: p.edit(p.path / "metadata.yaml", "message_count: 9", "message_count: 90")), ("ros2",)),
    F("Files", "the file that metadata.yaml names is missing", "sentence", "there is no .db3", to_file(lambda _: None), ("ros2",)),
    F("Files", "a recorder that was killed left a write-ahead log", "identical", "", beforehand(lambda p: leave_log(p.file, 20)), ("ros2",)),
    F("Files", "a write-ahead log lies without its database", "sentence", "the last messages of gone.db3", beforehand(lambda p: (p.root / "gone.db3-wal").write_bytes(bytes(100)))),
    F("Files", "a link leads nowhere", "sentence", "leads nowhere", beforehand(lambda p: (p.root / "gone.bag").symlink_to(p.root / "none"))),
    F("Files", "a link leads to a folder that holds it", "identical", "", beforehand(lambda p: (p.root / "round").symlink_to(p.root))),
    F("Files", "a named pipe lies among the recordings", "sentence", "a named pipe", beforehand(lambda p: os.mkfifo(p.root / "pipe.bag"))),
    F("Files", "it grows after it was digested", "sentence", "changed while it was read", between(lambda file: file.write_bytes(file.read_bytes() + b"more"))),
    F("Files", "it is replaced after it was digested", "sentence", "changed while it was read", between(lambda file: (file.write_bytes(file.read_bytes()[:-1]), os.utime(file, ns=(0, 10**18))))),
    F("Files", "it vanishes after it was digested", "sentence", "was it removed?", between(Path.unlink)),
    F("Files", "it is touched after it was built", "identical", "", then(lambda p: os.utime(p.file))),
    F("Images", "some are cut off", "counted", "does not fit 100 bytes", to_messages(CAM, lambda m: field_is("data", m.data[:100])(m))),
    F("Images", "the same, and `limits.lost_messages` accepts none", "sentence", "raise limits.lost_messages", strictly(to_messages(CAM, lambda m: field_is("data", m.data[:100])(m)))),
    F("Images", "some have no pixels", "counted", "does not fit 0 bytes", to_messages(CAM, field_is("data", np.zeros(0, np.uint8)))),
    F("Images", "some are of size 0", "counted", "does not fit 2304 bytes", to_messages(CAM, field_is("width", 0))),
    F("Images", "some announce 4,000 million columns", "counted", "does not fit 2304 bytes", to_messages(CAM, field_is("width", 2**32 - 1))),
    F("Images", "some have an encoding that nobody knows", "counted", "'purple8' is not supported", to_messages(CAM, field_is("encoding", "purple8"))),
    F("Images", "all have such an encoding", "sentence", "purple8", to_messages(CAM, field_is("encoding", "purple8"), every)),
    F("Images", "some have rows that are too short", "counted", "with step 3 does not fit", to_messages(CAM, field_is("step", 3))),
    F("Images", "some are half as large as the others", "sentence", "but the calibration is for 32x24", to_messages(CAM, lambda m: field_is("data", m.data[: 12 * 96])(field_is("height", 12)(m)))),
    F("Images", "the bytes of some are no message", "counted", "its bytes do not fit", to_messages(CAM, lambda _: NOTHING)),
    F("Images", "the bytes of all are no message", "sentence", "cannot be decoded", to_messages(CAM, lambda _: NOTHING, every)),
    F("Images", "one is stamped twice", "counted", "duplicate stamp", to_messages(CAM, field_is("header.stamp.nanosec", 110_000_000), lambda n: n in {1, 2})),
    F("Images", "some are not stamped", "counted", "zero stamp", to_messages(CAM, unstamped)),
    F("Images", "there are none", "finding", CAM, without(CAM)),
    F("Clouds", "some are cut off", "counted", "another size than", to_messages(POINTS, lambda m: field_is("data", m.data[:100])(m))),
    F("Clouds", "some have no points", "counted", "no point in it", to_messages(POINTS, lambda m: field_is("data", m.data[:0])(field_is("width", 0)(m)))),
    F("Clouds", "some have points of no bytes", "counted", "its field x does not lie within point_step", to_messages(POINTS, field_is("point_step", 0))),
    F("Clouds", "some announce 4,000 million points", "counted", "limits.cloud_points", to_messages(POINTS, field_is("width", 2**32 - 1))),
    F("Clouds", "some have no x", "counted", "it has no field x", to_messages(POINTS, field_is("fields.0.name", "q"))),
    F("Clouds", "a field of some has a type that nobody knows", "counted", "its field x has an unknown datatype", to_messages(POINTS, field_is("fields.0.datatype", 99))),
    F("Clouds", "a field of some lies behind the point", "counted", "its field z does not lie within point_step", to_messages(POINTS, field_is("fields.2.offset", 4000))),
    F("Clouds", "all points of some are not a number", "counted", "no point in it", to_messages(POINTS, field_is("data", lambda d: np.full(len(d), 255, np.uint8)))),
    F("Clouds", "the bytes of some are no message", "counted", "its bytes do not fit", to_messages(POINTS, lambda _: NOTHING)),
    F("Clouds", "there are none", "finding", POINTS, without(POINTS)),
    F("Poses", "some positions are not a number", "counted", "its position is not finite", to_messages(ODOM, field_is("pose.pose.position.x", NAN))),
    F("Poses", "the same, and `limits.lost_messages` accepts none", "sentence", "limits.lost_messages", strictly(to_messages(ODOM, field_is("pose.pose.position.x", NAN)))),
    F("Poses", "some positions are out of reach", "counted", "farther away than any place on Earth", to_messages(ODOM, field_is("pose.pose.position.x", 1e12))),
    F("Poses", "the vehicle jumps by a kilometre and back", "counted", "out of reach from those before and after it", to_messages(ODOM, field_is("pose.pose.position.x", 1000.0), lambda n: n == 20)),
    F("Poses", "some rotations are zero", "counted", "its quaternion is zero", to_messages(ODOM, field_is("pose.pose.orientation.w", 0.0))),
    F("Poses", "some rotations are of length 2", "counted", "not of unit length", to_messages(ODOM, field_is("pose.pose.orientation.w", 2.0))),
    F("Poses", "the bytes of some are no message", "counted", "its bytes do not fit", to_messages(ODOM, lambda _: NOTHING)),
    F("Poses", "no position is a number", "sentence", "none of 51 messages gives a pose", to_messages(ODOM, field_is("pose.pose.position.x", NAN), every)),
    F("Poses", "there is one only", "finding", "it has no scene", to_messages(ODOM, lambda _: None, lambda n: n > 0)),
    F("Poses", "none for half of the drive", "finding", "3 of 9 readings have no ego pose", to_messages(ODOM, lambda _: None, lambda n: n > 25)),
    F("Poses", "there are none", "sentence", ODOM, without(ODOM)),
    F("Calibration", "there are no transforms", "sentence", "no frames are known at all", without(STATIC)),
    F("Calibration", "a sensor has no transform", "sentence", "lidar", to_messages(STATIC, field_is("transforms", lambda t: t[:1]), every)),
    F("Calibration", "a transform is not a number", "sentence", "its position is not finite", to_messages(STATIC, field_is("transforms.0.transform.translation.x", NAN), every)),
    F("Calibration", "a rotation is zero", "sentence", "not of unit length", to_messages(STATIC, lambda m: [set_in(m, f"transforms.0.transform.rotation.{a}", 0.0) for a in "xyzw"] and m, every)),
    F("Calibration", "transforms go round", "sentence", "is not a frame known here", to_messages(STATIC, lambda m: [set_in(m, "transforms.0.child_frame_id", "lidar"), set_in(m, "transforms.1.header.frame_id", "cam"), set_in(m, "transforms.0.header.frame_id", "cam")] and m, every)),
    F("Calibration", "frames have a leading slash", "identical", "", to_messages(STATIC, lambda m: [set_in(m, f"transforms.{i}.child_frame_id", lambda name: f"/{name}") for i in (0, 1)] and m, every)),
    F("Calibration", "a sensor is 80 m ahead of the vehicle", "finding", "is 80.01 m from the ego frame", to_messages(STATIC, field_is("transforms.0.transform.translation.x", 80.0), every)),
    F("Calibration", "there is no camera info", "sentence", INFO, without(INFO)),
    F("Calibration", "the camera matrix is zero", "sentence", "the camera was not calibrated", to_messages(INFO, lambda m: [setattr(m, k, getattr(m, k) * 0) for k in "kpKP" if hasattr(m, k)] and m, every)),
    F("Calibration", "the camera matrix is not a number", "sentence", "not finite", to_messages(INFO, lambda m: [setattr(m, k, getattr(m, k) * NAN) for k in "kK" if hasattr(m, k)] and m, every)),
    F("Calibration", "the distortion model is one that nobody knows", "sentence", "'bent' is not known", to_messages(INFO, field_is("distortion_model", "bent"), every)),
    F("Calibration", "the camera info is of another size", "sentence", "32x24", to_messages(INFO, field_is("width", 640), every)),
    F("Calibration", "the bytes of some camera infos are no message", "identical", "", to_messages(INFO, lambda _: NOTHING)),
    F("Clocks", "all log times are equal", "identical", "", at_times(lambda _t, _n, _: 1_700_000_000 * S)),
    F("Clocks", "log times are a year ahead", "identical", "", at_times(lambda _t, _n, at: at + 31_536_000 * S)),
    F("Clocks", "the clock of the recorder is set back half-way", "identical", "", at_times(lambda _t, _n, at: at - (3600 * S if at > 1_700_000_000_500_000_000 else 0))),
    F("Clocks", "messages were written out of order", "identical", "", at_times(lambda _t, n, at: at + (n % 3) * 30_000_000)),
    F("Clocks", "no image is stamped", "sentence", "clock", to_messages(CAM, unstamped, every)),
    F("Clocks", "the camera is an hour ahead of the poses", "finding", "s after the log time, at most", to_messages(CAM, field_is("header.stamp.sec", lambda s: s + 3600), every)),
    F("Clocks", "images are stamped in an order of their own", "identical", "", at_times(lambda t, n, at: at + (200_000_000 if t == CAM and n == 3 else 0))),
    F("Recipes", "it is empty", "sentence", "recipe.yaml", beforehand(lambda p: setattr(p, "text", ""))),
    F("Recipes", "it is no YAML", "sentence", "recipe.yaml", with_recipe("rigs:", "rigs: [")),
    F("Recipes", "it has a field that nobody knows", "sentence", "colour", with_recipe("name: test", "name: test\ncolour: red")),
    F("Recipes", "a number is a word", "sentence", "settle_s", with_recipe("settle_s: 0", "settle_s: soon")),
    F("Recipes", "a modality is one that nobody knows", "sentence", "modality", with_recipe("modality: camera", "modality: nose")),
    F("Recipes", "the folder of recordings is not there", "sentence", "nowhere", with_recipe("root: bags", "root: nowhere")),
    F("Recipes", "a camera names a topic that is not there", "finding", "/no/image", with_recipe("topic: /cam/image_raw", "topic: /no/image")),
    F("Recipes", "the topic of a camera has clouds", "sentence", "carries sensor_msgs/msg/PointCloud2", with_recipe("topic: /cam/image_raw", "topic: /points, undistort: false")),
    F("Recipes", "poses name a topic that is not there", "sentence", "/no/odometry", with_recipe("topic: /odom", "topic: /no/odometry")),
    F("Recipes", "a sensor names a frame that is not there", "sentence", "nowhere", with_recipe("topic: /points", "topic: /points, frame: nowhere")),
    F("Recipes", "a camera names a camera info that is not there", "sentence", "/no/info", with_recipe("topic: /cam/image_raw", "topic: /cam/image_raw, camera_info: /no/info")),
    F("Recipes", "the drive is shorter than a scene may be", "finding", "it has no scene", with_recipe("min_length_s: 0.5", "min_length_s: 15")),
    F("Recipes", "it selects no recording", "sentence", "excluded by bags.exclude", with_recipe("root: bags", "root: bags, exclude: ['**']")),
    F("Stores", "a record of an action is torn", "identical", "", then(lambda p: overwrite(some_file(p, "actions/*/*.json"), b"{"))),
    F("Stores", "all records of actions are gone", "identical", "", then(lambda p: shutil.rmtree(p.store_path / "actions"))),
    F("Stores", "an artifact is gone", "identical", "", then(lambda p: shutil.rmtree(some_file(p, "artifacts/*/*")))),
    F("Stores", "all artifacts are gone", "identical", "", then(lambda p: shutil.rmtree(p.store_path / "artifacts"))),
    F("Stores", "a manifest is gone", "identical", "", then(lambda p: some_file(p, "artifacts/*/*/manifest.json").unlink())),
    F("Stores", "a bit of a file is flipped; `verify`", "identical", "", verified(lambda p: overwrite(f := some_file(p, "artifacts/*/*/files/*.jpg"), flipped(0.5)(f.read_bytes())))),
    F("Stores", "a file is gone; `verify`", "identical", "", verified(lambda p: some_file(p, "artifacts/*/*/files/*.jpg").unlink())),
    F("Stores", "a file does not belong there; `verify`", "identical", "", verified(lambda p: (some_file(p, "artifacts/*/*/files/*.jpg").parent / "more").write_bytes(b""))),
    F("Stores", "the record of another action is in its place; `verify`", "identical", "", verified(lambda p: overwrite(some_file(p, "actions/*/*.json"), sorted(p.store_path.glob("actions/*/*.json"))[1].read_bytes()))),
    F("Stores", "a killed process left half an artifact", "identical", "", then(lambda p: (p.store_path / "tmp" / "x").mkdir(parents=True))),
    F("Stores", "its folder is a file", "sentence", "store", beforehand(lambda p: (p.store_path.parent.mkdir(), p.store_path.write_bytes(b"")))),
    F("Datasets", "an image is gone", "identical", "", then(lambda p: next((p.folder / "dataset").rglob("*.jpg")).unlink())),
    F("Datasets", "a table is changed; `verify`", "identical", "", verified(lambda p: next((p.folder / "dataset").rglob("sample.json")).write_bytes(b"[]"))),
    F("Datasets", "its lock is torn", "identical", "", then(lambda p: next((p.folder / "dataset").rglob("dataset.lock.json")).write_bytes(b"{"))),
    F("Digests", "the database of digests is torn", "identical", "", then(lambda p: (p.folder / ".bagassets" / "digests.sqlite").write_bytes(b"no database" * 500))),
    F("Digests", "the record with a file is no record", "identical", "", with_record(lambda _: b"\xff{")),
    F("Digests", "it is of another size", "identical", "", with_record(lambda s: {"digest": "0" * 64, "size": s.st_size + 1, "mtime_ns": s.st_mtime_ns})),
    F("Digests", "it is of another time", "identical", "", with_record(lambda s: {"digest": "0" * 64, "size": s.st_size, "mtime_ns": s.st_mtime_ns - 1})),
    F("Digests", "its digest is none", "identical", "", with_record(lambda s: {"digest": "x", "size": s.st_size, "mtime_ns": s.st_mtime_ns})),
    F("Digests", "it has the digest of another content", "identical", "", with_record(lambda s: {"digest": "0" * 64, "size": s.st_size, "mtime_ns": s.st_mtime_ns})),
    F("Machines", "the disk is full from the first image on; it is built again", "identical", "", by_process("700"), is_slow=True),
    F("Machines", "the disk is full from the tables on; it is built again", "identical", "", by_process("3000"), is_slow=True),
    F("Machines", "the build is killed at once; it is built again", "identical", "", by_process(kill_after_s=0.05), is_slow=True),
    F("Machines", "the build is killed in the middle; it is built again", "identical", "", by_process(kill_after_s=0.3), is_slow=True),
    F("Machines", "two builds run at once", "identical", "", at_once, is_slow=True),
]  # fmt: skip
