"""Recordings that ask for more memory than there is: what it costs, what is said, and what it takes to notice."""

import bz2
import os
import struct
import sys
import time
from pathlib import Path

import cv2
import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader

from bagassets.assets import inventory
from bagassets.assets.asset import as_json
from bagassets.base.errors import CalibrationError, DecodeError, RecordingError, SizeLimitError
from bagassets.engine.execute import BuildFailure
from bagassets.formats.catalogue import recording_assets
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets.recipe.model import READING_LIMITS, Limits
from bagassets.recordings.chunks import LatestChunks
from bagassets.recordings.damage import DamageError
from bagassets.recordings.decompress import _DECOMPRESSORS, TooLargeError, decompress
from bagassets.recordings.elements import announced_elements, check_elements, fewest_bytes_of
from bagassets.recordings.layouts import choice_of
from bagassets.recordings.model import Definition
from bagassets.recordings.open import open_recording
from bagassets_tests import hostile
from bagassets_tests.facts import MadeUpFacts
from bagassets_tests.hostile import RULE, cdr, image_message
from bagassets_tests.layout_data import inventory_of, serialized
from bagassets_tests.recorded_bags import NOON_NS, text, write_ros1, write_ros2
from bagassets_tests.recorded_bags import write_mcap as write_texts
from bagassets_tests.small_drive import HEIGHT, RECIPE, WIDTH
from bagassets_tests.tiny_mcap import write_tiny
from bagassets_tests.tree_memory import run_measured
from bagassets_tests.whole.test_end_to_end import build_of, make_project

pytestmark = pytest.mark.once

MOST_BYTES = 2_000_000_000
SIX_GB = 5_800_000_000
BAGASSETS = Path(sys.executable).with_name("bagassets")

HOSTILE = {
    **{
        f"definition with {name}": (lambda path, name=name: hostile.write_definition(path / "a.mcap", name), says, 0)
        for name, says in {
            "a thousand million strings": "limits.array_length",
            "a thousand million messages": "limits.array_length",
            "arrays in arrays": "limits.array_length",
            "more lists than bytes": "limits.message_elements",
            "a negative length": "an array of -1 elements",
        }.items()
    },
    "elements without fields": (
        lambda path: hostile.write_empty_elements(path / "a.mcap"), "limits.message_elements", 0,
    ),
    "bz2 chunk that announces little": (
        lambda path: hostile.write_ros1_chunk(path / "a.bag", hostile.bz2_zeros(SIX_GB), 1_000_000),
        "holds more than it announces", 1,
    ),
    "bz2 chunk": (
        lambda path: hostile.write_ros1_chunk(path / "a.bag", hostile.bz2_zeros(SIX_GB), 4_200_000_000),
        "limits.chunk_bytes", 1,
    ),
    "zstd chunk that announces little": (
        lambda path: hostile.write_mcap_chunks(path / "a.mcap", hostile.zstd_zeros(SIX_GB), 1_000_000),
        "holds more than it announces", 1,
    ),
    "zstd chunk": (
        lambda path: hostile.write_mcap_chunks(path / "a.mcap", hostile.zstd_zeros(SIX_GB), SIX_GB),
        "limits.chunk_bytes", 1,
    ),
    "many chunks": (
        lambda path: hostile.write_mcap_chunks(
            path / "a.mcap", zstandard.compress(bytes(250_000_000)), 250_000_000, number=40
        ),
        "limits.compression_ratio", 1,
    ),
    "a file packed whole": (
        lambda path: hostile.write_packed_file(path / "a", SIX_GB), "limits.compression_ratio", 1,
    ),
    "a packed message": (
        lambda path: hostile.write_packed_message(path / "a", SIX_GB), "limits.message_bytes", 0,
    ),
    "computed messages": (lambda path: hostile.write_view(path / "a"), "it has no table 'messages'", 1),
}  # fmt: skip


# These take seconds each; others of their kind do not.
SLOW = {"many chunks", "zstd chunk that announces little"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name in SLOW else name for name in HOSTILE]
)
def test_inspecting_a_hostile_recording_takes_little_memory_and_time(tmp_path, name):
    make, says, status = HOSTILE[name]
    path = make(tmp_path)
    measured = run_measured([BAGASSETS, "inspect", path], cwd=tmp_path, timeout_s=60)
    assert measured.peak_bytes < MOST_BYTES
    assert measured.returncode == status, measured.output
    assert says in measured.output
    assert "Traceback" not in measured.output
    assert "delete" not in measured.output


