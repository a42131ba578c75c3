"""Boxes of every message family: serialised with the family's definition into a recording, read back by a build."""

from contextlib import ExitStack

import numpy as np
import pytest
import yaml
from box_definitions import Blank
from label_files import SIZES, WRITERS, box_entries, box_json, odom_SE3_box
from small_drive import LATENCY_NS, RECIPE, SPEED_MPS, START_NS, messages

from bagassets.assets.boxes.table import BoxTable
from bagassets.geometry.se3 import SE3
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.sample.recorder import open_recorder
from bagassets.store.store import Store
from bagassets_tests.recording_build import RecordingBuild

MS = 1_000_000
PERIOD_NS = 100 * MS
PHASE_NS = 35 * MS  # boxes are never at the time of a cloud, which comes at 5 ms
NUMBER = 20
UUIDS = {"7": bytes(range(16)), "8": bytes(range(1, 17))}


class Family:
    """Makes the messages of one family: the two true objects at a time.

    Args:
        store: the type store of the recording.
        ros1: it is of ROS 1.
        footprints: Autoware's objects have their rear right corner as origin, and a polygon around them.
    """

    def __init__(self, store, *, ros1, footprints=False):
        self.make, self.ros1, self.footprints = Blank(store), ros1, footprints

    def header(self, stamp_ns, frame="odom"):
        stamp = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def pose(self, track, stamp_ns):
        width, length, _ = SIZES[track]
        corner = (-length / 2, -width / 2, 0.0) if self.footprints else (0.0, 0.0, 0.0)
        true = odom_SE3_box(track, stamp_ns) @ SE3(translation=corner)
        w, x, y, z = true.rotation
        return self.make(
            "geometry_msgs/msg/Pose",
            position=self.make("geometry_msgs/msg/Point", **dict(zip("xyz", true.translation, strict=True))),
            orientation=self.make("geometry_msgs/msg/Quaternion", w=w, x=x, y=y, z=z),
        )

    def dimensions(self, track):
        width, length, height = SIZES[track]
        return self.make("geometry_msgs/msg/Vector3", x=length, y=width, z=height)

    def shape(self, package, track):
        shapes = self.make.constants(f"{package}/msg/Shape")
        if not self.footprints:
            return {"type": shapes["BOUNDING_BOX"], "dimensions": self.dimensions(track)}
        width, length, height = SIZES[track]
        # One corner is cut off.
        corners = [(0, 0), (length, 0), (length, width / 2), (length / 2, width), (0, width)]
        points = [self.make("geometry_msgs/msg/Point32", x=float(x), y=float(y)) for x, y in corners]
        return {
            "type": shapes["POLYGON"],
            "dimensions": self.make("geometry_msgs/msg/Vector3", z=height),
            "footprint": self.make("geometry_msgs/msg/Polygon", points=points),
        }

    def autoware(self, package, kind, stamp_ns):
        classes = self.make.constants(f"{package}/msg/ObjectClassification")
        objects = []
        for track, label in (("7", "CAR"), ("8", "PEDESTRIAN")):
            covariance = self.make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(track, stamp_ns))
            identity = (
                {
                    "object_id": self.make(
                        "unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(UUIDS[track], np.uint8)
                    )
                }
                if kind == "Tracked"
                else {}
            )
            objects.append(
                self.make(
                    f"{package}/msg/{kind}Object",
                    existence_probability=0.75,
                    classification=[
                        self.make(f"{package}/msg/ObjectClassification", label=classes[name], probability=p)
                        for name, p in (("BUS", 0.25), (label, 0.5))
                    ],
                    kinematics=self.make(
                        f"{package}/msg/{kind}ObjectKinematics", pose_with_covariance=covariance
                    ),
                    shape=self.make(f"{package}/msg/Shape", **self.shape(package, track)),
                    **identity,
                )
            )
        return self.make(f"{package}/msg/{kind}Objects", header=self.header(stamp_ns), objects=objects)

    def derived(self, stamp_ns):
        names = self.make.constants("derived_object_msgs/msg/Object")
        objects = [
            self.make(
                "derived_object_msgs/msg/Object",
                header=self.header(stamp_ns),
                id=int(track),
                detection_level=names["OBJECT_TRACKED"],
                object_classified=True,
                pose=self.pose(track, stamp_ns),
                shape=self.make(
                    "shape_msgs/msg/SolidPrimitive",
                    type=self.make.constants("shape_msgs/msg/SolidPrimitive")["BOX"],
                    dimensions=np.array([SIZES[track][i] for i in (1, 0, 2)]),
                ),
                classification=names[f"CLASSIFICATION_{label}"],
                classification_certainty=51,
            )
            for track, label in (("7", "CAR"), ("8", "PEDESTRIAN"))
        ]
        return self.make("derived_object_msgs/msg/ObjectArray", header=self.header(stamp_ns), objects=objects)

    def jsk(self, stamp_ns):
        boxes = [
            self.make(
                "jsk_recognition_msgs/msg/BoundingBox",
                header=self.header(stamp_ns),
                pose=self.pose(track, stamp_ns),
                dimensions=self.dimensions(track),
                value=0.25,
                label=int(track),
            )
            for track in SIZES
        ]
        return self.make(
            "jsk_recognition_msgs/msg/BoundingBoxArray", header=self.header(stamp_ns), boxes=boxes
        )

    def message(self, msgtype, stamp_ns):
        package, _, name = msgtype.split("/")
        if package.startswith("autoware"):
            return self.autoware(package, name.removesuffix("Objects"), stamp_ns)
        return self.derived(stamp_ns) if package == "derived_object_msgs" else self.jsk(stamp_ns)


