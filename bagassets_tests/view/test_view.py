"""A scene as MCAP: what is read back is what is in the dataset."""

import json

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

from bagassets import __version__
from bagassets.assets.lidar_file import read_lidar_file
from bagassets.assets.radar_file import FIELDS, read_radar_file
from bagassets.base.errors import DatasetError
from bagassets.cli.main import main
from bagassets.decode.loading import load_decoder
from bagassets.decode.poses import decode_transform
from bagassets.decode.registry import families_of, find_decoder
from bagassets.geometry.se3 import SE3
from bagassets.recipe.model import Bags
from bagassets.recordings import own_files
from bagassets.recordings.discover import discover
from bagassets.recordings.open import open_recording
from bagassets.view.mcap_scene import write_scene
from bagassets.view.scene import load_scene, scene_names
from bagassets_tests.sample_drives import VERSION, build_sample, pose_of
from bagassets_tests.small_drive import write_drive

NUMPY = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    return build_sample(
        tmp_path_factory.mktemp("view"), seed=4, duration_s=2.4, targets=(("drive.mcap", "mcap"),)
    )


@pytest.fixture(scope="module")
def scene(built):
    return load_scene(built.dataroot, VERSION, "drive.mcap_000")


@pytest.fixture(scope="module")
def played(built, scene, tmp_path_factory):
    """Topic -> [(log time, message)], decoded by nothing but the schemas in the file."""
    path = tmp_path_factory.mktemp("mcap") / "scene.mcap"
    start = scene.readings[0].stamp_ns
    counts = write_scene(scene, path, [(start - 1, 1.0, 1.0), (start + 10, 48.0, 11.5)])
    found = {}
    classes = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            if schema.name not in classes:
                files = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
                pool = descriptor_pool.DescriptorPool()
                for file in files.file:
                    pool.Add(file)
                classes[schema.name] = message_factory.GetMessageClass(
                    pool.FindMessageTypeByName(schema.name)
                )
            decoded = classes[schema.name].FromString(message.data)
            found.setdefault(channel.topic, []).append((message.log_time, schema.name, decoded))
    assert counts == {topic: len(messages) for topic, messages in found.items()}
    return found


def test_a_scene_is_never_taken_for_a_recording(built, scene, tmp_path, capsys):
    write_drive(tmp_path / "drive.mcap", "mcap", 0.5)
    write_scene(scene, tmp_path / "scene.mcap")
    write_scene(scene, tmp_path / "older.mcap")
    older = tmp_path / "older.mcap"
    library = f"bagassets view {__version__}".encode()
    before = b"bagassets 0.9".ljust(len(library))
    older.write_bytes(older.read_bytes().replace(library, before, 1))
    discovery = discover(Bags(root=tmp_path))
    assert set(discovery.recordings) == {"drive.mcap"}
    assert dict(discovery.excluded) == dict.fromkeys(
        ("older.mcap", "scene.mcap"), "a scene that `bagassets view` wrote"
    )
    # The drives of `bagassets sample` are recordings, also before any of them is whole.
    (tmp_path / "torn.mcap").write_bytes((tmp_path / "drive.mcap").read_bytes()[:20])
    assert "torn.mcap" in discover(Bags(root=tmp_path)).recordings
    assert "drive.mcap" in discover(built.recipe.bags).recordings
    assert main(["init", str(tmp_path / "project"), "--bags", str(tmp_path / "scene.mcap")]) == 1
    assert "but this is a scene that `bagassets view` wrote" in capsys.readouterr().err


def test_heads_are_read_once(scene, tmp_path, monkeypatch):
    write_drive(tmp_path / "drive.mcap", "mcap", 0.5)
    discover(Bags(root=tmp_path))
    before = own_files._is_view_file.cache_info().misses
    discover(Bags(root=tmp_path))
    assert own_files._is_view_file.cache_info().misses == before
    write_scene(scene, tmp_path / "drive.mcap")
    assert set(discover(Bags(root=tmp_path)).recordings) == set()


def rows_of(built, channel):
    """Rows of sample_data of a channel, in order of time."""
    sensors = {row["token"] for row in built.tables["sensor"] if row["channel"] == channel}
    mounted = {row["token"] for row in built.tables["calibrated_sensor"] if row["sensor_token"] in sensors}
    rows = [row for row in built.tables["sample_data"] if row["calibrated_sensor_token"] in mounted]
    return sorted(rows, key=lambda row: row["timestamp"])