def project_with(tmp_path, limits="{lost_messages: 1.0}", extra=""):
    text_ = RECIPE + f"preview: {{{{enabled: false}}}}\nlimits: {{{limits}}}\n{extra}"
    recipe = make_project(tmp_path, text=text_)
    recipe.bags.root.mkdir()
    return recipe


def failure_of(recipe, key="a.mcap"):
    with pytest.raises(BuildFailure) as caught:
        list(build_of(recipe, key).build())
    return caught.value.errors


def channel_of(recipe, asset, channel, key="a.mcap"):
    """Build as far as that goes, and return the counts of a channel."""
    for made in build_of(recipe, key).build([*BEFORE, asset]):
        if made.asset == asset:
            return made.artifact.summary()["channels"][channel]
    raise AssertionError(asset)


BEFORE = ("inventory", "calibration", "ego_poses")
PIXELS = "it has more pixels than limits.image_pixels in the recipe allows"
POINTS = "it has more points than limits.cloud_points in the recipe allows"


class TestMessages:
    """What a message announces costs the message, and is counted with a reason that names the limit."""

    @pytest.fixture
    def jpeg(self):
        return cv2.imencode(".jpg", np.zeros((HEIGHT, WIDTH, 3), np.uint8))[1].tobytes()

    @pytest.mark.parametrize("kind", ["png", "jpeg"])
    def test_compressed_images_that_announce_a_size(self, tmp_path, jpeg, kind):
        data = hostile.png_of(100_000, 100_000) if kind == "png" else hostile.jpeg_of(jpeg, 65_000, 65_000)
        recipe = project_with(tmp_path)
        entries = hostile.compressed_drive(lambda number: data if number % 4 == 3 else jpeg)
        hostile.write_mcap(recipe.bags.root / "a.mcap", entries)
        counts = channel_of(recipe, "frames", "CAM_FRONT")
        assert (counts["read"], counts["written"], counts["lost"]) == (11, 9, {PIXELS: 2})

    @pytest.mark.parametrize(
        ("image", "reason"),
        [
            (lambda number: image_message(100_000, 100_000, number=number), "an image of 100000x100000 in rgb8 with step 300000 does not fit 100 bytes"),
            (lambda number: image_message(8, 1, number=number, step=2**32 - 1, data=np.zeros(24, np.uint8)), None),
            (lambda number: image_message(7, 3, number=number, encoding="yuv422", step=14, data=np.zeros(42, np.uint8)), "OpenCV refuses to convert an image of its size and encoding"),
            (lambda number: image_message(9_000, 9_000, number=number, encoding="mono8", step=9_000, data=np.zeros(81_000_000, np.uint8)), PIXELS),
        ],
        ids=["no bytes", "a step", "odd width", "pixels"],
    )  # fmt: skip
    def test_images(self, tmp_path, image, reason):
        recipe = project_with(tmp_path)
        recipe_of_plain_images(recipe)
        hostile.write_mcap(recipe.bags.root / "a.mcap", hostile.plain_drive(image))
        counts = channel_of(load_recipe(tmp_path / "recipe.yaml"), "frames", "CAM_FRONT")
        assert counts["lost"] == ({} if reason is None else {reason: 2})
        assert counts["written"] == (11 if reason is None else 9)

    def test_a_limit_that_lets_images_in_makes_their_step_run_again_and_no_other(self, tmp_path):
        recipe = project_with(tmp_path, "{lost_messages: 1.0, image_pixels: 10000}")
        recipe_of_plain_images(recipe)
        image = lambda number: image_message(200, 100, number=number, data=np.zeros(60_000, np.uint8))
        hostile.write_mcap(recipe.bags.root / "a.mcap", hostile.plain_drive(image))
        file = tmp_path / "recipe.yaml"
        recipe = load_recipe(file)
        assert channel_of(recipe, "frames", "CAM_FRONT")["lost"] == {PIXELS: 2}
        list(build_of(recipe, "a.mcap").build())
        file.write_text(file.read_text().replace("image_pixels: 10000", "image_pixels: 20000"))
        raised = load_recipe(file)
        made = {made.asset: made.cached for made in build_of(raised, "a.mcap").build()}
        assert [asset for asset, cached in made.items() if not cached] == ["frames", "nuscenes_tables"]
        assert channel_of(raised, "frames", "CAM_FRONT")["lost"] == {}
        before, now = recording_assets(recipe).versions, recording_assets(raised).versions
        changed = {asset for asset in made if now[asset] != before[asset]}
        assert changed == {"frames"}

    def test_intrinsics_of_an_image_that_cannot_be(self, tmp_path):
        recipe = project_with(tmp_path)
        entries = hostile.plain_drive(None, info_size=(100_000, 100_000))
        hostile.write_mcap(recipe.bags.root / "a.mcap", entries)
        errors = failure_of(recipe)
        assert isinstance(errors["frames"], CalibrationError)
        assert "limits.image_pixels" in str(errors["frames"])
        assert list(errors) == ["frames"]

    def test_clouds(self, tmp_path):
        recipe = project_with(tmp_path, "{lost_messages: 1.0, cloud_points: 1000}")
        data = np.zeros(2_000, np.uint8)
        entries = hostile.plain_drive(
            None, cloud=lambda number: hostile.cloud_message(2_000, 1, 1, data, number)
        )
        hostile.write_mcap(recipe.bags.root / "a.mcap", entries)
        counts = channel_of(recipe, "sweeps", "LIDAR_TOP")
        assert counts["lost"] == {POINTS: 2}

    @pytest.mark.parametrize(
        ("width", "height", "step"), [(2**32 - 1, 1, 0), (2**31, 2**31, 2**31), (100_000, 100_000, 16), (0, 2**32 - 1, 0)]
    )  # fmt: skip
    def test_clouds_of_any_declared_size(self, tmp_path, width, height, step):
        recipe = project_with(tmp_path)
        cloud = lambda number: hostile.cloud_message(width, height, step, np.zeros(0, np.uint8), number)
        hostile.write_mcap(recipe.bags.root / "a.mcap", hostile.plain_drive(None, cloud=cloud))
        counts = channel_of(recipe, "sweeps", "LIDAR_TOP")
        assert (counts["read"], sum(counts["lost"].values())) == (11, 2)

    def test_a_large_message_is_lost_in_every_format(self, tmp_path):
        entries = [text(NOON_NS + i, "x" * (2_000_000 if i == 1 else 5)) for i in range(3)]
        limits = Limits(message_bytes=1_000_000)
        paths = [
            write_ros1(tmp_path / "a.bag", entries),
            write_ros1(tmp_path / "b.bag", entries, "BZ2"),
            write_ros2(tmp_path / "c", entries),
            write_ros2(tmp_path / "d", entries, "MCAP"),
            write_texts(tmp_path / "e.mcap", entries),
        ]
        for path in paths:
            with open_recording(path, (), limits) as recording:
                first, large, last = recording.messages(["/text"])
                assert [recording.decode(message).data for message in (first, last)] == ["xxxxx"] * 2
                with pytest.raises(DecodeError, match=r"larger than limits\.message_bytes"):
                    recording.decode(large)
            with open_recording(path) as recording:
                assert len(recording.decode(list(recording.messages(["/text"]))[1]).data) == 2_000_000

    def test_what_reads_its_topic_is_keyed_by_whether_it_was_read(self, tmp_path):
        path = write_texts(
            tmp_path / "a.mcap",
            [text(NOON_NS, "x" * 2_000_000), text(NOON_NS + 1, topic="/other")],
        )
        digests = [
            inventory_of(path, tmp_path / str(size), limits=Limits(message_bytes=size))[0].digests(["/text", "/other"])
            for size in (1_000_000, 3_000_000, 4_000_000)
        ]  # fmt: skip
        assert digests[0]["/other"] == digests[1]["/other"]
        assert digests[0]["/text"] != digests[1]["/text"]
        assert digests[1] == digests[2]