def write(path, file_format, msgtype=None, **family):
    """Write the small drive with boxes of a type, 10 times a second; `family` as for `Family`."""
    with ExitStack() as stack:
        recorder = open_recorder(path, file_format, "none", stack)
        ros1 = recorder.messages.ros1
        events = [
            (stamp + LATENCY_NS, topic, kind, message)
            for topic, kind, stamp, message in messages(recorder.messages.store, 1.9, ros1=ros1)
        ]
        if msgtype is not None:
            maker = Family(recorder.messages.store, ros1=ros1, **family)
            for number in range(NUMBER):
                stamp = START_NS + PHASE_NS + number * PERIOD_NS
                events.append((stamp + LATENCY_NS, "/boxes", msgtype, maker.message(msgtype, stamp)))
        for log_time_ns, topic, kind, message in sorted(events, key=lambda event: event[0]):
            recorder.write(topic, kind, log_time_ns, message)


def build(folder, source, kind="annotations"):
    """Build the only recording; return table and counts of its boxes, and its nuScenes tables."""
    data = yaml.safe_load(RECIPE.format(name="test", root="bags"))
    data["rigs"][0][kind] = [source]
    (folder / "recipe.yaml").write_text(yaml.safe_dump(data))
    recipe = load_recipe(folder / "recipe.yaml")
    ((_, recording),) = discover(recipe.bags).recordings.items()
    store = Store(recipe.store_path)
    digest = recording_digest(recording).digest
    made = {
        result.asset: result
        for result in RecordingBuild(recipe, store, recording, digest, recording_stat(recording)).build()
    }
    boxes = made["annotations"].artifact
    counts = boxes.read_json("annotations.json")["counts"]
    (counts,) = counts.values()
    table = BoxTable.from_arrow(boxes.read_table("annotations.parquet"))
    return table, counts["boxes"], made["nuscenes_tables"].artifact


FAMILIES = {
    "autoware_perception_msgs/msg/DetectedObjects": ("car", "pedestrian", "", "", 0.75),
    "autoware_perception_msgs/msg/TrackedObjects": (
        "car", "pedestrian", UUIDS["7"].hex(), UUIDS["8"].hex(), 0.75,
    ),
    "autoware_auto_perception_msgs/msg/DetectedObjects": ("car", "pedestrian", "", "", 0.75),
    "autoware_auto_perception_msgs/msg/TrackedObjects": (
        "car", "pedestrian", UUIDS["7"].hex(), UUIDS["8"].hex(), 0.75,
    ),
    "derived_object_msgs/msg/ObjectArray": ("car", "pedestrian", "7", "8", 0.2),
    "jsk_recognition_msgs/msg/BoundingBoxArray": ("7", "8", "", "", 0.25),
}  # fmt: skip
ROS1 = ("derived_object_msgs/msg/ObjectArray", "jsk_recognition_msgs/msg/BoundingBoxArray")
CASES = [(name, "mcap") for name in FAMILIES] + [(name, "ros1") for name in ROS1]
WITHOUT_TRACK = [case for case in CASES if not FAMILIES[case[0]][2]]


@pytest.mark.parametrize(("msgtype", "file_format"), CASES)
def test_messages_are_read_as_their_definition_has_them(tmp_path, msgtype, file_format):
    write(tmp_path / "bags" / f"a.{'bag' if file_format == 'ros1' else file_format}", file_format, msgtype)
    table, counts, _ = build(tmp_path, {"topic": "/boxes"})
    assert (counts["read"], counts["written"], counts["lost"]) == (2 * NUMBER, 2 * NUMBER, {})
    car, pedestrian, car_track, pedestrian_track, score = FAMILIES[msgtype]
    for row in range(len(table)):
        true_track = next(track for track, size in SIZES.items() if size == tuple(table.sizes_m[row]))
        pose = odom_SE3_box(true_track, int(table.stamps_ns[row]))
        np.testing.assert_allclose(table.centers_m[row], pose.translation, atol=1e-9)
        assert abs(np.dot(table.rotations[row], pose.rotation)) == pytest.approx(1.0, abs=1e-12)
        expected = {"7": (car, car_track), "8": (pedestrian, pedestrian_track)}[true_track]
        assert (table.categories[row], table.tracks[row]) == expected
        assert table.scores[row] == pytest.approx(score, abs=1e-7)
    assert {int(stamp - START_NS - PHASE_NS) % PERIOD_NS for stamp in table.stamps_ns} == {0}


