"""Pictures: what is drawn is where it belongs."""

import dataclasses
import re
import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pyarrow as pa
import pytest

from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.ego_poses import load_trajectory
from bagassets.assets.frames import FRAMES
from bagassets.assets.pictures import over_camera
from bagassets.assets.pictures.birds_eye import BoxAt, birds_eye
from bagassets.assets.pictures.canvas import (
    ACCENT,
    BACKGROUND,
    DIM,
    WARNING,
    blank,
    colour_of,
    jpeg_within,
    read_image,
    read_reduced,
    scaled_to,
    text,
    turbo,
    within,
)
from bagassets.assets.pictures.channels import CameraImages, Clouds, View
from bagassets.assets.pictures.over_camera import future_trajectory, lidar_over_camera
from bagassets.assets.pictures.pictures import (
    GAP_PX,
    HEADER_PX,
    TITLES,
    best_moment,
    boxes_at,
    contact_sheet,
    evenly_spaced,
    reading_at,
    suitable_range_m,
)
from bagassets.assets.pictures.timeline import ROW_PX, TOP_PX, timeline, timeline_facts
from bagassets.assets.preview import PREVIEW
from bagassets.base.errors import RecipeError
from bagassets.defs.records.reporting import result_metadata
from bagassets.geometry.calibration import Calibration
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.se3 import SE3
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Preview
from bagassets.recordings.inventory import Gap, TopicRecord
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.store.store import Store
from bagassets_tests.sample_drives import build_recordings, object_ids

S = 1_000_000_000
START_NS = 1_760_000_000 * S
CAMERA = CameraModel("none", 200, 100, 100.0, 100.0, 99.5, 49.5)
# z forward, x right, y down, in a world with x forward, y left, z up.
FORWARD = SE3.create((0.5, -0.5, 0.5, -0.5), (0.0, 0.0, 0.0))


def drawn_at(picture, background=BACKGROUND):
    """Rows and columns of all pixels that are not background."""
    return np.argwhere((picture.astype(int) - np.array(background) != 0).any(axis=2))


def near(pixel, colour, tolerance=40):
    return np.abs(pixel.astype(int) - np.array(colour)).max() <= tolerance


