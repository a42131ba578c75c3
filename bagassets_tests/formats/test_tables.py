"""One recording's rows, compared with the truth of a drive made by hand."""

from collections import Counter
from dataclasses import replace

import handmade
import numpy as np
import pytest
from handmade import (
    CATEGORY,
    EXTRINSICS,
    IMAGE,
    SIZES,
    T0,
    Drive,
    S,
    ego_pose,
    make_tables,
    object_pose,
    regular,
    rig,
    seconds_of,
    trajectory,
    true_boxes,
)  # fmt: skip

from bagassets.assets.boxes.table import BoxTable
from bagassets.base.errors import DatasetError, PoseError
from bagassets.formats.nuscenes.schema import RECORDING_TABLES
from bagassets.formats.nuscenes.tokens import category_token, sensor_token, visibility_token
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.store.store import Store
from bagassets_tests.nuscenes_checks import check_tables


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return Store(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def made(store):
    return make_tables(store)


def by_token(rows):
    return {row["token"]: row for row in rows}


def rows_of(made):
    return {name: made.table(name) for name in RECORDING_TABLES}


def channel_of(made):
    """calibrated_sensor token -> channel."""
    names = {sensor_token(channel, modality): channel for channel, modality in made.facts["channels"].items()}
    return {row["token"]: names[row["sensor_token"]] for row in made.table("calibrated_sensor")}


def data_of(made, channel):
    names = channel_of(made)
    return [row for row in made.table("sample_data") if names[row["calibrated_sensor_token"]] == channel]


class TestScenesAndSamples:
    def test_one_scene_with_two_keyframes_a_second(self, made):
        (scene,) = made.table("scene")
        samples = made.table("sample")
        assert scene["nbr_samples"] == len(samples) == 8
        assert scene["first_sample_token"] == samples[0]["token"]
        assert scene["last_sample_token"] == samples[-1]["token"]
        assert [s["timestamp"] for s in samples] == [(T0 + i * S // 2) // 1000 for i in range(8)]

    def test_several_scenes_have_chains_of_their_own(self, store):
        made = make_tables(store, Drive(seconds=5.5), length_s=2.0)
        scenes = made.table("scene")
        assert [scene["nbr_samples"] for scene in scenes] == [4, 4, 3]
        assert [scene["name"] for scene in scenes] == ["drive_1_000", "drive_1_001", "drive_1_002"]
        samples = by_token(made.table("sample"))
        for scene in scenes:
            token, walked = scene["first_sample_token"], []
            while token:
                walked.append(token)
                assert samples[token]["scene_token"] == scene["token"]
                token = samples[token]["next"]
            assert len(walked) == scene["nbr_samples"]
            assert walked[-1] == scene["last_sample_token"]

    def test_the_reference_may_be_a_camera(self, store):
        made = make_tables(store, reference="CAM_FRONT")
        cameras = {row["timestamp"] for row in data_of(made, "CAM_FRONT")}
        assert {row["timestamp"] for row in made.table("sample")} <= cameras

    def test_without_lidar_the_first_camera_of_the_recipe_is_the_reference(self, store):
        made = make_tables(store, Drive(channels=("CAM_BACK", "CAM_FRONT")))
        assert made.facts["reference"] == "CAM_BACK"

    def test_a_reference_that_this_recording_lacks_is_refused(self, store):
        with pytest.raises(DatasetError, match=r"scenes.reference LIDAR_TOP has no readings"):
            make_tables(store, Drive(channels=("CAM_FRONT",)), the_rig=rig(), reference="LIDAR_TOP")

    def test_a_rig_without_the_reference_falls_back_to_the_default(self, store):
        made = make_tables(store, Drive(channels=("CAM_FRONT", "CAM_BACK")), reference="LIDAR_TOP")
        assert made.facts["reference"] == "CAM_FRONT"

    def test_log_row(self, store):
        origin = {"kind": "wgs84", "lat": 48.0, "lon": 11.0}
        (log,) = make_tables(store, Drive(origin=origin)).table("log")
        assert (log["logfile"], log["vehicle"], log["location"]) == ("drive_1", "van", "yard")
        assert log["date_captured"] == "2023-11-14"
        assert log["origin"] == origin

    def test_a_pause_that_is_longer_than_a_scene_ends_one(self, store):
        twice = np.concatenate([regular(10, 2.5), regular(10, 2.5, 24.03)])
        drive = Drive(seconds=28.0, stamps={"LIDAR_TOP": twice})
        made = make_tables(store, drive)
        first = by_token(made.table("sample"))
        starts = [first[scene["first_sample_token"]]["timestamp"] for scene in made.table("scene")]
        assert starts == [T0 // 1000, (T0 + 24_030_000_000) // 1000]
        assert [scene["nbr_samples"] for scene in made.table("scene")] == [5, 5]
        assert made.facts["counts"]["scenes_without_keyframe"] == 0
        none = make_tables(store, drive, min_length_s=4.0).facts["counts"]
        assert (none["scenes"], none["remainder_s"], none["longest_remainder_s"]) == (0, 4.8, 2.4)

    @pytest.mark.parametrize("hole_s", [0.14, 0.4, 0.9])
    def test_no_scene_leads_across_a_hole_in_the_poses(self, store, hole_s):
        """However short it is; and what was sensed beside it is in one scene only."""
        drive = Drive(seconds=5.0 + hole_s / 10)
        begin, end = T0 + 2 * S, T0 + 2 * S + round(hole_s * S)
        poses = replace(trajectory(drive), holes_ns=((begin, end),))
        made = make_tables(store, drive, poses=poses)
        samples = by_token(made.table("sample"))
        scenes = [
            [samples[scene[f"{which}_sample_token"]]["timestamp"] * 1000 for which in ("first", "last")]
            for scene in made.table("scene")
        ]
        assert scenes[0][1] <= begin < end <= scenes[1][0]
        rows = made.table("sample_data")
        assert len({row["token"] for row in rows}) == len(rows)
        for row in rows:
            stamp_ns = row["timestamp"] * 1000
            assert not begin < stamp_ns < end - 1000
            scene = samples[row["sample_token"]]["scene_token"]
            assert scene == made.table("scene")[stamp_ns > begin]["token"]

    def test_too_short_for_a_scene_gives_no_rows_at_all_and_says_so(self, store):
        made = make_tables(store, Drive(seconds=0.7))
        assert all(rows == [] for rows in rows_of(made).values())
        assert made.table("files") == []
        counts = made.facts["counts"]
        assert counts["scenes"] == 0
        assert counts["remainder_s"] == pytest.approx(0.6)
        assert counts["channels"]["LIDAR_TOP"]["outside_scenes"] == 7


class TestReadings:
    def test_every_reading_is_accounted_for(self, store):
        stamps = {"CAM_FRONT": regular(12, 6.0, -1.5)}
        made = make_tables(store, Drive(seconds=4.3, stamps=stamps), length_s=4.0)
        for name, counts in made.facts["counts"]["channels"].items():
            used = counts["keyframes"] + counts["sweeps"]
            assert counts["readings"] == used + counts["without_pose"] + counts["outside_scenes"], name
            assert used == len(data_of(made, name))
        front = made.facts["counts"]["channels"]["CAM_FRONT"]
        assert front["without_pose"] > 0
        assert front["outside_scenes"] > 0
        assert len(made.table("files")) == len(made.table("sample_data")) == len(made.table("ego_pose"))

    def test_rows_and_files_agree(self, made):
        files = {row["filename"]: row for row in made.table("files")}
        assert files.keys() == {row["filename"] for row in made.table("sample_data")}
        assert len(files) == len(made.table("files"))
        for row in made.table("sample_data"):
            name = row["filename"]
            assert name.startswith("samples/" if row["is_key_frame"] else "sweeps/")
            assert f"__{row['timestamp']}." in name
            assert int(files[name]["file"].split(".")[0]) // 1000 == row["timestamp"]

    def test_formats_and_sizes(self, made):
        expected = {
            "CAM_FRONT": ("jpg", ".jpg", IMAGE),
            "LIDAR_TOP": ("pcd", ".pcd.bin", (0, 0)),
            "RADAR_FRONT": ("pcd", ".pcd", (0, 0)),
        }
        for channel, (fileformat, extension, size) in expected.items():
            for row in data_of(made, channel):
                assert row["fileformat"] == fileformat
                assert row["filename"].partition(".")[2] == extension[1:]
                assert (row["width"], row["height"]) == size

    def test_each_reading_has_the_interpolated_pose_of_its_own_time(self, made):
        poses = by_token(made.table("ego_pose"))
        used = Counter()
        for row in made.table("sample_data"):
            pose = poses[row["ego_pose_token"]]
            used[pose["token"]] += 1
            assert pose["timestamp"] == row["timestamp"]
            truth = ego_pose((row["timestamp"] * 1000 - T0) / S)
            # Chords of the circle between poses 50 ms apart are off by 0.16 mm.
            np.testing.assert_allclose(pose["translation"], truth.translation, atol=3e-4)
            np.testing.assert_allclose(pose["rotation"], truth.rotation, atol=1e-6)
        assert set(used.values()) == {1}

    def test_keyframe_readings_are_the_nearest_ones(self, made):
        samples = by_token(made.table("sample"))
        for channel in EXTRINSICS:
            rows = data_of(made, channel)
            stamps = np.array([row["timestamp"] for row in rows])
            keyframes = [row for row in rows if row["is_key_frame"]]
            assert len(keyframes) == len(samples)
            for row in keyframes:
                away = np.abs(stamps - samples[row["sample_token"]]["timestamp"])
                assert abs(row["timestamp"] - samples[row["sample_token"]]["timestamp"]) == away.min()

    def test_other_readings_belong_to_the_sample_that_follows(self, made):
        samples = sorted(made.table("sample"), key=lambda row: row["timestamp"])
        stamps = np.array([row["timestamp"] for row in samples])
        for row in made.table("sample_data"):
            if not row["is_key_frame"]:
                following = min(np.searchsorted(stamps, row["timestamp"]), len(samples) - 1)
                assert row["sample_token"] == samples[following]["token"]

    def test_chains_run_through_each_channel_in_order_of_time(self, made):
        for channel in EXTRINSICS:
            rows = data_of(made, channel)
            table = by_token(rows)
            (first,) = [row for row in rows if row["prev"] == ""]
            walked, row = [first["timestamp"]], first
            while row["next"]:
                assert table[row["next"]]["prev"] == row["token"]
                row = table[row["next"]]
                walked.append(row["timestamp"])
            assert walked == sorted(r["timestamp"] for r in rows)

    def test_extrinsics_are_ego_from_sensor_and_intrinsics_those_of_the_image(self, made):
        names = channel_of(made)
        for row in made.table("calibrated_sensor"):
            channel = names[row["token"]]
            np.testing.assert_allclose(row["translation"], EXTRINSICS[channel]["translation"])
            np.testing.assert_allclose(row["rotation"], EXTRINSICS[channel]["rotation"], atol=1e-9)
            assert np.shape(row["camera_intrinsic"]) == ((3, 3) if channel.startswith("CAM") else (0,))

    def test_a_channel_that_starts_late_costs_the_keyframes_before_it(self, store):
        made = make_tables(store, Drive(stamps={"CAM_FRONT": regular(12, 2.0, 2.0)}))
        assert len(made.table("sample")) == 4
        counts = made.facts["counts"]
        assert (counts["dropped_keyframes"], counts["lacking_samples"]) == (4, 0)
        assert counts["channels"]["CAM_FRONT"]["lacking_at_keyframes"] == {
            "keyframes": 4, "before_first": 4, "after_last": 0,
        }  # fmt: skip
        assert counts["channels"]["CAM_FRONT"]["span_ns"][0] == T0 + 2 * S
        assert counts["channels"]["CAM_BACK"]["lacking_at_keyframes"]["keyframes"] == 0
        self.assert_complete(made)

    def test_so_does_one_that_stops_and_one_that_pauses(self, store):
        front, radar = regular(12, 2.0, 0.0), regular(13, 4.0)
        pause = (radar > T0 + 0.7 * S) & (radar < T0 + 1.4 * S)
        made = make_tables(store, Drive(stamps={"CAM_FRONT": front, "RADAR_FRONT": radar[~pause]}))
        assert [round(seconds_of(1000 * row["timestamp"]), 3) for row in made.table("sample")] == [
            0.0,
            0.5,
            1.5,
            2.0,
        ]
        counts = made.facts["counts"]
        assert counts["dropped_keyframes"] == 4
        assert counts["channels"]["CAM_FRONT"]["lacking_at_keyframes"]["after_last"] == 3
        assert counts["channels"]["RADAR_FRONT"]["lacking_at_keyframes"] == {
            "keyframes": 1, "before_first": 0, "after_last": 0,
        }  # fmt: skip
        self.assert_complete(made)

    def test_a_keyframe_moves_rather_than_be_dropped(self, store):
        front = regular(12, 4.0)
        gap = (front > T0 + 0.85 * S) & (front < T0 + 1.2 * S)
        made = make_tables(store, Drive(stamps={"CAM_FRONT": front[~gap]}))
        seconds = [round(seconds_of(1000 * row["timestamp"]), 3) for row in made.table("sample")]
        assert seconds == [0.0, 0.5, 0.9, 1.5, 2.0, 2.5, 3.0, 3.5]
        assert made.facts["counts"]["dropped_keyframes"] == 0
        self.assert_complete(made)

    @staticmethod
    def assert_complete(made):
        names = channel_of(made)
        held = Counter(
            (row["sample_token"], names[row["calibrated_sensor_token"]])
            for row in made.table("sample_data")
            if row["is_key_frame"]
        )
        assert set(held.values()) == {1}
        assert len(held) == len(made.table("sample")) * len(made.facts["channels"])

    def test_samples_may_be_allowed_to_lack_a_channel_and_are_counted(self, store):
        made = make_tables(store, Drive(stamps={"CAM_FRONT": regular(12, 2.0, 2.0)}), missing="allow")
        assert len(made.table("sample")) == 8
        counts = made.facts["counts"]
        assert (counts["dropped_keyframes"], counts["lacking_samples"]) == (0, 4)
        assert counts["channels"]["CAM_FRONT"]["lacking_at_keyframes"]["before_first"] == 4
        assert counts["channels"]["CAM_FRONT"]["keyframes"] == 4

    def test_a_channel_without_any_reading_costs_no_keyframe(self, store):
        made = make_tables(store, Drive(stamps={"CAM_FRONT": regular(12, 0.0)}))
        assert len(made.table("sample")) == 8
        assert made.facts["counts"]["channels"]["CAM_FRONT"]["span_ns"] == []

    def test_poses_that_share_no_time_with_the_readings_fail_with_both_times(self, store):
        elsewhere = Trajectory(np.array([S, 2 * S]), np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), S, 0)
        with pytest.raises(
            PoseError, match=r"none of the 40 readings of LIDAR_TOP has an ego pose.*1970-01-01T00:00:01"
        ):
            make_tables(store, key="lost", poses=elsewhere)

    def test_a_fixed_pose_holds_for_all_readings(self, store):
        fixed = Trajectory(
            np.zeros(1, np.int64), np.ones((1, 3)), np.array([[1.0, 0, 0, 0]]), 0, 0, fixed=True
        )
        made = make_tables(store, key="static", poses=fixed)
        assert all(row["translation"] == [1.0, 1.0, 1.0] for row in made.table("ego_pose"))


class TestBoxes:
    def test_boxes_stand_where_the_objects_are_at_the_time_of_the_sample(self, store):
        # Observations are nowhere at the time of a keyframe.
        made = make_tables(store, Drive(box_phase_s=0.037))
        samples, instances = by_token(made.table("sample")), by_token(made.table("instance"))
        annotations = made.table("sample_annotation")
        assert len(annotations) == 3 * 8
        names = {(category_token(CATEGORY[n]), SIZES[n]): n for n in SIZES}
        for row in annotations:
            name = names[instances[row["instance_token"]]["category_token"], tuple(row["size"])]
            truth = object_pose(name, (samples[row["sample_token"]]["timestamp"] * 1000 - T0) / S)
            np.testing.assert_allclose(row["translation"], truth.translation, atol=1e-5)
            np.testing.assert_allclose(row["rotation"], truth.rotation, atol=1e-5)

    def test_points_are_those_in_the_files_of_the_keyframe(self, made):
        # 60 lidar points lie on each object, and 4 radar targets inside it at the time of the radar.
        for row in made.table("sample_annotation"):
            assert row["num_lidar_pts"] == 60
            assert row["num_radar_pts"] == 4

    def test_returns_just_before_a_moving_object_are_its_own(self, store, monkeypatch):
        """All rays end 0.5 m behind the object, which moves 0.4 m in a revolution, or stands: then it is hidden."""

        def behind(name, t, rng, number=60, shrink=1.0):
            at = rng.uniform([0, -0.3, 0.1], [0, 0.3, 0.4], (number, 3)) - [SIZES[name][1] / 2 + 0.5, 0, 0]
            return object_pose(name, t).transform_points(at)

        monkeypatch.setattr(handmade, "surface_points", behind)
        made = make_tables(store, Drive(seconds=1.5, seed=7, channels=("CAM_FRONT", "LIDAR_TOP")))
        first = made.table("sample")[0]["token"]
        levels = {
            tuple(row["size"]): row["visibility_token"]
            for row in made.table("sample_annotation")
            if row["sample_token"] == first
        }
        assert levels[SIZES["moving"]] == visibility_token("v60-80"), "no point in it, so not more"
        assert levels[SIZES["parked"]] == visibility_token("v0-40")

    def test_without_lidar_there_are_no_lidar_points(self, store):
        made = make_tables(store, Drive(channels=("CAM_FRONT",)))
        assert {row["num_lidar_pts"] for row in made.table("sample_annotation")} == {0}

    def test_chains_and_instances(self, made):
        annotations, samples = by_token(made.table("sample_annotation")), by_token(made.table("sample"))
        for instance in made.table("instance"):
            token, times = instance["first_annotation_token"], []
            while token:
                row = annotations[token]
                assert row["instance_token"] == instance["token"]
                times.append(samples[row["sample_token"]]["timestamp"])
                last, token = token, row["next"]
            assert last == instance["last_annotation_token"]
            assert len(times) == instance["nbr_annotations"]
            assert times == sorted(times)

    def test_instances_do_not_cross_scenes(self, store):
        made = make_tables(store, Drive(seconds=5.5), length_s=2.0)
        samples = by_token(made.table("sample"))
        scenes_of = {}
        for row in made.table("sample_annotation"):
            scenes_of.setdefault(row["instance_token"], set()).add(
                samples[row["sample_token"]]["scene_token"]
            )
        assert len(scenes_of) == 3 * 3
        assert all(len(scenes) == 1 for scenes in scenes_of.values())

    def test_attributes(self, made):
        assert made.facts["attributes"] == ["pedestrian.moving", "vehicle.moving", "vehicle.parked"]
        assert {len(row["attribute_tokens"]) for row in made.table("sample_annotation")} == {1}
        boxes = made.facts["counts"]["boxes"]
        assert (boxes["attributes_given"], boxes["attributes_by_motion"]) == (
            16,
            8,
        )  # nothing is given the walker

    def test_a_track_is_interpolated_over_gaps_up_to_the_recipe_s_limit(self, store):
        slow = true_boxes(Drive(), hz=1.0, phase_s=0.25)
        annotations = make_tables(store, table=slow).table("sample_annotation")
        assert len(annotations) == 3 * 8
        strict = make_tables(store, table=slow, box_gap_s=0.5)
        assert strict.table("sample_annotation") == []
        assert strict.facts["counts"]["boxes"]["tracks_without_keyframe"] == 3
        held = make_tables(store, table=slow, box_gap_s=0.5, tolerance_s=0.3)
        assert held.facts["counts"]["boxes"]["held"] == len(held.table("sample_annotation")) > 0

    def test_a_track_that_pauses_keeps_its_chain(self, store):
        boxes = true_boxes(Drive())
        seconds = np.array([seconds_of(stamp) for stamp in boxes.stamps_ns])
        kept = np.flatnonzero((seconds < 0.8) | (seconds > 2.6)).tolist()
        paused = BoxTable(
            boxes.stamps_ns[kept], [boxes.tracks[i] for i in kept], [boxes.categories[i] for i in kept],
            [boxes.attributes[i] for i in kept], boxes.centers_m[kept], boxes.rotations[kept], boxes.sizes_m[kept],
            boxes.scores[kept], [boxes.sources[i] for i in kept],
        )  # fmt: skip
        made = make_tables(store, table=paused)
        assert [row["nbr_annotations"] for row in made.table("instance")] == [4, 4, 4]
        assert check_tables(rows_of(made)) == []

    def test_the_category_of_an_instance_is_that_of_most_of_its_boxes(self, store):
        boxes = true_boxes(Drive())
        odd = [
            "vehicle.truck" if track == "parked" and i < 15 else category
            for i, (track, category) in enumerate(zip(boxes.tracks, boxes.categories, strict=True))
        ]
        mixed = BoxTable(
            boxes.stamps_ns, boxes.tracks, odd, boxes.attributes, boxes.centers_m, boxes.rotations, boxes.sizes_m,
            boxes.scores, boxes.sources,
        )  # fmt: skip
        assert make_tables(store, table=mixed).facts["categories"] == [
            "human.pedestrian.adult",
            "vehicle.car",
        ]

    def test_boxes_outside_of_scenes_are_counted(self, made):
        boxes = made.facts["counts"]["boxes"]
        assert boxes["observations"] == 150
        assert boxes["observations_outside_scenes"] == 3 * 6  # more than half a period off
        assert boxes["annotations"] == 24

    def test_no_boxes_no_rows(self, store):
        made = make_tables(store, Drive(boxes=False))
        assert made.table("instance") == made.table("sample_annotation") == []


class TestForm:
    def test_tables_refer_to_each_other_without_loose_ends(self, made):
        assert check_tables(rows_of(made)) == []

    def test_types_are_those_of_nuscenes(self, made):
        for row in made.table("sample_data"):
            assert type(row["is_key_frame"]) is bool
            assert type(row["timestamp"]) is int
        for table in ("ego_pose", "calibrated_sensor", "sample_annotation"):
            for row in made.table(table):
                assert len(row["rotation"]) == 4
                assert np.linalg.norm(row["rotation"]) == pytest.approx(1.0, abs=1e-8)

    def test_the_same_inputs_give_the_same_bytes_in_another_store(self, made, tmp_path):
        again = make_tables(Store(tmp_path / "other"))
        assert again.artifact.digest == made.artifact.digest

    def test_tokens_name_rig_and_recording(self, store, made):
        for other in (make_tables(store, key="drive_2"), make_tables(store, the_rig=rig(name="other_rig"))):
            for name in RECORDING_TABLES:
                assert not by_token(made.table(name)).keys() & by_token(other.table(name)).keys()

    def test_exactly_what_is_read_keys_the_step(self, store, made):
        params = made.use.params
        assert make_tables(store, tolerance_s=0.2).use.params != params
        assert set(made.use.inputs) == {
            *(f"channel:{name}" for name in EXTRINSICS),
            "ego_poses",
            "annotations",
        }
        renamed = rig().model_copy(update={"required": ("LIDAR_TOP",), "tf": ("/other",)})
        assert make_tables(store, the_rig=renamed).use.params == params


def test_where_the_global_frame_lies_does_not_change_point_counts(store, made):
    """Points and visibility are computed relative to the sensor, so far from the origin nothing breaks."""
    offset = np.array([1e5, -2e5, 300.0])
    base, boxes = trajectory(Drive()), true_boxes(Drive())
    far = Trajectory(
        base.stamps_ns, base.positions_m + offset, base.rotations, base.max_gap_ns, base.extrapolate_ns
    )
    moved = BoxTable(
        boxes.stamps_ns, boxes.tracks, boxes.categories, boxes.attributes, boxes.centers_m + offset, boxes.rotations,
        boxes.sizes_m, boxes.scores, boxes.sources,
    )  # fmt: skip
    again = make_tables(store, key="drive_1", table=moved, poses=far)
    measured = [(r["num_lidar_pts"], r["visibility_token"]) for r in again.table("sample_annotation")]
    assert measured == [(r["num_lidar_pts"], r["visibility_token"]) for r in made.table("sample_annotation")]


def test_poses_are_composed_in_the_right_order():
    pose = ego_pose(1.0) @ SE3.create(
        EXTRINSICS["CAM_FRONT"]["rotation"], EXTRINSICS["CAM_FRONT"]["translation"]
    )
    ahead = pose.transform_points(np.array([[0.0, 0.0, 10.0]]))[0]
    np.testing.assert_allclose(
        ahead, ego_pose(1.0).transform_points(np.array([[11.5, 0.0, 1.5]]))[0], atol=1e-9
    )