def test_a_footprint_around_another_point_of_the_object_is_the_same_box(tmp_path):
    msgtype = "autoware_perception_msgs/msg/TrackedObjects"
    write(tmp_path / "bags" / "a.mcap", "mcap", msgtype, footprints=True)
    table, counts, _ = build(tmp_path, {"topic": "/boxes"})
    assert (counts["written"], counts["lost"]) == (2 * NUMBER, {})
    for row in range(len(table)):
        track = next(track for track, uuid in UUIDS.items() if uuid.hex() == table.tracks[row])
        pose = odom_SE3_box(track, int(table.stamps_ns[row]))
        np.testing.assert_allclose(table.centers_m[row], pose.translation, atol=1e-6)  # points have 32 bit
        np.testing.assert_allclose(table.sizes_m[row], SIZES[track], atol=1e-6)
        assert abs(np.dot(table.rotations[row], pose.rotation)) == pytest.approx(1.0, abs=1e-12)


def keyframe_boxes(tables):
    """Yield the time of each sample and its rows."""
    rows = tables.read_json("sample_annotation.json")
    for sample in tables.read_json("sample.json"):
        yield sample["timestamp"] * 1000, [row for row in rows if row["sample_token"] == sample["token"]]


def assert_nearest(tables, stamps, labelled_after_ns=0, drift_m=0.0):
    """Each sample has each object once, where it was in the message that is nearest in time.

    Args:
        tables: the artifact.
        stamps: of the messages.
        labelled_after_ns: how much later than the true boxes in them these are.
        drift_m: how far, along x, their frame has moved on since.
    """
    seen = 0
    for keyframe_ns, rows in keyframe_boxes(tables):
        nearest = min(stamps, key=lambda stamp: abs(stamp - keyframe_ns))
        assert len(rows) == 2, f"{len(rows)} boxes of two objects"
        for row in rows:
            (track,) = [track for track, size in SIZES.items() if tuple(row["size"]) == size]
            true = np.array(odom_SE3_box(track, nearest - labelled_after_ns).translation)
            true[0] += drift_m
            np.testing.assert_allclose(row["translation"], true, atol=1e-4)
            assert (row["prev"], row["next"]) == ("", "")
        assert {tuple(row["size"]) for row in rows} == set(SIZES.values())
        seen += 1
    assert seen >= 3
    counts = tables.read_json("facts.json")["counts"]["boxes"]
    assert counts["annotations"] == counts["instances"] == 2 * seen
    assert counts["without_track"] == counts["observations"] == 2 * NUMBER
    assert counts["without_track_unused"] == 2 * NUMBER - 2 * seen
    assert (counts["tracks"], counts["tracks_without_keyframe"]) == (0, 0)


@pytest.mark.parametrize(("msgtype", "file_format"), WITHOUT_TRACK)
def test_of_messages_without_identity_a_keyframe_takes_the_nearest(tmp_path, msgtype, file_format):
    write(tmp_path / "bags" / f"a.{'bag' if file_format == 'ros1' else file_format}", file_format, msgtype)
    _, _, tables = build(tmp_path, {"topic": "/boxes"})
    assert_nearest(tables, [START_NS + PHASE_NS + number * PERIOD_NS for number in range(NUMBER)])


def test_boxes_with_identity_go_on_as_tracks(tmp_path):
    write(tmp_path / "bags" / "a.mcap", "mcap", "derived_object_msgs/msg/ObjectArray")
    _, _, tables = build(tmp_path, {"topic": "/boxes"})
    for keyframe_ns, rows in keyframe_boxes(tables):
        for row in rows:
            (track,) = [track for track, size in SIZES.items() if tuple(row["size"]) == size]
            np.testing.assert_allclose(
                row["translation"], odom_SE3_box(track, keyframe_ns).translation, atol=1e-4
            )
    counts = tables.read_json("facts.json")["counts"]["boxes"]
    assert (counts["tracks"], counts["instances"], counts["without_track"]) == (2, 2, 0)


def boxes_without_track(folder):
    entries = [{key: value for key, value in entry.items() if key != "track_id"} for entry in box_entries()]
    (folder / "a.json").write_text(box_json(entries))
    return {"format": "boxes", "path": "{stem}.json"}, 0.0


def kitti_objects(folder):
    return WRITERS["kitti_objects"](folder), SPEED_MPS * 0.03  # in the camera's frame, which drives on


@pytest.mark.parametrize("labels", [boxes_without_track, kitti_objects])
def test_of_label_files_without_identity_a_keyframe_takes_the_nearest_frame(tmp_path, labels):
    write(tmp_path / "bags" / "a.mcap", "mcap")
    source, drift_m = labels(tmp_path / "bags")
    _, counts, tables = build(tmp_path, {**source, "offset_s": 0.03}, "annotation_files")
    assert counts["written"] == 2 * NUMBER
    stamps = [START_NS + 35 * MS + frame * PERIOD_NS for frame in range(NUMBER)]
    assert_nearest(tables, stamps, 30 * MS, drift_m)