def by_token(built, table, token):
    return next(row for row in built.tables[table] if row["token"] == token)


def nanoseconds(stamp):
    return stamp.seconds * 10**9 + stamp.nanos


def se3(translation, rotation):
    return SE3.create(
        (rotation.w, rotation.x, rotation.y, rotation.z), (translation.x, translation.y, translation.z)
    )


class TestRoundTrip:
    @pytest.mark.parametrize("channel", ["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"])
    def test_images_are_the_files_at_their_stamps(self, built, played, channel):
        rows = rows_of(built, channel)
        messages = played[f"/{channel}/image"]
        assert len(messages) == len(rows) > 10
        for row, (log_time, name, message) in zip(rows, messages, strict=True):
            assert name == "foxglove.CompressedImage"
            assert log_time == nanoseconds(message.timestamp) == 1000 * row["timestamp"]
            assert message.data == (built.dataroot / row["filename"]).read_bytes()
            assert (message.format, message.frame_id) == ("jpeg", channel)

    def test_calibration_is_that_of_the_written_image(self, built, played):
        row = by_token(built, "calibrated_sensor", rows_of(built, "CAM_FRONT")[0]["calibrated_sensor_token"])
        _, name, message = played["/CAM_FRONT/calibration"][0]
        assert name == "foxglove.CameraCalibration"
        assert np.array(message.K).reshape(3, 3).tolist() == row["camera_intrinsic"]
        assert np.array(message.P).reshape(3, 4)[:, :3].tolist() == row["camera_intrinsic"]
        assert (message.width, message.height, len(message.D)) == (320, 200, 0)

    @pytest.mark.parametrize(
        ("channel", "columns"),
        [("LIDAR_TOP", ("x", "y", "z", "intensity", "ring")), ("RADAR_FRONT", FIELDS)],
    )
    def test_clouds_have_all_points_and_fields(self, built, played, channel, columns):
        rows = rows_of(built, channel)
        for row, (log_time, name, message) in zip(rows, played[f"/{channel}/points"], strict=True):
            assert name == "foxglove.PointCloud"
            assert log_time == 1000 * row["timestamp"]
            layout = np.dtype(
                {
                    "names": [field.name for field in message.fields],
                    "formats": ["<" + NUMPY[field.type] for field in message.fields],
                    "offsets": [field.offset for field in message.fields],
                    "itemsize": message.point_stride,
                }
            )
            points = np.frombuffer(message.data, layout)
            assert layout.names == tuple(columns)
            path = built.dataroot / row["filename"]
            truth = read_lidar_file(path) if channel == "LIDAR_TOP" else read_radar_file(path)
            assert len(points) == len(truth)
            for number, column in enumerate(columns):
                expected = truth[:, number] if channel == "LIDAR_TOP" else truth[column]
                assert (points[column] == expected).all(), column

    def test_transforms_lead_from_each_sensor_to_the_global_frame(self, built, played):
        trees = {}
        for log_time, name, message in played["/tf"]:
            assert name == "foxglove.FrameTransforms"
            edges = {edge.child_frame_id: edge for edge in message.transforms}
            assert {edge.parent_frame_id for edge in message.transforms} == {"global", "ego"}
            trees[log_time] = edges
        for channel in ("CAM_FRONT", "LIDAR_TOP", "RADAR_FRONT"):
            for row in rows_of(built, channel):
                edges = trees[1000 * row["timestamp"]]
                found = se3(edges["ego"].translation, edges["ego"].rotation) @ se3(
                    edges[channel].translation, edges[channel].rotation
                )
                expected = pose_of(by_token(built, "ego_pose", row["ego_pose_token"])) @ pose_of(
                    by_token(built, "calibrated_sensor", row["calibrated_sensor_token"])
                )
                assert found.translation == pytest.approx(expected.translation, abs=1e-6)
                assert np.abs(np.dot(found.rotation, expected.rotation)) == pytest.approx(1.0, abs=1e-9)

    def test_boxes_are_those_of_each_sample(self, built, played):
        samples = {row["token"]: 1000 * row["timestamp"] for row in built.tables["sample"]}
        messages = {log_time: message for log_time, _, message in played["/boxes"]}
        assert set(messages) == set(samples.values())
        number = 0
        for row in built.tables["sample_annotation"]:
            message = messages[samples[row["sample_token"]]]
            assert message.deletions[0].type == 1, "those before go"
            (entity,) = [entity for entity in message.entities if entity.id == row["instance_token"]]
            (cube,) = entity.cubes
            assert entity.frame_id == "global"
            width, length, height = row["size"]
            assert (cube.size.x, cube.size.y, cube.size.z) == (length, width, height)
            found = se3(cube.pose.position, cube.pose.orientation)
            assert found.translation == pytest.approx(row["translation"], abs=1e-9)
            assert found.rotation == pytest.approx(row["rotation"], abs=1e-6)
            facts = {pair.key: pair.value for pair in entity.metadata}
            category = by_token(built, "instance", row["instance_token"])["category_token"]
            assert facts["category"] == by_token(built, "category", category)["name"]
            assert facts["num_lidar_pts"] == str(row["num_lidar_pts"])
            number += 1
        assert number == sum(len(message.entities) for message in messages.values()) > 20

    def test_the_way_and_the_place(self, scene, played):
        ((_, name, path),) = played["/path"]
        assert name == "foxglove.PosesInFrame"
        assert len(path.poses) == len({reading.stamp_ns for reading in scene.readings})
        assert len(played["/ego"]) == len(path.poses)
        ((log_time, name, fix),) = played["/location"]
        assert (name, fix.latitude, fix.longitude) == ("foxglove.LocationFix", 48.0, 11.5)
        assert log_time == scene.readings[0].stamp_ns + 10

    def test_messages_are_in_order_of_time(self, played):
        for topic, messages in played.items():
            times = [log_time for log_time, _, _ in messages]
            assert times == sorted(times), topic


