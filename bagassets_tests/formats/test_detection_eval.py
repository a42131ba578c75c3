"""The real DetectionEval on a sample drive: what its world is made of, given as results, scores perfectly.

Results come from the closed forms of the drive, not from our tables, which give but the tokens and times of the samples:
poses, sizes, velocities and attributes of what the lidar and the radar of the world see at that time. Boxes
come from the topic of the drive, and from a label file in the lidar's frame.
"""

import json
from contextlib import ExitStack

import numpy as np
import pytest
import yaml

from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.dataset_checks import CHECKS, check
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.geometry.se3 import rotate
from bagassets.recipe import load_recipe
from bagassets.recordings.discover import find_one
from bagassets.recordings.open import open_recording
from bagassets.sample.cast import cast
from bagassets.sample.recorder import open_recorder
from bagassets.sample.render import lidar_points, radar_targets, rays_of
from bagassets.sample.rig import EGO_SE3_LIDAR, EGO_SE3_RADAR, LIDAR, RADAR
from bagassets.store.store import Store
from bagassets_tests.devkit import run_devkit
from bagassets_tests.sample_drives import VERSION, Built, build_recordings, build_sample

pytestmark = [pytest.mark.devkit, pytest.mark.xdist_group("detection_eval"), pytest.mark.once]

KEY = "drive.mcap"
NAMES = {"vehicle.car": "car", "vehicle.truck": "truck", "human.pedestrian.adult": "pedestrian"}
RANGE_M = {"car": 50, "truck": 50, "pedestrian": 40}  # detection_cvpr_2019
SPLIT = "everything"
STEP_NS = 100_000_000


def split_all(recipe_file):
    """Put the only recording in a split of a name of our own."""
    data = yaml.safe_load(recipe_file.read_text())
    data["splits"] = {"shares": {SPLIT: 1.0}}
    data["preview"] = {"enabled": False}
    return data


@pytest.fixture(scope="module")
def from_topic(tmp_path_factory):
    built = build_sample(tmp_path_factory.mktemp("eval"), seed=3, duration_s=4.2, targets=((KEY, "mcap"),))
    folder = built.recipe.state.parent
    return rebuilt(built, folder, split_all(folder / "recipe.yaml"), "topic")


@pytest.fixture(scope="module")
def from_file(from_topic):
    """The same drive, its boxes in a label file beside it, given in the lidar's frame at odd times."""
    folder = from_topic.recipe.state.parent
    data = split_all(folder / "recipe.yaml")
    del data["rigs"][0]["annotations"]
    data["rigs"][0]["annotation_files"] = [{"format": "boxes", "path": "{stem}.boxes.json"}]
    (folder / "recordings" / "drive.boxes.json").write_text(json.dumps(label_file(from_topic)))
    return rebuilt(from_topic, folder, data, "file")


@pytest.fixture(scope="module")
def lidar_only(from_topic):
    """The same drive as a rig without cameras and radar has it."""
    folder = from_topic.recipe.state.parent
    data = split_all(folder / "recipe.yaml")
    channels = data["rigs"][0]["channels"]
    data["rigs"][0]["channels"] = {"LIDAR_TOP": channels["LIDAR_TOP"]}
    return rebuilt(from_topic, folder, data, "lidar_only")


@pytest.fixture(scope="module")
def without_ids(from_topic, tmp_path_factory):
    """The same drive, the ids of its boxes emptied."""
    folder = tmp_path_factory.mktemp("without_ids")
    source = from_topic.recipe.bags.root / KEY
    with ExitStack() as stack:
        recording = stack.enter_context(open_recording(find_one(source)))
        recorder = open_recorder(folder / "recordings" / KEY, "mcap", "none", stack)
        for message in recording.messages(list(recording.topics)):
            if message.topic != "/annotations":
                recorder.write_raw(message.topic, message.msgtype, message.log_time_ns, bytes(message.data))
                continue
            decoded = recording.decode(message)
            for detection in decoded.detections:
                detection.id = ""
            recorder.write(message.topic, message.msgtype, message.log_time_ns, decoded)
    data = split_all(from_topic.recipe.state.parent / "recipe.yaml")
    data["store"] = str(from_topic.recipe.store_path)
    return rebuilt(from_topic, folder, data, "without_ids")