def recipe_of_plain_images(recipe):
    """Do without undistortion, so that images of any size are written."""
    file = recipe.state.parent / "recipe.yaml"
    old = "topic: /cam/image_raw"
    file.write_text(file.read_text().replace(old, f"{old}, undistort: false, camera_info: /none", 1))


def check(layout, data, most):
    check_elements(layout.types, layout.msgtype, layout.serialization, data, most)


def fewest_bytes(layout, most):
    return fewest_bytes_of(layout.types, layout.msgtype, layout.serialization, most)


class TestElements:
    """Strings and messages are counted from the bytes, in the same way as they are decoded."""

    TREE = f"string[] names\nLeaf[] leaves\nfloat64[] numbers\n{RULE}MSG: my_msgs/Leaf\nuint8 a\nfloat64 b\nstring[2] pair\nint16[] more\n"

    @pytest.fixture(params=["cdr", "ros1"])
    def layout(self, request):
        return choice_of("my_msgs/msg/Tree", request.param, Definition("msg", self.TREE), ()).best

    def message(self, layout, names, leaves):
        leaf, tree = (layout.store.types[f"my_msgs/msg/{name}"] for name in ("Leaf", "Tree"))
        made = [
            leaf(i % 256, float(i), ["x" * (i % 5), "y"], np.arange(i % 3, dtype=np.int16))
            for i in range(leaves)
        ]
        value = tree(["n" * (i % 7) for i in range(names)], made, np.arange(3.0))
        return serialized(layout, value)

    @pytest.mark.parametrize(("names", "leaves"), [(0, 0), (5, 0), (0, 7), (11, 13)])
    def test_exactly(self, layout, names, leaves):
        data, number = self.message(layout, names, leaves), names + 3 * leaves
        layout.decode(data)
        check(layout, data, number)
        if number:
            with pytest.raises(DecodeError, match=r"limits\.message_elements"):
                check(layout, data, number - 1)

    def test_from_what_size_on_it_matters(self, layout):
        large = fewest_bytes(layout, 1000)
        for names, leaves in ((1001, 0), (0, 334)):
            assert len(self.message(layout, names, leaves)) > large
        assert fewest_bytes(choice_of("std_msgs/msg/String", "cdr", None, ()).best, 1000) is None

    @pytest.mark.parametrize("serialization", ["cdr", "ros1"])
    def test_a_message_without_fields_is_a_byte_in_cdr(self, serialization):
        definition = (
            f"Nothing[] nothing\nfloat64 number\nNothing one\n{RULE}MSG: my_msgs/Nothing\nuint8 CONSTANT=5\n"
        )
        layout = choice_of("my_msgs/msg/A", serialization, Definition("msg", definition), ()).best
        nothing = layout.store.types["my_msgs/msg/Nothing"]
        data = serialized(layout, layout.store.types["my_msgs/msg/A"]([nothing()] * 3, 1.0, nothing()))
        assert len(layout.decode(data).nothing) == 3
        check(layout, data, 4)
        with pytest.raises(DecodeError, match=r"limits\.message_elements"):
            check(layout, data, 3)

    def test_bytes_that_end_too_early_do_not_fit(self, layout):
        data = self.message(layout, 5, 5)
        with pytest.raises(DecodeError, match="its bytes do not fit"):
            check(layout, data[:-3], 1000)

    def test_lists_in_lists_count_together(self):
        definition = f"B[] b\n{RULE}MSG: my_msgs/B\nstring[] c\n"
        layout = choice_of("my_msgs/msg/A", "ros1", Definition("msg", definition), ()).best
        data = struct.pack("<I", 3) + (struct.pack("<I", 2) + struct.pack("<I", 0) * 2) * 3
        check(layout, data, 9)
        with pytest.raises(DecodeError, match=r"limits\.message_elements"):
            check(layout, data, 8)

    def test_types_that_contain_themselves_are_refused(self):
        for reference in ("my_msgs/msg/A", "my_msgs/msg/A[]"):
            assert "contains itself" in choice_of(
                "my_msgs/msg/A", "ros1", Definition("msg", f"{reference.replace('/msg/', '/')} a\n"), ()
            )
        types = {"A": ([], [("x", (1, ("uint8", 0)))])}
        assert (announced_elements(types, "A"), fewest_bytes_of(types, "A", "cdr", 5)) == (0, None)
        check_elements(types, "A", "cdr", cdr(b"\0"), 0)