class TestPlaces:
    def test_a_scene_on_earth_needs_no_fixes(self, scene, tmp_path):
        origin = {"kind": "wgs84", "lat": 48.0, "lon": 11.0, "alt": 500.0}
        on_earth = type(scene)(**{**scene.__dict__, "origin": origin})
        counts = write_scene(on_earth, tmp_path / "a.mcap")
        stamps = {reading.stamp_ns for reading in scene.readings}
        assert counts["/location"] == len(stamps & set(scene.samples)) > 2


class TestFile:
    def test_the_same_scene_gives_the_same_bytes(self, scene, tmp_path):
        for name in ("a", "b"):
            write_scene(scene, tmp_path / name / "s.mcap")
        assert (tmp_path / "a" / "s.mcap").read_bytes() == (tmp_path / "b" / "s.mcap").read_bytes()

    def test_a_missing_file_is_named_and_nothing_is_left(self, scene, tmp_path):
        gone = type(scene.readings[0])(**{**scene.readings[5].__dict__, "path": tmp_path / "gone.jpg"})
        broken = type(scene)(**{**scene.__dict__, "readings": [*scene.readings[:5], gone]})
        with pytest.raises(DatasetError, match="gone"):
            write_scene(broken, tmp_path / "out" / "s.mcap")
        assert list((tmp_path / "out").iterdir()) == []


class TestCommand:
    def arguments(self, built):
        return ["view", "--dataroot", str(built.dataroot), "--version", VERSION]

    def test_it_lists_and_writes(self, built, tmp_path, capsys):
        assert main([*self.arguments(built), "--list", "--json"]) == 0
        assert (
            json.loads(capsys.readouterr().out) == scene_names(built.dataroot, VERSION) == ["drive.mcap_000"]
        )
        path = tmp_path / "x.mcap"
        assert main([*self.arguments(built), "drive.mcap_000", "--output", str(path), "--json"]) == 0
        reported = json.loads(capsys.readouterr().out)
        assert reported["messages"]["/boxes"] == len(built.tables["sample"])
        assert path.stat().st_size > 100_000

    def test_a_token_names_a_scene_too(self, built):
        token = built.tables["scene"][0]["token"]
        assert load_scene(built.dataroot, VERSION, token).name == "drive.mcap_000"

    def test_a_wrong_name_is_refused_with_a_suggestion(self, built, capsys):
        assert main([*self.arguments(built), "drive.mcap_00"]) == 1
        assert "did you mean drive.mcap_000?" in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [(["--dataroot", "x"], "go together"), (["--recipe", "none.yaml"], "name a scene")],
    )
    def test_wrong_usage(self, arguments, words, capsys):
        assert main(["view", *arguments]) == 2
        assert words in capsys.readouterr().err

    def test_without_a_dataset_it_says_what_to_do(self, tmp_path, capsys):
        assert main(["view", "--dataroot", str(tmp_path), "--version", "v9", "x"]) == 1
        assert "run `bagassets build` first" in capsys.readouterr().err