def rebuilt(built, folder, data, name):
    """Build the dataset of another recipe on the same store."""
    data["nuscenes"]["output"] = f"nuscenes_{name}"
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(data))
    recipe = load_recipe(path)
    made = build_recordings(recipe)
    parts = [Part(key, key, assets["nuscenes_tables"].artifact.digest) for key, assets in made.items()]
    assemble(
        NUSCENES,
        parts,
        recipe.nuscenes,
        Store(recipe.store_path),
        recipe.nuscenes.output,
        splits=recipe.splits,
    )
    version = recipe.nuscenes.output / VERSION
    tables = {file.stem: json.loads(file.read_text()) for file in version.glob("*.json")}
    return Built(recipe, built.truth, made, recipe.nuscenes.output, tables)


def label_file(built):
    truth = built.truth
    boxes = []
    for stamp in range(truth.start_ns + 70_000_000, truth.start_ns + 4_100_000_000, STEP_NS):
        lidar_SE3_odom = (truth.odom_SE3_ego(stamp) @ truth.ego_SE3_sensor("LIDAR_TOP")).inverse()
        for box in truth.boxes(stamp):
            pose = lidar_SE3_odom @ box.odom_SE3_box
            boxes.append(
                {
                    "stamp_ns": stamp, "frame": "lidar_top", "track_id": box.track_id, "category": box.category,
                    "center": list(pose.translation), "rotation": list(pose.rotation), "size": list(box.size_m),
                }
            )  # fmt: skip
    return {"format": "bagassets-boxes", "version": 1, "boxes": boxes}


@pytest.fixture(params=["from_topic", "from_file"])
def built(request):
    return request.getfixturevalue(request.param)


def velocity(thing, seconds):
    """Velocity of a thing over ground, x and y: along its circle."""
    angle = thing.angle_rad + thing.speed_mps / thing.radius_m * seconds
    return thing.speed_mps * np.array([np.cos(angle), np.sin(angle)])


def true_boxes(built, sample):
    """(annotation row, true box, its thing) of each annotation of a sample."""
    stamp_ns = sample["timestamp"] * 1000
    boxes = built.truth.boxes(stamp_ns)
    for row in built.tables["sample_annotation"]:
        if row["sample_token"] != sample["token"]:
            continue
        gaps = [np.linalg.norm(np.subtract(b.odom_SE3_box.translation, row["translation"])) for b in boxes]
        best = boxes[int(np.argmin(gaps))]
        assert min(gaps) < 0.05
        yield row, best, built.truth.world.things[best.track_id - 1]


def points_of_world(built, stamp_ns):
    """What lidar and radar see around a time (N, 3), in `odom`, each point where it was seen."""
    truth = built.truth
    first_ns = truth.start_ns + round((stamp_ns - truth.start_ns) / LIDAR.period_ns - 1) * LIDAR.period_ns
    cloud = lidar_points(truth.world, truth.seconds(first_ns))
    positions, rotations = truth.world.ego.pose(truth.seconds(first_ns) + cloud["t"] / 1e9)
    in_ego = rotate(np.array(EGO_SE3_LIDAR.rotation), np.stack([cloud[axis] for axis in "xyz"], axis=1))
    lidar = rotate(rotations, in_ego + np.array(EGO_SE3_LIDAR.translation)) + positions
    radar_ns = truth.start_ns + round((stamp_ns - truth.start_ns) / RADAR.period_ns) * RADAR.period_ns
    targets = radar_targets(truth.world, truth.seconds(radar_ns))
    in_radar = np.array([[target[axis] for axis in "xyz"] for target in targets]).reshape(-1, 3)
    radar = (truth.odom_SE3_ego(radar_ns) @ EGO_SE3_RADAR).transform_points(in_radar)
    return np.concatenate([lidar[np.isfinite(lidar).all(axis=1)], radar])


