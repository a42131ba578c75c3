"""The dataset of a sample drive against the truth of its world, for every format.

Nothing here is compared with our own output: poses, boxes, pixels and points are held against the
closed forms that the drive was made from.
"""

import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest

from bagassets.assets.ego_poses import load_trajectory
from bagassets.sample.render import CameraView, radar_targets
from bagassets.sample.rig import EGO_SE3_LIDAR, EGO_SE3_RADAR, LIDAR
from bagassets_tests.devkit import run_devkit
from bagassets_tests.sample_drives import VERSION, build_sample, object_ids, pose_of

KEYS = ("drive.bag", "drive", "drive.mcap")
CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT")
MS = 1_000_000

pytestmark = [pytest.mark.xdist_group("sample_truth"), pytest.mark.once]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    return build_sample(tmp_path_factory.mktemp("sample"))


@pytest.fixture(scope="module")
def rows(built):
    """token -> row of each table."""
    return {name: {row["token"]: row for row in table} for name, table in built.tables.items() if name != "splits"
            and isinstance(table, list)}  # fmt: skip


def readings(built, rows, key, channel):
    """(stamp_ns, sample_data row, calibrated_sensor row, ego_pose row) of a channel of a recording."""
    found = []
    logs = {row["token"] for row in built.tables["log"] if row["logfile"] == key}
    samples = {
        row["token"]
        for row in built.tables["sample"]
        if rows["scene"][row["scene_token"]]["log_token"] in logs
    }
    for row in built.tables["sample_data"]:
        calibrated = rows["calibrated_sensor"][row["calibrated_sensor_token"]]
        if (
            rows["sensor"][calibrated["sensor_token"]]["channel"] == channel
            and row["sample_token"] in samples
        ):
            stamp_ns = int(row["filename"].rsplit("__", 1)[-1].split(".")[0]) * 1000
            found.append((stamp_ns, row, calibrated, rows["ego_pose"][row["ego_pose_token"]]))
    return found


@pytest.mark.parametrize("asset", ["ego_poses", "calibration", "annotations"])
def test_every_format_gives_the_same_artifacts(built, asset):
    assert len({built.artifact(key, asset).digest for key in KEYS}) == 1


@pytest.mark.parametrize("channel", [*CAMERAS, "LIDAR_TOP", "RADAR_FRONT"])
def test_every_format_gives_the_same_files(built, channel):
    asset = "frames" if channel in CAMERAS else "sweeps"
    files = set()
    for key in KEYS:
        index = built.channel(key, asset, channel).read_table("index.parquet")
        files.add((tuple(index["stamp_ns"].to_pylist()), tuple(index["digest"].to_pylist())))
    assert len(files) == 1


@pytest.mark.parametrize("key", KEYS)
def test_poses_match_the_truth_to_a_millimetre_between_odometry_messages(built, key):
    trajectory = load_trajectory(built.artifact(key, "ego_poses"))
    stamps = built.truth.start_ns + np.arange(7 * MS, 3_200 * MS, 13_000_001)
    positions, rotations, valid = trajectory.at(stamps)
    assert valid.all()
    for stamp, position, rotation in zip(stamps, positions, rotations, strict=True):
        truth = built.truth.odom_SE3_ego(int(stamp))
        assert np.abs(position - np.array(truth.translation)).max() < 1e-3
        assert abs(float(np.dot(rotation, truth.rotation))) > 1 - 1e-7  # 0.5 mrad


@pytest.fixture(scope="module")
def pinhole_images(built):
    """channel -> stamp -> what a camera without distortion sees there."""
    images = {}
    for channel, camera in built.truth.cameras.items():
        pinhole = replace(camera, model=camera.model.undistorted(), encoding="rgb8")
        view = CameraView(built.truth.world, pinhole)
        index = built.channel("drive", "frames", channel).read_table("index.parquet")
        images[channel] = {ns: view.image(built.truth.seconds(ns)) for ns in index["stamp_ns"].to_pylist()}
    return images


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("channel", CAMERAS)
def test_images_are_undistorted_to_a_tenth_of_a_pixel(built, rows, pinhole_images, key, channel):
    """The written images lie on the images that a camera without distortion sees.

    Least squares of their difference over the slope (Lucas and Kanade, 1981), over all images of the
    drive, as both are sampled without smoothing and the edges of a single one jitter.
    """
    middle = np.s_[40:160, 60:260]  # a wide lens does not see the corners of the pinhole's image
    normal, right, count = np.zeros((2, 2)), np.zeros(2), 0
    for stamp_ns, data, calibrated, _ in readings(built, rows, key, channel):
        assert np.allclose(calibrated["camera_intrinsic"], built.truth.cameras[channel].model.matrix)
        written, truth = cv2.imread(str(built.dataroot / data["filename"])), pinhole_images[channel][stamp_ns]
        assert np.abs(written[middle].astype(float) - truth[middle]).mean() < 6.0
        ours, theirs = (cv2.GaussianBlur(cv2.cvtColor(one, cv2.COLOR_BGR2GRAY).astype(float), (0, 0), 2.0)
                        for one in (written, truth))  # fmt: skip
        slope = np.stack([part[middle].ravel() for part in reversed(np.gradient(theirs))], axis=1)
        normal += slope.T @ slope
        right += slope.T @ (ours - theirs)[middle].ravel()
        count += 1
    assert count == 32
    assert np.abs(np.linalg.solve(normal, right)).max() < 0.1