# By our own decoders, as those of any other recording.


@pytest.fixture(scope="module")
def read_back(scene, tmp_path_factory):
    """Topic -> readings of its messages."""
    path = tmp_path_factory.mktemp("mcap") / "scene.mcap"
    start_ns = scene.readings[0].stamp_ns
    counts = write_scene(scene, path, [(start_ns + 10, 48.25, 11.5)])
    found = {}
    with open_recording(path) as recording:
        assert {name: topic.count for name, topic in recording.topics.items()} == counts
        assert not any(topic.problem for topic in recording.topics.values())
        for raw in recording.messages(list(recording.topics)):
            message = recording.decode(raw)
            for family in families_of(raw.msgtype)[:1]:
                decoder = load_decoder(find_decoder(family, raw.msgtype))
                readings = found.setdefault(raw.topic, [])
                if family == "boxes":
                    readings += [decoder.decode(message, item) for item in decoder.items(message)]
                elif family == "transforms":
                    readings += [decode_transform(item) for item in decoder(message)]
                else:
                    readings.append(decoder(message))
    return found


def of_modality(scene, modality):
    return [reading for reading in scene.readings if reading.modality == modality]


def test_images_are_the_files_when_read_back(scene, read_back):
    cameras = of_modality(scene, "camera")
    for channel in {reading.channel for reading in cameras}:
        own = [reading for reading in cameras if reading.channel == channel]
        for was, now in zip(own, read_back[f"/{channel}/image"], strict=True):
            assert (now.stamp_ns, now.frame_id, now.encoding) == (was.stamp_ns, channel, "jpeg")
            assert bytes(now.encoded) == was.path.read_bytes()
        for was, now in zip(own, read_back[f"/{channel}/calibration"], strict=True):
            assert np.array(now.calibration.k).reshape(3, 3).tolist() == [list(row) for row in was.intrinsics]


def test_clouds_have_the_points_of_the_files_when_read_back(scene, read_back):
    for was, now in zip(of_modality(scene, "lidar"), read_back["/LIDAR_TOP/points"], strict=True):
        assert now.stamp_ns == was.stamp_ns
        assert np.array_equal(now.points, read_lidar_file(was.path))


def test_poses_and_transforms_are_those_of_the_readings_when_read_back(scene, read_back):
    poses = {reading.stamp_ns: reading.find_pose() for reading in scene.readings}
    assert {one.stamp_ns for one in read_back["/ego"]} == set(poses)
    for one in [*read_back["/ego"], *(edge for edge in read_back["/tf"] if edge.child == "ego")]:
        assert one.parent == "global"
        assert one.parent_SE3_child.translation == poses[one.stamp_ns].translation
        assert np.allclose(one.parent_SE3_child.rotation, poses[one.stamp_ns].rotation, atol=1e-12)


def test_boxes_are_those_of_the_samples_when_read_back(scene, read_back):
    was = [(stamp_ns, row) for stamp_ns in sorted(scene.boxes) for row in scene.boxes[stamp_ns]]
    assert len(was) > 10
    for (stamp_ns, row), box in zip(was, read_back["/boxes"], strict=True):
        assert (box.stamp_ns, box.frame_id, box.track_id) == (stamp_ns, "global", row["instance_token"])
        assert (box.category, list(box.attributes)) == (row["category"], list(row["attributes"]))
        assert list(box.size_m) == row["size"]
        assert list(box.frame_SE3_box.translation) == row["translation"]
        assert np.allclose(box.frame_SE3_box.rotation, row["rotation"], atol=1e-12)


def test_places_are_those_of_the_fixes_when_read_back(scene, read_back):
    (one,) = read_back["/location"]
    assert (one.lat_deg, one.lon_deg, one.stamp_ns) == (48.25, 11.5, scene.readings[0].stamp_ns + 10)