def seen_boxes(built, stamp_ns):
    """The true boxes at a time that have a point of the world in them, and their things."""
    points = points_of_world(built, stamp_ns)
    for box in built.truth.boxes(stamp_ns):
        width, length, height = box.size_m
        away = np.abs(box.odom_SE3_box.inverse().transform_points(points))
        if (away <= np.array([length, width, height]) / 2).all(axis=1).any():
            yield box, built.truth.world.things[box.track_id - 1]


def is_near(built, box, stamp_ns):
    """Whether a box is near enough to count."""
    here = built.truth.odom_SE3_ego(stamp_ns).translation
    return np.hypot(*np.subtract(box.odom_SE3_box.translation, here)[:2]) < RANGE_M[NAMES[box.category]]


def in_range(built):
    """Yield the class of each box of the world that is seen, and near enough to count."""
    for sample in built.tables["sample"]:
        stamp_ns = sample["timestamp"] * 1000
        for box, _ in seen_boxes(built, stamp_ns):
            if is_near(built, box, stamp_ns):
                yield NAMES[box.category]


def unseen_in_range(built):
    """Yield the boxes that are near enough to count, but have no point: given as results, they would be false."""
    for row in built.tables["sample"]:
        stamp_ns = row["timestamp"] * 1000
        seen = {box.track_id for box, _ in seen_boxes(built, stamp_ns)}
        for box in built.truth.boxes(stamp_ns):
            if box.track_id not in seen and is_near(built, box, stamp_ns):
                yield stamp_ns, box


def attribute(thing):
    """What nuScenes calls the motion of a thing, which never changes in the world."""
    if thing.category.startswith("human"):
        return "pedestrian.moving" if thing.speed_mps else "pedestrian.standing"
    return "vehicle.moving" if thing.speed_mps else "vehicle.parked"


def mean_velocity(built, thing, times_ns, number):
    """Velocity over ground as the devkit defines it for a sample: from the one before to the one after."""
    ends = [times_ns[max(number - 1, 0)], times_ns[min(number + 1, len(times_ns) - 1)]]
    (first, last), _ = thing.pose(np.array([built.truth.seconds(end) for end in ends]))
    return ((last - first)[:2] / (ends[1] - ends[0]) * 1e9).tolist()


def results(built):
    """What a detector without fault would find."""
    found = {}
    # The devkit's errors are means over a ranking; in the order of time the ends of tracks would lead it.
    scores = np.random.default_rng(0).uniform(0.5, 1.0, 10_000).tolist()
    samples = sorted(built.tables["sample"], key=lambda row: row["timestamp"])
    times_ns = [sample["timestamp"] * 1000 for sample in samples]
    for number, (sample, stamp_ns) in enumerate(zip(samples, times_ns, strict=True)):
        found[sample["token"]] = [
            {
                "sample_token": sample["token"],
                "translation": list(box.odom_SE3_box.translation),
                "size": list(box.size_m),
                "rotation": list(box.odom_SE3_box.rotation),
                "velocity": mean_velocity(built, thing, times_ns, number),
                "detection_name": NAMES[box.category],
                "detection_score": scores.pop(),
                "attribute_name": attribute(thing),
            }
            for box, thing in seen_boxes(built, stamp_ns)
        ]
    return found


@pytest.fixture(scope="module")
def evaluated():
    return {}


@pytest.fixture
def scores(built, evaluated, tmp_path):
    if built.dataroot not in evaluated:
        given = tmp_path / "given.json"
        given.write_text(json.dumps(results(built)))
        evaluated[built.dataroot] = run_devkit(
            "devkit_eval.py", built.dataroot, VERSION, SPLIT, tmp_path, given
        )
    return evaluated[built.dataroot]