class TestLidarOverCamera:
    def test_a_point_is_drawn_on_its_pixel_in_the_colour_of_its_distance(self):
        black = np.zeros((100, 200, 3), np.uint8)
        left_up = np.array([[10.0, 2.0, 1.0]])  # 10 m ahead, 2 m left, 1 m up
        picture = lidar_over_camera(black, left_up, View(CAMERA, FORWARD), width=200)
        pixels = drawn_at(picture[:60], (0, 0, 0))
        assert pixels.mean(axis=0) == pytest.approx([39.5, 79.5], abs=1.0)
        near_point = lidar_over_camera(black, left_up / 3, View(CAMERA, FORWARD), width=200)
        red, blue = near_point[39:41, 79:81, 2].max(), near_point[39:41, 79:81, 0].max()
        assert red > 100 > blue

    def test_what_lies_behind_or_beside_is_not_drawn(self):
        black = np.zeros((100, 200, 3), np.uint8)
        points = np.array([[-10.0, 0.0, 0.0], [10.0, 30.0, 0.0], [0.1, 0.0, 0.0], [10.0, 0.0, 9.0]])
        with_points = lidar_over_camera(black, points, View(CAMERA, FORWARD), width=200)
        assert (with_points == lidar_over_camera(black, points[:0], View(CAMERA, FORWARD), width=200)).all()

    def test_near_points_cover_far_ones_and_scaling_keeps_the_place(self):
        black = np.zeros((100, 200, 3), np.uint8)
        line = np.array([[4.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
        picture = lidar_over_camera(black, line, View(CAMERA, FORWARD), width=600)
        pixels = drawn_at(picture[:200, :400], (0, 0, 0))
        assert pixels.mean(axis=0) == pytest.approx([149.5, 299.5], abs=0.6)
        colours = picture[pixels[:, 0], pixels[:, 1]]
        assert (colours[:, 2] > colours[:, 0]).all(), "the red one is in front"

    @pytest.mark.parametrize("number", [3, 9000])
    def test_a_dot_at_the_edge_is_drawn_as_far_as_it_is_inside(self, number):
        black = np.zeros((100, 200, 3), np.uint8)
        corner = np.array([[10.0, 9.95, 4.95]] * number)  # the pixel (0, 0)
        picture = lidar_over_camera(black, corner, View(CAMERA, FORWARD), width=200)
        pixels = drawn_at(picture[:60], (0, 0, 0))
        assert len(pixels)
        assert pixels.max() <= 1

    def test_a_wide_lens_does_not_fold_back_into_its_image(self):
        lens = CameraModel("plumb_bob", 200, 100, 100.0, 100.0, 99.5, 49.5, (-0.3, 0.0, 0.0, 0.0, 0.0))
        x = 1.0 / np.tan(np.deg2rad(80))
        _, _, seen = View(lens, FORWARD).project(np.array([[x, 1.0, 0.0], [10.0, 1.0, 0.0]]))
        assert seen.tolist() == [False, True]


class TestBirdsEye:
    def test_everything_is_where_it_is_around_the_vehicle(self):
        ego = SE3.create((np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)), (100.0, 50.0, 0.0))  # heading north
        ahead = ego.transform_points(np.array([[20.0, 0.0, 0.5]]))
        box = BoxAt("vehicle.car", ego @ SE3.create((1, 0, 0, 0), (-20.0, 10.0, 0.0)), 2.0, 5.0)
        past = ego.transform_points(np.array([[-30.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
        picture = birds_eye(ahead, [box], past, ego, range_m=50.0, width=500)
        # 5 pixels per metre; forward is up, left is left.
        assert tuple(picture[150, 250]) != (62, 56, 52)
        assert near(picture[375, 250], ACCENT), "the way so far, 25 m behind"
        assert near(picture[250, 250], ACCENT), "the vehicle itself"
        for forward, left in ((-17.5, 10.0), (-22.5, 10.0), (-20.0, 11.0), (-20.0, 9.0)):
            place = picture[round(250 - forward * 5), round(250 - left * 5)]
            assert near(place, colour_of(0)), (forward, left)
        assert near(picture[(250 + 21 * 5), (250 - 10 * 5)], BACKGROUND, 5), "boxes are outlines"

    def test_the_vehicle_does_not_hide_what_is_around_a_small_robot(self):
        nothing, still = np.zeros((0, 3)), SE3.create((1, 0, 0, 0), (0.0, 0.0, 0.0))
        picture = birds_eye(nothing, [], nothing, still, range_m=2.0, width=400)
        assert 0 < (picture == np.array(ACCENT)).all(axis=2).mean() < 0.01

    def test_boxes_are_those_of_the_moment_and_interpolated(self):
        table = BoxTable(
            stamps_ns=np.array([0, S, 0], dtype=np.int64),
            tracks=["a", "a", "gone"],
            categories=["car", "car", "truck"],
            attributes=[[], [], []],
            centers_m=np.array([[0.0, 0, 0], [4.0, 0, 0], [9.0, 9, 9]]),
            rotations=np.tile([1.0, 0, 0, 0], (3, 1)),
            sizes_m=np.tile([2.0, 5.0, 1.5], (3, 1)),
            scores=np.ones(3),
            sources=["/boxes"] * 3,
        )
        (box,) = boxes_at(table, S // 2)
        assert (box.category, box.width_m, box.length_m) == ("car", 2.0, 5.0)
        assert box.global_SE3_box.translation == pytest.approx((2.0, 0.0, 0.0))

    def test_of_boxes_without_identity_those_of_the_nearest_message_are_shown(self):
        table = BoxTable(
            stamps_ns=np.array([0, 0, S // 10], dtype=np.int64),
            tracks=["", "", ""],
            categories=["car", "truck", "car"],
            attributes=[[], [], []],
            centers_m=np.array([[0.0, 0, 0], [9.0, 9, 9], [1.0, 0, 0]]),
            rotations=np.tile([1.0, 0, 0, 0], (3, 1)),
            sizes_m=np.tile([2.0, 5.0, 1.5], (3, 1)),
            scores=np.ones(3),
            sources=["/boxes"] * 3,
        )
        assert [box.category for box in boxes_at(table, S // 25)] == ["car", "truck"]
        (box,) = boxes_at(table, S // 15)
        assert box.global_SE3_box.translation == pytest.approx((1.0, 0.0, 0.0))
        assert boxes_at(table, S) == []

    def test_the_range_suits_the_points(self):
        ego = SE3.create((1, 0, 0, 0), (100.0, 0.0, 0.0))
        room = np.array([[100.0 + x, y, 0.0] for x in (-6.0, 6.0) for y in (-4.0, 4.0)])
        assert suitable_range_m(room, ego) == 7.0
        assert suitable_range_m(room + np.array([20.0, 0.0, 0.0]), ego) == 30.0
        assert suitable_range_m(room + np.array([80.0, 0.0, 0.0]), ego) == 100.0
        assert suitable_range_m(room * 100, ego) == 200.0
        assert suitable_range_m((room - [100.0, 0.0, 0.0]) / 50 + [100.0, 0.0, 0.0], ego) == 2.0
        assert suitable_range_m(room[:0], ego) == 50.0


class TestFuture:
    def test_the_band_covers_the_way_that_is_driven(self):
        grey = np.full((100, 200, 3), 120, np.uint8)
        camera = View(CAMERA, FORWARD @ SE3.create((1, 0, 0, 0), (0.0, -1.5, 0.0)))  # 1.5 m above the ground
        seconds = np.arange(0, 4.01, 0.1)
        way = np.stack([5 * seconds, 0.25 * seconds**2, 0 * seconds], axis=1)
        rotations = np.tile([1.0, 0, 0, 0], (len(seconds), 1))
        picture = future_trajectory(grey, way, rotations, seconds, camera, width=200)
        green = np.argwhere((picture[:, :, 1].astype(int) - picture[:, :, 2]) > 15)
        assert len(green) > 100
        for second in (1.5, 2.5, 3.5):
            point = np.array([[5 * second, 0.25 * second**2, 0.0]])
            ((u, v),) = camera.project(point)[0]
            pixel = picture[round(v), round(u)].astype(int)
            assert pixel[1] - pixel[2] > 15, f"green {second} s ahead"
        assert (picture[:45] == 120).all(), "nothing above the horizon"

    def test_colours_are_mixed_alike_on_every_processor(self):
        """Not by OpenCV's addWeighted, whose last bit depends on it; those with AVX2 go on as before."""
        band, picture = (np.ascontiguousarray(part) for part in np.mgrid[0:256, 0:256].astype(np.uint8))
        mixed = over_camera._MIXED[band, picture]
        assert np.abs(mixed - (0.45 * band + 0.55 * picture)).max() <= 0.5 + 1e-5
        theirs = cv2.addWeighted(band, 0.45, picture, 1 - 0.45, 0.0)
        avx2 = 11  # CV_CPU_AVX2
        assert np.count_nonzero(mixed != theirs) <= (0 if cv2.checkHardwareSupport(avx2) else 100)

    def test_a_vehicle_that_stands_draws_nothing(self):
        grey = np.full((100, 200, 3), 120, np.uint8)
        still, turned = np.zeros((5, 3)), np.tile([1.0, 0, 0, 0], (5, 1))
        picture = future_trajectory(grey, still, turned, np.arange(5) / 10, View(CAMERA, FORWARD), width=200)
        assert (picture == 120).all()


class TestContactSheet:
    def test_tiles_are_in_their_row_and_column(self):
        images = {
            name: [np.full((50, 100, 3), 10 * row + column, np.uint8) for column in range(3)]
            for row, name in enumerate(("A", "B"), start=10)
        }
        images["B"][1] = None
        sheet = contact_sheet(images, [0.5, 1.5, 2.5], 400)
        width = (400 - 4 * GAP_PX) // 3
        height = round(width / 2)
        for row, name in enumerate(images):
            for column, image in enumerate(images[name]):
                y = HEADER_PX + row * (height + GAP_PX) + height - 5
                x = GAP_PX + column * (width + GAP_PX) + width - 5
                expected = BACKGROUND if image is None else image[0, 0]
                assert tuple(sheet[y, x]) == tuple(expected), (name, column)


def topic(name, count, first_ns, last_ns, rate_hz=None, gaps=()):
    """Return a topic as an inventory has it, as far as the timeline shows it."""
    fields = dict.fromkeys(field.name for field in dataclasses.fields(TopicRecord))
    told = {"name": name, "count": count, "first_ns": first_ns, "last_ns": last_ns, "rate_hz": rate_hz}
    return TopicRecord(**fields | told | {"gaps": gaps, "gap_count": len(gaps)})


def facts_of(*topics, start_ns=START_NS, end_ns=START_NS + 10 * S):
    inventory = SimpleNamespace(start_ns=start_ns, end_ns=end_ns, topics={one.name: one for one in topics})
    return timeline_facts(inventory)


def camera_images(folder, images, **facts):
    """Return a camera with these PNG images, one a second, as an artifact has them."""
    for number, image in enumerate(images):
        (folder / f"{number}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    rows = [
        {"stamp_ns": number * S, "file": f"{number}.png", "height": image.shape[0], "width": image.shape[1]}
        for number, image in enumerate(images)
    ]
    artifact = SimpleNamespace(
        path=folder.joinpath,
        read_table=lambda _, columns: pa.Table.from_pylist(rows).select(columns),
        read_json=lambda _: {"fileformat": "png", "camera_intrinsic": [], **facts},
    )
    return CameraImages.of("CAM_DEPTH", artifact, FORWARD, None)


class TestDepth:
    def ramp_mm(self, low, high):
        """Return a row of each depth, and a corner without depth; few pixels are farther or nearer than all others."""
        depth = np.tile(np.linspace(low, high, 200), (100, 1)).astype(np.uint16)
        depth[:20, :20], depth[50, 0], depth[50, 1] = 0, 60_000, 1
        return depth

    def test_pixels_are_as_bright_as_they_are_far_in_one_range_for_all_images(self, tmp_path):
        camera = camera_images(
            tmp_path, [self.ramp_mm(500, 2000), self.ramp_mm(800, 2500), self.ramp_mm(500, 3000)]
        )
        low, high = camera.levels
        assert low == pytest.approx(500, abs=40)
        assert high == pytest.approx(3000, abs=120)
        assert camera.title == f"CAM_DEPTH, grey {low} to {high}"
        for number in range(3):
            recorded = cv2.imread(str(tmp_path / f"{number}.png"), cv2.IMREAD_UNCHANGED)
            shown = camera.read(number)[:, :, 0].astype(float)
            share = (np.clip(recorded.astype(float), low, high) - low) / (high - low)
            assert np.abs(shown - np.where(recorded > 0, 40 + 215 * share, 0)).max() <= 1
            assert (camera.read_reduced(number, 200)[:, :, 0] == shown).all()

    def test_the_range_is_in_metres_where_the_unit_is_known(self, tmp_path):
        camera = camera_images(tmp_path, [self.ramp_mm(500, 3000)], depth={"unit_m": 0.002})
        low, high = (level * 0.002 for level in camera.levels)
        assert camera.title == f"CAM_DEPTH, {low:.2f} to {high:.2f} m"

    def test_images_of_8_bits_stay_as_they_are(self, tmp_path):
        grey = np.tile(np.arange(200, dtype=np.uint8), (100, 1))
        camera = camera_images(tmp_path, [grey])
        assert (camera.levels, camera.title) == (None, "CAM_DEPTH")
        assert (camera.read(0)[:, :, 0] == grey).all()

    @pytest.mark.parametrize("level", [0, 7])
    def test_an_image_of_one_level_is_a_picture_too(self, tmp_path, level):
        camera = camera_images(tmp_path, [np.full((10, 20), level, np.uint16)])
        assert camera.read(0).shape == (10, 20, 3)
        assert (camera.read(0) > 0).all() == (level > 0)


TOPICS = (
    topic("/a", 100, START_NS, START_NS + 10 * S, 10.0),
    topic("/b", 40, START_NS + 5 * S, START_NS + 10 * S, 8.0, (Gap(START_NS + 7 * S, 1.0),)),
    topic("/c", 0, None, None),
)


class TestTimeline:
    def test_bars_and_gaps_are_where_the_messages_were_and_were_not(self):
        picture = timeline(facts_of(*TOPICS), 1000)
        left, right = 360, 922

        def at(row, second):
            return picture[TOP_PX + ROW_PX * row + 9, round(left + second / 10 * (right - left))]

        assert all(near(at(0, second), ACCENT) for second in (0.1, 5.0, 9.9))
        assert near(at(1, 2.5), BACKGROUND, 5)
        assert near(at(1, 6.0), ACCENT)
        assert near(at(1, 7.5), WARNING)
        assert near(at(1, 9.0), ACCENT)
        assert near(at(2, 5.0), BACKGROUND, 5)

    def test_of_many_topics_the_busiest_are_shown(self):
        facts = facts_of(*(topic(f"/{n:03d}", n, START_NS, START_NS + 10 * S) for n in range(80)))
        assert [one["name"] for one in facts["topics"]] == [f"/{n:03d}" for n in range(32, 80)]
        assert timeline(facts, 800).shape[0] == TOP_PX + ROW_PX * 49 + 8

    @pytest.mark.parametrize(
        ("topics", "line"),
        [
            (49, "and 1 more topic with fewer messages"),
            (50, "and 2 more topics with fewer messages"),
        ],
    )
    def test_the_last_line_counts_those_that_are_not_shown(self, topics, line):
        many = [topic(f"/{n:03d}", n, START_NS, START_NS + 10 * S) for n in range(topics)]
        below = timeline(facts_of(*many), 800)[TOP_PX + ROW_PX * 48 :]
        expected = blank(800, len(below))
        text(expected, line, 10, 13, size_px=10, colour=DIM)
        assert np.array_equal(below[3:, :280], expected[3:, :280])

    def test_an_empty_recording_has_one_too(self):
        assert timeline(facts_of(start_ns=None, end_ns=None), 800).shape[1] == 800

    def test_it_is_told_only_what_it_shows(self):
        told = facts_of(*TOPICS)
        later = topic("/a", 100, START_NS, START_NS + 10 * S + 1, 10.01)
        assert facts_of(later, *TOPICS[1:], end_ns=START_NS + 10 * S + 1) == told
        assert facts_of(dataclasses.replace(TOPICS[0], count=101), *TOPICS[1:]) == told
        assert facts_of(dataclasses.replace(TOPICS[0], rate_hz=10.1), *TOPICS[1:]) != told
        assert facts_of(*TOPICS, topic("/d", 1, START_NS, START_NS)) != told


class TestMoments:
    STAMPS = np.arange(0, 100 * S, S // 10, dtype=np.int64)

    def test_the_middle_with_enough_ahead(self):
        index = best_moment(self.STAMPS, [], 4 * S, S // 10)
        assert self.STAMPS[index] == pytest.approx(50 * S, abs=S)
        short = self.STAMPS[:60]
        assert short[best_moment(short, [], 4 * S, S // 10)] == pytest.approx(1.9 * S, abs=S / 5)

    def test_a_moment_that_the_lidar_has_too_is_preferred(self):
        index = best_moment(self.STAMPS, [np.array([80 * S], dtype=np.int64)], S, S // 100)
        assert self.STAMPS[index] == 80 * S
        assert best_moment(self.STAMPS[:0], [self.STAMPS], S, S) is None

    def test_spacing_and_tolerance(self):
        assert evenly_spaced(0, 100, 2) == [25, 75]
        assert reading_at(self.STAMPS, 4 * S + 3, 5) == 40
        assert reading_at(self.STAMPS, 4 * S + 30, 5) is None
        assert reading_at(self.STAMPS[:0], 0, 5) is None


class TestCanvas:
    def test_jpegs_stay_below_their_limit(self):
        noise = np.random.default_rng(0).integers(0, 255, (600, 900, 3), dtype=np.uint8)
        for limit in (40_000, 5_000, 1_000):
            data = jpeg_within(noise, limit, 640)
            assert len(data) <= limit
            assert cv2.imdecode(np.frombuffer(data, np.uint8), 1).shape[1] <= 640

    def test_large_jpegs_are_decoded_small(self, tmp_path):
        cv2.imwrite(str(tmp_path / "a.jpg"), np.full((800, 1600, 3), 77, np.uint8))
        assert read_reduced(tmp_path / "a.jpg", 1600, 200).shape == (100, 200, 3)
        assert read_reduced(tmp_path / "a.jpg", 1600, 300).shape == (200, 400, 3)
        assert read_reduced(tmp_path / "a.jpg", 1600, 900).shape == (800, 1600, 3)
        assert read_image(tmp_path / "a.jpg").shape == (800, 1600, 3)

    @pytest.mark.parametrize("size", [(900, 1400), (401, 640), (333, 512), (300, 480), (77, 120), (1, 900)])
    def test_scaling_moves_nothing(self, size):
        rows, columns = size
        width = 320
        slope = np.linspace(0, 255, columns, dtype=np.float64)
        image = np.repeat(np.broadcast_to(slope.round().astype(np.uint8), size)[:, :, None], 3, axis=2)
        scaled = scaled_to(image, width)
        assert scaled.shape == (max(1, round(rows * width / columns)), width, 3)
        wanted = np.interp((np.arange(width) + 0.5) * columns / width - 0.5, np.arange(columns), slope)
        # The last pixels are repeated until they fill a square, and the others are pushed together by at most that.
        assert (
            np.abs(scaled[:, :, 1] - wanted).max()
            <= 2 + 255 * (-columns % max(1, columns // width)) / columns
        )

    def test_a_flat_image_keeps_its_lower_edge(self):
        image = np.zeros((13, 9000, 3), np.uint8)
        image[7:] = 255
        assert scaled_to(image, 1280)[-1].min() > 200

    def test_no_picture_is_turned_by_exif_as_pixels_and_points_would_not_fit(self, tmp_path):
        data = cv2.imencode(".jpg", np.full((1080, 1920, 3), 77, np.uint8))[1].tobytes()
        turned = b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)
        exif = b"Exif\0\0" + turned
        (tmp_path / "a.jpg").write_bytes(
            data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]
        )
        assert read_reduced(tmp_path / "a.jpg", 1920, 213).shape == (135, 240, 3)
        assert read_image(tmp_path / "a.jpg").shape == (1080, 1920, 3)

    def test_of_levels_the_lower_is_dark_the_upper_white_and_nothing_is_black(self, tmp_path):
        depth_mm = np.tile(np.array([0, 500, 1000, 2000, 3000], np.uint16), (4, 1))
        (tmp_path / "depth.png").write_bytes(cv2.imencode(".png", depth_mm)[1].tobytes())
        shown = within(1000, 2000, read_image(tmp_path / "depth.png"))
        assert shown.dtype == np.uint8
        assert shown[0, :, 0].tolist() == [0, 40, 40, 255, 255]
        assert (shown == shown[:, :, :1]).all()

    def test_colours_go_from_blue_to_red(self):
        low, high = turbo(np.array([0.1, 0.9]))
        assert low[0] > low[2]
        assert high[2] > high[0]
        assert turbo(np.zeros(0)).shape == (0, 3)
        assert blank(3, 2).shape == (2, 3, 3)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("preview")
    truth = write_recordings([Target(folder / "recordings" / "drive.mcap", "mcap")], seed=5, duration_s=2.6)
    (folder / "recipe.yaml").write_text(sample_recipe() + "preview: {future_s: 1.0}\n")
    recipe = load_recipe(folder / "recipe.yaml")
    return recipe, truth, build_recordings(recipe)["drive.mcap"]


class TestStep:
    def test_all_pictures_are_there_and_small_ones_are_small(self, built):
        _, _, made = built
        artifact = made["preview"].artifact
        facts = artifact.read_json("facts.json")
        assert (facts["pictures"], facts["missing"]) == (list(TITLES), {})
        for name in TITLES:
            full, inline = artifact.path(f"{name}.jpg"), artifact.path(f"inline/{name}.jpg")
            assert inline.stat().st_size <= 40 * 1024
            width, small = cv2.imread(str(full)).shape[1], cv2.imread(str(inline)).shape[1]
            assert width in (1280, 960)
            assert 320 <= small <= 640
        assert artifact.path("thumbnail.jpg").stat().st_size <= 2600

    def test_the_web_ui_gets_them_as_markdown(self, built):
        metadata = result_metadata(built[2]["preview"], PREVIEW.face)
        assert {name for name in metadata if name.startswith("picture_")} == {
            f"picture_{name}" for name in TITLES
        }
        value = metadata["picture_birds_eye"].value
        artifact = built[2]["preview"].artifact
        shown, large = re.fullmatch(r'\[!\[\]\((\S+)\)\]\((\S+) "Bird&#x27;s-eye view"\)', value).groups()
        prefix = f"/bagassets/artifacts/{artifact.digest}/"
        for link in (shown, large):
            assert artifact.path(link.removeprefix(prefix)).is_file()
        # Dagster shows Markdown of up to a thousand characters at once, and longer ones after a click.
        assert all(len(metadata[f"picture_{name}"].value) < 1000 for name in TITLES)
        assert metadata["thumbnail"].value.startswith("![Thumbnail](data:image/jpeg;base64,/9j/")
        assert list(metadata)[: len(TITLES)] == [f"picture_{name}" for name in TITLES]
        assert not any(
            name.startswith("picture_") for name in result_metadata(built[2]["frames"], FRAMES.face)
        )

    def test_lidar_points_of_an_object_lie_on_its_pixels(self, built):
        """Poses, extrinsics, intrinsics and clocks have to be right for this, all of them."""
        recipe, truth, made = built
        store = Store(recipe.store_path)
        written = made["calibration"].artifact.read_json("calibration.json")
        calibration = Calibration.from_json(written).channels

        def channel(asset, name):
            entry = made[asset].artifact.read_json("channels.json")[name]
            return store.artifact(entry["artifact"])

        trajectory = load_trajectory(made["ego_poses"].artifact)
        camera = CameraImages.of(
            "CAM_FRONT", channel("frames", "CAM_FRONT"), calibration["CAM_FRONT"].ego_SE3_sensor, None
        )
        clouds = Clouds.of(
            "LIDAR_TOP",
            channel("sweeps", "LIDAR_TOP"),
            calibration["LIDAR_TOP"].ego_SE3_sensor,
        )
        image = 12
        stamp_ns = int(camera.stamps_ns[image])
        revolution = reading_at(clouds.stamps_ns, stamp_ns, S // 10)
        points = clouds.points_global(revolution, trajectory)
        pixels, _, seen = camera.view(image, trajectory).project(points)
        ids = object_ids(truth, "CAM_FRONT", stamp_ns)
        checked = right = 0
        for box in truth.boxes(int(clouds.stamps_ns[revolution])):
            inside = (
                np.abs(box.odom_SE3_box.inverse().transform_points(points))
                < np.array([box.size_m[1], box.size_m[0], box.size_m[2]]) / 2 + 0.1
            )
            u, v = np.rint(pixels[inside.all(axis=1) & seen]).astype(int).T
            checked += len(u)
            right += int((ids[v, u] == box.track_id).sum())
        # The lidar sits higher: it sees some points over things that hide them from the camera.
        assert checked >= 30
        assert right / checked > 0.8

    def test_the_same_again_gives_the_same_bytes(self, built, tmp_path, monkeypatch):
        read, usual = [], CameraImages.read
        monkeypatch.setattr(
            CameraImages, "read", lambda camera, image: read.append(image) or usual(camera, image)
        )
        recipe, _, made = built
        (tmp_path / "recipe.yaml").write_text((recipe.state.parent / "recipe.yaml").read_text())
        (tmp_path / "recordings").symlink_to(recipe.bags.root)
        again = build_recordings(load_recipe(tmp_path / "recipe.yaml"))["drive.mcap"]
        assert again["preview"].artifact.digest == made["preview"].artifact.digest
        assert len(read) == 1, "two pictures show it"

    def test_what_a_recording_lacks_costs_just_the_pictures_of_it(self, built, tmp_path):
        recipe, _, _ = built
        text = sample_recipe(root=str(recipe.bags.root))
        lines = [line for line in text.splitlines() if "LIDAR_TOP" not in line]
        (tmp_path / "recipe.yaml").write_text("\n".join(lines))
        made = build_recordings(load_recipe(tmp_path / "recipe.yaml"))["drive.mcap"]
        facts = made["preview"].artifact.read_json("facts.json")
        assert facts["missing"] == {"lidar_over_camera": "there is no lidar"}
        assert set(facts["pictures"]) == set(TITLES) - {"lidar_over_camera"}

        lines = [line for line in text.splitlines() if "CAM_" not in line]
        (tmp_path / "recipe.yaml").write_text("\n".join(lines))
        made = build_recordings(load_recipe(tmp_path / "recipe.yaml"))["drive.mcap"]
        facts = made["preview"].artifact.read_json("facts.json")
        assert set(facts["pictures"]) == {"birds_eye", "timeline"}

    def test_a_rig_that_stands_still_has_no_way(self, built, tmp_path):
        recipe, _, _ = built
        text = sample_recipe(root=str(recipe.bags.root))
        text = text.replace("{source: odometry, topic: /odom}", "{source: fixed}").replace(
            "deskew: true", "deskew: false"
        )
        lines = [line for line in text.splitlines() if "annotations" not in line]
        (tmp_path / "recipe.yaml").write_text("\n".join(lines))
        made = build_recordings(load_recipe(tmp_path / "recipe.yaml"))["drive.mcap"]
        facts = made["preview"].artifact.read_json("facts.json")
        assert facts["missing"] == {"future_trajectory": "the rig stands still"}
        assert "lidar_over_camera" in facts["pictures"]

    def test_a_channel_that_no_rig_has_is_refused(self, tmp_path):
        (tmp_path / "recipe.yaml").write_text(sample_recipe() + "preview: {lidar: CAM_FRONT}\n")
        with pytest.raises(RecipeError, match="no rig has a lidar CAM_FRONT"):
            load_recipe(tmp_path / "recipe.yaml")

    def test_it_can_be_switched_off_and_other_settings_draw_anew(self, built):
        recipe, _, _ = built
        off = build_recordings(recipe.model_copy(update={"preview": Preview(enabled=False)}))
        assert "preview" not in off["drive.mcap"]
        other = recipe.model_copy(update={"preview": Preview(width=640, columns=3)})
        made = build_recordings(other)["drive.mcap"]
        assert {name for name, result in made.items() if not result.cached} == {"preview"}
        assert cv2.imread(str(made["preview"].artifact.path("contact_sheet.jpg"))).shape[1] == 640