class TestRecordings:
    """What chunks, topics and connections announce costs the recording, whatever it is read for."""

    @pytest.mark.parametrize("compression", ["none", "lz4", "bz2", "zstd"])
    def test_no_more_is_unpacked_than_was_asked_for(self, compression):

        data = os.urandom(1000) * 3000
        packed = {"none": bytes, "lz4": lz4.frame.compress, "bz2": bz2.compress, "zstd": zstandard.compress}[
            compression
        ](data)
        assert decompress(packed, compression, len(data)) == data
        with pytest.raises(TooLargeError):
            decompress(packed, compression, len(data) - 1)
        if compression in {"bz2", "lz4"}:
            assert len(_DECOMPRESSORS[compression](packed, 10)) == 11  # one more tells that there are more

    def test_streams_that_follow_one_another_take_time_for_their_bytes_only(self):
        nothing, one = bz2.compress(b""), bz2.compress(b"x")
        began_s = time.process_time()
        assert decompress(nothing * 100_000 + one, "bz2", 10) == b"x"
        few_s = time.process_time() - began_s
        assert decompress(nothing * 300_000 + one, "bz2", 10) == b"x"
        many_s = time.process_time() - began_s - few_s
        assert many_s < 6 * few_s + 0.5  # not 9 times
        with pytest.raises(DamageError, match="cut off"):
            decompress((one * 3)[:-1], "bz2", 10)

    @pytest.mark.parametrize(
        ("name", "limits"),
        [
            *((name, {"topics": 2}) for name in ("a.bag", "b.bag", "c.mcap", "d")),
            # A database has neither connections nor chunks.
            *((name, {"connections": 2}) for name in ("a.bag", "b.bag", "c.mcap")),
            *((name, {"chunk_bytes": 1_000_000}) for name in ("a.bag", "b.bag", "c.mcap")),
        ],
        ids=lambda value: value if isinstance(value, str) else next(iter(value)),
    )
    def test_a_recording_over_a_limit(self, tmp_path, name, limits):
        entries = [text(NOON_NS + i, "x" * 2_000_000, topic=f"/text{i % 3}") for i in range(3)]
        path = tmp_path / name
        if name.endswith(".bag"):
            write_ros1(path, entries, "LZ4" if name == "b.bag" else None)
        else:
            (write_texts if name == "c.mcap" else write_ros2)(path, entries)
        with pytest.raises(SizeLimitError, match=rf"limits\.{next(iter(limits))} in the recipe") as caught:
            open_recording(path, (), Limits(**limits))
        assert str(path) in str(caught.value)
        open_recording(path).close()

    def test_chunks_that_messages_jump_between_are_unpacked_a_few_times_only(self):
        loads = []

        def load(at):
            loads.append(at)
            return bytes(10**8)

        chunks = LatestChunks(load, most_bytes=10, total_bytes=10**8, kept=1)
        for i in range(30):
            chunks.at(i % 2)
        assert len(loads) == 30  # twenty times all there is, and a gigabyte
        with pytest.raises(DamageError, match="back and forth"):
            chunks.at(0)

    def test_an_index_that_names_a_chunk_twice_is_damage(self, tmp_path):
        path = hostile.write_mcap_chunks(
            tmp_path / "a.mcap", hostile.small_messages(31), 31, compression="", number=2
        )
        offsets = sorted(chunk.chunk_start_offset for chunk in chunks_in(path))
        data = path.read_bytes()
        path.write_bytes(data.replace(struct.pack("<Q", offsets[1]), struct.pack("<Q", offsets[0])))
        with pytest.raises(RecordingError, match="names a chunk twice"):
            open_recording(path)

    def test_the_inventory_is_keyed_by_limits_only_where_they_are_changed(self):
        def params(**limits):
            known = inventory.InventoryParams((), Limits(**limits).changed(*READING_LIMITS))
            return as_json(inventory.use(known, MadeUpFacts())[""].params)

        assert params() == params(image_pixels=20_000, lost_messages=0.5) == {"format": "mcap"}
        assert params(chunk_bytes=2_000_000) == {"format": "mcap", "chunk_bytes": 2_000_000}