def test_every_object_of_the_world_is_annotated_at_every_sample(built):
    for sample in built.tables["sample"]:
        tracks = [box.track_id for _, box, _ in true_boxes(built, sample)]
        assert (
            len(tracks) == len(set(tracks)) == sum(bool(thing.category) for thing in built.truth.world.things)
        )


def test_the_truth_as_results_scores_ap_1_and_errors_0_for_each_class(built, scores):
    assert scores["samples"] == len(built.tables["sample"]) >= 8
    assert set(in_range(built)) == set(NAMES.values()), "each class of the world is within range"
    assert not list(unseen_in_range(built)), "what is near enough to count is seen"
    for name in NAMES.values():
        assert scores["aps"][name] == pytest.approx(1.0), name
        errors = scores["errors"][name]
        # Boxes 0.1 s apart are interpolated: a chord of the circle is 0.8 mm off.
        assert errors["trans_err"] < 1e-3, name
        assert errors["scale_err"] < 1e-6, name
        assert errors["orient_err"] < 1e-5, name
        assert errors["vel_err"] < 2e-3, name
        assert errors["attr_err"] == 0.0, name


def test_attributes_are_those_of_the_world(built):
    names = {row["token"]: row["name"] for row in built.tables["attribute"]}
    met = set()
    for sample in built.tables["sample"]:
        for row, _, thing in true_boxes(built, sample):
            assert [names[token] for token in row["attribute_tokens"]] == [attribute(thing)], thing
            met.add(attribute(thing))
    assert met == {"vehicle.moving", "vehicle.parked", "pedestrian.moving"}


def test_velocities_of_the_devkit_are_those_of_the_world(built, scores):
    middle = ends = 0
    for sample in built.tables["sample"]:
        seconds = built.truth.seconds(sample["timestamp"] * 1000)
        for row, _, thing in true_boxes(built, sample):
            ours = np.array(scores["velocities"][row["token"]])
            error = np.linalg.norm(ours[:2] - velocity(thing, seconds))
            # A chord of the circle over one second, or over the half second at an end of the track.
            inner = bool(row["prev"] and row["next"])
            assert error < (0.05 if inner else 0.25), thing
            assert abs(ours[2]) < 0.02
            middle, ends = middle + inner, ends + (not inner)
    assert middle > 40
    assert ends > 10


def test_points_are_counted_as_the_devkit_counts_them(built):
    facts = run_devkit("devkit_walk.py", built.dataroot, VERSION)
    counted = np.array([[theirs, ours] for _, theirs, ours in facts["points"]])
    assert len(counted) == len(built.tables["sample_annotation"])
    # The points of the sample lie on the very faces of the boxes, where the last bits decide.
    difference = np.abs(counted[:, 0] - counted[:, 1])
    assert (difference <= 2 + 0.02 * counted[:, 0]).all()
    assert counted[:, 1].sum() > 1000


def test_points_belong_to_the_object_and_to_no_other(built):
    """The sample's lidar writes which object it hit into the intensities: 20 + 37 id mod 200."""
    rows = {row["token"]: row for row in built.tables["sample"]}
    all_hits = all_inside = 0
    for data in built.tables["sample_data"]:
        if not (data["is_key_frame"] and data["filename"].endswith(".pcd.bin")):
            continue
        cloud = np.fromfile(built.dataroot / data["filename"], np.float32).reshape(-1, 5)
        ids = ((cloud[:, 3] - 20) * pow(37, -1, 200)).astype(int) % 200
        for row, box, thing in true_boxes(built, rows[data["sample_token"]]):
            hits = int(np.count_nonzero(ids == box.track_id))
            ground = 6 + 0.1 * hits  # on which the label stands
            assert row["num_lidar_pts"] <= hits + ground
            if not thing.speed_mps:  # others drive on while the lidar turns
                assert row["num_lidar_pts"] >= hits
            all_hits, all_inside = all_hits + hits, all_inside + row["num_lidar_pts"]
    assert 0.9 * all_hits < all_inside < 1.1 * all_hits