def corners_px(annotation, pose, calibrated):
    """Pixels of the eight corners of a box, or None if one is behind the camera."""
    width, length, height = annotation["size"]
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    corners = pose_of(annotation).transform_points(signs * [length, width, height])
    cam_SE3_global = (pose_of(pose) @ pose_of(calibrated)).inverse()
    seen = cam_SE3_global.transform_points(corners)
    if seen[:, 2].min() < 0.5:
        return None
    pixels = seen @ np.array(calibrated["camera_intrinsic"]).T
    return (pixels[:, :2] / pixels[:, 2:]).astype(np.float32)


@pytest.mark.parametrize("key", KEYS)
def test_projected_boxes_cover_the_pixels_of_their_objects(built, rows, key):
    """Boxes as a user of the dataset projects them, objects as the undistorted camera sees them.

    A camera's reading is up to 50 ms from its keyframe: the box of a moving object is widened by that.
    """
    tracks = {}
    for instance in built.tables["instance"]:
        first = rows["sample_annotation"][instance["first_annotation_token"]]
        tracks[instance["token"]] = nearest_track(built, rows, first)
    compared = 0
    for channel in CAMERAS:
        for stamp_ns, data, calibrated, pose in readings(built, rows, key, channel):
            if not data["is_key_frame"]:
                continue
            objects = object_ids(built.truth, channel, stamp_ns)
            for annotation in built.tables["sample_annotation"]:
                thing = tracks[annotation["instance_token"]]
                if annotation["sample_token"] != data["sample_token"]:
                    continue
                mask = objects == thing.track_id
                pixels = corners_px(annotation, pose, calibrated)
                if pixels is None or mask.sum() < 30:
                    continue
                hull = np.zeros(mask.shape, np.uint8)
                cv2.fillConvexPoly(hull, np.round(cv2.convexHull(pixels)).astype(np.int32), 1)
                lag_s = abs(stamp_ns / 1000 - rows["sample"][data["sample_token"]]["timestamp"]) * 1e-6
                distance_m = np.linalg.norm(
                    (pose_of(pose) @ pose_of(calibrated))
                    .inverse()
                    .transform_points(np.array([annotation["translation"]]))
                )
                drift_px = abs(thing.speed_mps) * lag_s / distance_m * calibrated["camera_intrinsic"][0][0]
                hull = cv2.dilate(hull, np.ones((3, 3), np.uint8), iterations=1 + int(np.ceil(drift_px)))
                assert hull[mask].mean() > 0.99, (channel, thing.category, data["filename"])
                compared += 1
    assert compared > 40


def nearest_track(built, rows, annotation):
    """The true thing that an annotation stands for."""
    stamp_ns = rows["sample"][annotation["sample_token"]]["timestamp"] * 1000
    boxes = built.truth.boxes(stamp_ns)
    gaps = [
        np.linalg.norm(np.subtract(box.odom_SE3_box.translation, annotation["translation"])) for box in boxes
    ]
    best = int(np.argmin(gaps))
    assert gaps[best] < 0.02
    return built.truth.world.things[boxes[best].track_id - 1]


@pytest.mark.parametrize("key", KEYS)
def test_annotations_are_the_true_boxes_at_the_keyframe(built, rows, key):
    for annotation in built.tables["sample_annotation"]:
        stamp_ns = rows["sample"][annotation["sample_token"]]["timestamp"] * 1000
        thing = nearest_track(built, rows, annotation)
        assert annotation["size"] == pytest.approx(thing.size_m)
        truth = next(box for box in built.truth.boxes(stamp_ns) if box.track_id == thing.track_id)
        assert abs(np.dot(annotation["rotation"], truth.odom_SE3_box.rotation)) > 1 - 1e-6
    assert key in {row["logfile"] for row in built.tables["log"]}


def things_of(points):
    """Track ids, which the sample's lidar writes into its intensities: 20 + 37 id mod 200."""
    return ((points[:, 3] - 20) * pow(37, -1, 200)).astype(int) % 200