def chunks_in(path):

    with path.open("rb") as stream:
        return make_reader(stream).get_summary().chunk_indexes


@pytest.mark.long
def test_building_hostile_recordings_takes_little_memory_and_others_go_on(tmp_path):
    """With real images as large as they may be, and a good recording beside."""

    recipe = project_with(tmp_path)
    recipe_of_plain_images(recipe)
    root = recipe.bags.root
    write_tiny(root / "good.mcap")
    side = 7_000
    noise = cv2.imencode(".png", np.zeros((side, side, 4), np.uint16))[1].tobytes()
    entries = hostile.compressed_drive(lambda _: noise)
    hostile.write_mcap(root / "images.mcap", entries)
    points = np.zeros(4_900_000, np.uint8)
    clouds = hostile.plain_drive(
        None, cloud=lambda number: hostile.cloud_message(len(points), 1, 1, points, number)
    )
    hostile.write_mcap(root / "clouds.mcap", clouds)
    hostile.write_mcap_chunks(root / "chunk.mcap", hostile.zstd_zeros(SIX_GB), SIX_GB)
    hostile.write_definition(root / "strings.mcap", "a thousand million strings")
    write_project(tmp_path, None)
    measured = run_measured(
        [BAGASSETS, "build", "--recipe", tmp_path / "recipe.yaml"], cwd=tmp_path, timeout_s=300
    )
    assert measured.peak_bytes < MOST_BYTES
    assert measured.returncode == 1, measured.output
    assert "limits.chunk_bytes" in measured.output
    assert "Traceback" not in measured.output
    assert (tmp_path / "dataset").exists()