def test_without_ids_each_object_is_there_once_where_the_nearest_message_has_it(without_ids, from_topic):
    """A topic at 10 Hz: two messages, and sometimes three, are within tolerance of a keyframe."""
    truth, tables = without_ids.truth, without_ids.tables
    objects = sum(bool(thing.category) for thing in truth.world.things)
    assert len(tables["sample_annotation"]) == len(from_topic.tables["sample_annotation"])
    for sample in tables["sample"]:
        stamp_ns = sample["timestamp"] * 1000
        nearest_ns = truth.start_ns + round((stamp_ns - truth.start_ns) / STEP_NS) * STEP_NS
        rows = [row for row in tables["sample_annotation"] if row["sample_token"] == sample["token"]]
        assert len(rows) == objects
        expected = sorted(box.odom_SE3_box.translation for box in truth.boxes(nearest_ns))
        np.testing.assert_allclose(sorted(tuple(row["translation"]) for row in rows), expected, atol=1e-5)
    counts = without_ids.made[KEY]["nuscenes_tables"].artifact.read_json("facts.json")["counts"]["boxes"]
    assert counts["without_track"] == counts["observations"] > 3 * counts["annotations"]
    assert counts["without_track_unused"] == counts["observations"] - counts["annotations"]
    assert counts["attributes_undetermined"] == counts["annotations"]
    assert run_devkit("devkit_walk.py", without_ids.dataroot, VERSION)["tables"]["instance"] == len(
        tables["sample_annotation"]
    )


LEVELS = ("v0-40", "v40-60", "v60-80", "v80-100")


def keyframe_images(built, sample):
    """Yield the view of each camera of a sample without distortion, and the pose and time of its image."""
    tables = built.tables
    sensors = {row["token"]: row["channel"] for row in tables["sensor"]}
    channels = {row["token"]: sensors[row["sensor_token"]] for row in tables["calibrated_sensor"]}
    for row in tables["sample_data"]:
        if row["sample_token"] == sample["token"] and row["is_key_frame"] and row["height"]:
            camera = built.truth.cameras[channels[row["calibrated_sensor_token"]]]
            stamp_ns = row["timestamp"] * 1000
            odom_SE3_cam = built.truth.odom_SE3_ego(stamp_ns) @ camera.ego_SE3_cam
            yield camera.model.undistorted(), odom_SE3_cam, built.truth.seconds(stamp_ns)


def visible_share(built, box, thing, images):
    """The part of a box that the images have, by random points, times the part of its pixels that nothing hides.

    The pixels of an object that nothing hides are those of a world in which it is alone.
    """
    width, length, height = box.size_m
    unit = np.random.default_rng(1).uniform(-0.5, 0.5, (2000, 3))
    points = box.odom_SE3_box.transform_points(unit * [length, width, height])
    in_images, hidden, alone = np.zeros(len(points), bool), 0, 0
    for model, odom_SE3_cam, seconds, rays, things in images:
        pixels, front = model.project(odom_SE3_cam.inverse().transform_points(points))
        inside = front & (pixels >= 0).all(axis=1) & (pixels < (model.width, model.height)).all(axis=1)
        in_images |= inside
        if inside.any():
            times = np.full(len(rays), seconds)
            own = cast([thing], np.broadcast_to(np.array(odom_SE3_cam.translation), rays.shape), rays, times)
            mine = own.thing == thing.track_id
            alone += int(mine.sum())
            hidden += int((mine & (things != thing.track_id)).sum())
    return float(in_images.mean()), (1 - hidden / alone if alone else 0.0)