@pytest.mark.parametrize("key", KEYS)
def test_lidar_points_lie_on_the_ground_and_in_the_boxes_of_their_objects(built, rows, key):
    found = readings(built, rows, key, "LIDAR_TOP")
    assert len(found) == 32
    inside = 0
    for stamp_ns, data, calibrated, pose in found[::7]:
        cloud = np.fromfile(built.dataroot / data["filename"], np.float32).reshape(-1, 5)
        assert np.isfinite(cloud).all()
        odom = (pose_of(pose) @ pose_of(calibrated)).transform_points(cloud[:, :3].astype(np.float64))
        ids = things_of(cloud)
        assert len(cloud) > 8_000
        assert np.abs(odom[ids == 0, 2]).max() < 0.02  # the ground is flat; the car sways
        for thing in built.truth.world.things:
            own = odom[ids == thing.track_id]
            if not len(own):
                continue
            # A point was seen up to one revolution before the stamp: things move on, the box does not.
            centre, yaw = thing.pose(np.array([built.truth.seconds(stamp_ns)]))
            east, north, up = (own - centre[0]).T
            along = np.cos(yaw) * east + np.sin(yaw) * north
            across = np.cos(yaw) * north - np.sin(yaw) * east
            moved = abs(thing.speed_mps) * LIDAR.period_ns * 1e-9
            width, length, height = np.array(thing.size_m) / 2 + 0.02
            assert np.abs(along).max() < length + moved
            assert np.abs(across).max() < width + 0.02 * moved + (0.01 if moved else 0)
            assert np.abs(up).max() < height
            inside += len(own) if thing.category else 0
    assert inside > 300


@pytest.mark.parametrize("key", KEYS)
def test_the_stamp_of_a_revolution_is_its_end(built, rows, key):
    stamps = [stamp_ns for stamp_ns, *_ in readings(built, rows, key, "LIDAR_TOP")]
    first_ns = built.truth.start_ns + LIDAR.period_ns
    late_ns = np.array(stamps) - (first_ns + np.arange(len(stamps)) * LIDAR.period_ns)
    assert np.abs(late_ns).max() <= LIDAR.period_ns // LIDAR.columns + 1000  # microseconds


@pytest.mark.parametrize("key", KEYS)
def test_extrinsics_are_those_of_the_car(built, rows, key):
    truth = {"LIDAR_TOP": EGO_SE3_LIDAR, "RADAR_FRONT": EGO_SE3_RADAR}
    truth |= {channel: camera.ego_SE3_cam for channel, camera in built.truth.cameras.items()}
    for channel, ego_SE3_sensor in truth.items():
        row = readings(built, rows, key, channel)[0][2]
        assert row["translation"] == pytest.approx(ego_SE3_sensor.translation, abs=1e-6)
        assert abs(np.dot(row["rotation"], ego_SE3_sensor.rotation)) == pytest.approx(1.0, abs=1e-9)


@pytest.fixture(scope="module")
def facts(built):
    return run_devkit("devkit_walk.py", built.dataroot, VERSION)


@pytest.mark.devkit
def test_the_devkit_walks_and_renders_the_dataset_of_every_format(facts):
    assert len(facts["scenes"]) == len(KEYS)
    assert set(facts["rendered"]) == set(CAMERAS)
    assert min(points for points, _ in facts["rendered"].values()) > 200
    assert all(counted == stored for _, counted, stored in facts["points"])
    points, nearest_s, farthest_s = facts["sweeps"]
    assert points > 20_000
    assert (nearest_s, round(farthest_s, 2)) == (0.0, 0.4)


@pytest.mark.devkit
def test_the_devkit_reads_the_true_radar_targets(built, rows, facts):
    files, targets = facts["radar"]["RADAR_FRONT"]
    stamps = [stamp_ns for key in KEYS for stamp_ns, *_ in readings(built, rows, key, "RADAR_FRONT")]
    assert files == len(stamps)
    assert targets == sum(len(radar_targets(built.truth.world, built.truth.seconds(s))) for s in stamps)


def test_radar_velocities_are_over_ground_in_the_sensor_frame(built, rows):

    for stamp_ns, data, *_ in readings(built, rows, "drive", "RADAR_FRONT")[::9]:
        raw = (built.dataroot / data["filename"]).read_bytes()
        header, body = raw.split(b"DATA binary\n", 1)
        count = int(header.split(b"POINTS ")[1].split()[0])
        record = struct.Struct("<fffbhfffffbbbbbbbb")  # the 18 fields of nuScenes' radar files
        assert len(body) >= record.size * count
        truth = radar_targets(built.truth.world, built.truth.seconds(stamp_ns))
        assert count == len(truth)
        for number, target in enumerate(truth):
            values = record.unpack_from(body, number * record.size)
            place = [target[name] for name in ("x", "y", "z", "rcs")]
            assert [*values[:3], values[5]] == pytest.approx(place, abs=1e-4)
            velocity = [target[name] for name in ("vx", "vy", "vx_comp", "vy_comp")]
            assert values[6:10] == pytest.approx(velocity, abs=1e-4)