def rendered(built, sample):
    """The images of a sample as pixel rays, and what each of them sees."""
    for model, odom_SE3_cam, seconds in keyframe_images(built, sample):
        rays = rotate(np.array(odom_SE3_cam.rotation), rays_of(model)[::2, ::2].reshape(-1, 3))
        origins = np.broadcast_to(np.array(odom_SE3_cam.translation), rays.shape)
        seen = cast(built.truth.world.things, origins, rays, np.full(len(rays), seconds))
        yield model, odom_SE3_cam, seconds, rays, seen.thing


def test_visibility_is_that_of_rendered_images(built):
    """What the cameras of the world see of each object, pixel by pixel, against levels from boxes and points."""
    levels = {row["token"]: LEVELS.index(row["level"]) for row in built.tables["visibility"]}
    confusion = np.zeros((4, 4), int)
    hidden = []
    for sample in built.tables["sample"]:
        images = list(rendered(built, sample))
        for row, box, thing in true_boxes(built, sample):
            in_images, is_open = visible_share(built, box, thing, images)
            true = sum(in_images * is_open >= bound for bound in (0.4, 0.6, 0.8))
            level = levels[row["visibility_token"]]
            confusion[true, level] += 1
            assert row["num_lidar_pts"] or level < 3, "seen wholly, without a point"
            if in_images > 0.8 and is_open < 0.2:
                hidden.append(level)
    wrong_by = np.abs(np.subtract(*np.indices((4, 4))))
    assert confusion.diagonal().sum() > 0.75 * confusion.sum()
    assert confusion[wrong_by > 1].sum() < 0.05 * confusion.sum()
    assert confusion[3].sum() > 20
    # Wholly in an image, and hardly anything of them is seen: what the rule was without the lidar.
    assert len(hidden) >= 5
    assert hidden.count(0) > 0.4 * len(hidden)
    assert max(hidden) <= 1  # the lidar sits higher, and sees heads over cars


def test_without_cameras_visibility_is_what_the_lidar_sees(lidar_only):
    """Against rays of the world's lidar, four times as many as it has, of all things and of one alone."""
    truth = lidar_only.truth
    levels = {row["token"]: LEVELS.index(row["level"]) for row in lidar_only.tables["visibility"]}
    azimuth, elevation = np.meshgrid(
        np.deg2rad(np.arange(-180, 180, 0.25)),
        np.deg2rad(np.arange(LIDAR.lowest_deg, LIDAR.highest_deg, 0.5)),
    )
    flat = np.cos(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    confusion = np.zeros((4, 4), int)
    for sample in lidar_only.tables["sample"]:
        stamp_ns = sample["timestamp"] * 1000
        odom_SE3_lidar = truth.odom_SE3_ego(stamp_ns) @ EGO_SE3_LIDAR
        ways = rotate(np.array(odom_SE3_lidar.rotation), rays.reshape(-1, 3))
        origins = np.broadcast_to(np.array(odom_SE3_lidar.translation), ways.shape)
        times = np.full(len(ways), truth.seconds(stamp_ns))
        seen = cast(truth.world.things, origins, ways, times).thing
        for row, _, thing in true_boxes(lidar_only, sample):
            level = levels[row["visibility_token"]]
            assert row["num_lidar_pts"] or level == 0
            mine = cast([thing], origins, ways, times).thing == thing.track_id
            if row["num_lidar_pts"]:
                share = float((seen[mine] == thing.track_id).mean())
                confusion[sum(share >= bound for bound in (0.4, 0.6, 0.8)), level] += 1
    assert confusion.diagonal().sum() > 0.85 * confusion.sum()
    assert confusion[3, 3] > 0.5 * confusion.sum()
    assert confusion[0, 3] == confusion[3, 0] == 0


def test_all_checks_of_the_dataset_pass(built):
    found = check(NuScenes(output=built.dataroot, version=VERSION), {one.name for one in CHECKS})
    assert {name: list(finding.problems) for name, finding in found.items()} == {name: [] for name in found}
