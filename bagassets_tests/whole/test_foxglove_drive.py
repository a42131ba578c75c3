"""A drive in Foxglove's messages, as protobuf, JSON and CDR: `init` finds it, and it gives the artifacts of its twin in ROS."""

from functools import partial

import cv2
import numpy as np
import pytest
import yaml
from mcap.writer import Writer
from rosbags.typesys import get_types_from_msg

from bagassets.assets.frames import FrameExtractor
from bagassets.propose.proposal import propose_recipe
from bagassets.propose.scan import scan_recording
from bagassets.recipe import load_recipe
from bagassets.recordings.open import open_recording
from bagassets.store.artifact import ArtifactWriter
from bagassets.store.store import Store
from bagassets_tests.cameras import camera_use
from bagassets_tests.foxglove_files import ROS2, WRITERS, E, M, T, pose
from bagassets_tests.recorded_bags import NOON_NS, header, write_ros1, write_ros2
from bagassets_tests.recorded_bags import Message as RosMessage
from bagassets_tests.sample_drives import build_recordings
from bagassets_tests.small_drive import LATENCY_NS, RECIPE, STORE2, messages, write_drive
from bagassets_tests.video_streams import HEIGHT, WIDTH, encode, number_in

ODOMETRY = "{source: odometry, topic: /odom}"


def time_of(header):
    return T(header.stamp.sec * 10**9 + header.stamp.nanosec)


def quaternion(one):
    return M("Quaternion", x=one.x, y=one.y, z=one.z, w=one.w)


COMPRESSED = "sensor_msgs/msg/CompressedImage"
CAMERA = "modality: camera, undistort: false, extrinsics: {translation: [0, 0, 0], rotation: [1, 0, 0, 0]}"


def as_foxglove(msgtype, message):
    """Return the twin of a message of the small drive."""
    match msgtype.rpartition("/")[2]:
        case "TFMessage":
            edges = [
                M(
                    "FrameTransform", timestamp=time_of(one.header), parent_frame_id=one.header.frame_id,
                    child_frame_id=one.child_frame_id,
                    translation=M("Vector3", **{axis: getattr(one.transform.translation, axis) for axis in "xyz"}),
                    rotation=quaternion(one.transform.rotation),
                )
                for one in message.transforms
            ]  # fmt: skip
            return M("FrameTransforms", transforms=edges)
        case "Odometry":
            at = message.pose.pose.position
            return stamped("PoseInFrame", message, pose=pose(at.x, at.y, at.z))
        case "Image":
            fields = {name: getattr(message, name) for name in ("width", "height", "encoding", "step")}
            return stamped("RawImage", message, **fields, data=message.data.tobytes())
        case "CameraInfo":
            matrices = {name.upper(): getattr(message, name).tolist() for name in "dkrp"}
            fields = {name: getattr(message, name) for name in ("width", "height", "distortion_model")}
            return stamped("CameraCalibration", message, **fields, **matrices)
        case "PointCloud2":
            fields = [
                M("PackedElementField", name=one.name, offset=one.offset, type=E(7)) for one in message.fields
            ]
            data = message.data.tobytes()
            return stamped("PointCloud", message, pose=pose(), point_stride=16, fields=fields, data=data)
    raise AssertionError(msgtype)


def stamped(kind, message, **fields):
    return M(kind, timestamp=time_of(message.header), frame_id=message.header.frame_id, **fields)


def drive(duration_s=1.2):
    return [
        (topic, stamp_ns + LATENCY_NS, as_foxglove(msgtype, message))
        for topic, msgtype, stamp_ns, message in messages(STORE2, duration_s)
    ]


def built(folder, write, poses):
    (folder / "bags").mkdir(parents=True)
    write(folder / "bags/drive.mcap")
    text = RECIPE.format(name="twin", root="bags").replace(ODOMETRY, poses)
    (folder / "recipe.yaml").write_text(text)
    recipe = load_recipe(folder / "recipe.yaml")
    (made,) = build_recordings(recipe).values()
    return recipe, made


def files_of(recipe, made, asset):
    """Return the digests of the files of an asset, of channels without what names their recording."""
    artifact = made[asset].artifact
    if asset in {"frames", "sweeps"}:
        channels = artifact.read_json("channels.json")
        artifacts = [
            Store(recipe.store_path).artifact(entry["artifact"]) for _, entry in sorted(channels.items())
        ]
    else:
        artifacts = [artifact]
    return [(file.path, file.digest) for one in artifacts for file in one.entries()]


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ros")
    return built(folder, lambda path: write_drive(path, "mcap", 1.2), ODOMETRY)


@pytest.mark.parametrize("encoding", WRITERS)
def test_the_files_are_those_of_the_twin_in_ros(tmp_path, twin, encoding):
    own = built(tmp_path, lambda path: WRITERS[encoding](path, drive()), "{source: pose, topic: /odom}")
    for asset in ("frames", "sweeps", "calibration"):
        assert files_of(*own, asset) == files_of(*twin, asset)
    (own_table,), (its_table,) = (
        [one for one in files_of(*it, "ego_poses") if one[0].endswith("parquet")] for it in (own, twin)
    )
    assert own_table == its_table


@pytest.mark.parametrize("encoding", WRITERS)
def test_init_finds_it(tmp_path, encoding):
    with open_recording(WRITERS[encoding](tmp_path / "a.mcap", drive(6.0))) as recording:
        proposal = propose_recipe({"drive": scan_recording(recording)}, name="drive", root="bags")
    (rig,) = yaml.safe_load(proposal.text)["rigs"]
    assert rig["ego_pose"]["source"] == "pose"
    channels = {name: (one["modality"], one["topic"]) for name, one in rig["channels"].items()}
    assert channels == {"CAM_FRONT": ("camera", "/cam/image_raw"), "LIDAR_TOP": ("lidar", "/points")}


def video_drive(path, write, codec="libx264", lost=()):
    """Write a drive whose camera sends video of painted numbers, at 20 Hz."""
    kept = [one for one in drive(6.0) if one[0] != "/cam/image_raw" and one[0] != "/cam/camera_info"]
    start_ns = kept[0][1]
    name = {"libx264": "h264", "libx265": "h265", "libsvtav1": "av1", "libvpx-vp9": "vp9"}[codec]
    for number, data in encode(codec, 100):
        if number in lost:
            continue
        stamp_ns = start_ns + number * 50_000_000
        video = M("CompressedVideo", timestamp=T(stamp_ns), frame_id="cam", data=data, format=name)
        kept.append(("/cam/video", stamp_ns + LATENCY_NS, video))
    write(path, sorted(kept, key=lambda one: one[1]))
    return start_ns


@pytest.mark.parametrize(
    ("encoding", "codec"),
    [
        ("protobuf", "libx264"),
        ("json", "libx264"),
        ("cdr", "libx265"),
        ("protobuf", "libsvtav1"),
        ("cdr", "libvpx-vp9"),
    ],
)
def test_video_becomes_images_of_a_proposed_recipe(tmp_path, encoding, codec):
    (tmp_path / "bags").mkdir()
    path = tmp_path / "bags/drive.mcap"
    start_ns = video_drive(path, WRITERS[encoding], codec, lost=range(33, 36))
    with open_recording(path) as recording:
        text = propose_recipe({"drive.mcap": scan_recording(recording)}, name="drive", root="bags").text
    recipe_file = tmp_path / "recipe.yaml"
    recipe_file.write_text(text.replace("modality: camera", "modality: camera\n        output: png"))
    recipe = load_recipe(recipe_file)
    assert recipe.rigs[0].channels["CAM_FRONT"].topic == "/cam/video"
    shows_all_but_33_to_39(recipe, start_ns)


def shows_all_but_33_to_39(recipe, start_ns):
    """Assert that the pictures of a drive that lacks the packets 33 to 35 stand at their times."""
    (made,) = build_recordings(recipe).values()
    entry = made["frames"].artifact.read_json("channels.json")["CAM_FRONT"]
    frames = Store(recipe.store_path).artifact(entry["artifact"])
    shown = {
        (int(path.stem) - start_ns) // 50_000_000: number_in(cv2.imread(str(path)))
        for path in frames.files.glob("*.png")
    }
    assert shown == {number: number for number in range(100) if not 33 <= number < 40}
    assert frames.read_json("channel.json")["counts"] == {
        "read": 97, "written": 93, "merged": 0, "lost": {"packets before it are missing, and so is the picture that it refers to": 4},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("write", "codec", "said"),
    [
        (partial(write_ros2, storage="MCAP"), "libx264", "h264"),
        (write_ros2, "libx265", "hevc"),
        (write_ros1, "libx264", "h264"),
    ],
    ids=["mcap", "ros2", "ros1"],
)
def test_video_in_messages_for_images_becomes_images_of_a_proposed_recipe(tmp_path, write, codec, said):
    """As Isaac ROS and Isaac Sim publish it; a camera that sends JPEGs keeps the key that it has."""
    (tmp_path / "bags").mkdir()
    path, start_ns = tmp_path / "bags/drive.bag", NOON_NS

    def compressed(topic, kind, data, number):
        at_ns = start_ns + number * 50_000_000
        pixels = np.frombuffer(data, np.uint8)
        return RosMessage(
            topic, COMPRESSED, at_ns + LATENCY_NS,
            lambda store: store.types[COMPRESSED](header(store, at_ns, "cam"), kind, pixels),
        )  # fmt: skip

    written = [
        compressed("/cam/video", said, data, number)
        for number, data in encode(codec, 100)
        if not 33 <= number < 36
    ]
    jpeg = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    written += [compressed("/rear/image_raw/compressed", "jpeg", jpeg, number) for number in range(100)]
    write(path, sorted(written, key=lambda one: one.log_time_ns))
    with open_recording(path) as recording:
        text = propose_recipe({path.name: scan_recording(recording)}, name="drive", root="bags").text
    (rig,) = yaml.safe_load(text)["rigs"]
    outputs = {one["topic"]: one.get("output") for one in rig["channels"].values()}
    assert outputs == {"/cam/video": None, "/rear/image_raw/compressed": "as_recorded"}
    recipe_file = tmp_path / "recipe.yaml"
    recipe_file.write_text(
        "name: drive\nbags: {root: bags, settle_s: 0}\nrigs:\n  - name: van\n    ego_pose: {source: fixed}\n"
        f"    channels:\n      CAM_BACK: {{topic: /rear/image_raw/compressed, {CAMERA}}}\n"
        f"      CAM_FRONT: {{topic: /cam/video, output: png, {CAMERA}}}\n"
    )
    shows_all_but_33_to_39(load_recipe(recipe_file), start_ns)


def test_the_decoder_is_in_the_key_of_video_and_of_nothing_else(tmp_path, monkeypatch):
    plain, made = built(
        tmp_path / "a", lambda path: WRITERS["protobuf"](path, drive()), "{source: pose, topic: /odom}"
    )
    video_drive(tmp_path / "a/bags/video.mcap", WRITERS["protobuf"])
    text = (tmp_path / "a/recipe.yaml").read_text()
    (tmp_path / "a/recipe.yaml").write_text(text.replace("/cam/image_raw}", "/cam/video, undistort: false}"))
    video = load_recipe(tmp_path / "a/recipe.yaml")
    before = build_recordings(video)["video.mcap"]["frames"]
    monkeypatch.setattr("bagassets.decode.video.version", lambda _name: "99")
    after = build_recordings(video)["video.mcap"]["frames"]
    assert build_recordings(video)["video.mcap"]["frames"].cached
    assert (before.action_digest != after.action_digest, after.cached) == (True, False)
    assert build_recordings(plain)["drive.mcap"]["frames"].action_digest == made["frames"].action_digest


def test_ffmpeg_packets_of_ros(tmp_path):
    """As ffmpeg_image_transport publishes them, in ROS 2."""
    text = "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\nbool is_bigendian\nuint8[] data\n"
    name = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
    ROS2.register(get_types_from_msg(text, name))
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(
            name, "ros2msg", ROS2.generate_msgdef(name, ros_version=2)[0].encode()
        )
        channel = writer.register_channel("/cam", "cdr", schema)
        for number, data in encode(number=12):
            stamp = ROS2.types["builtin_interfaces/msg/Time"](100, number * 50_000_000)
            header = ROS2.types["std_msgs/msg/Header"](stamp, "cam")
            array = np.frombuffer(data, np.uint8)
            packet = ROS2.types[name](
                header, WIDTH, HEIGHT, "libx264;yuv420p;bgr8;bgr8", number, 1, False, array
            )
            writer.add_message(channel, number, bytes(ROS2.serialize_cdr(packet, name)), number)
        writer.finish()
    use = camera_use(name, video="av", period_ns=50_000_000, output="png")
    with open_recording(tmp_path / "a.mcap") as recording:
        extractor = FrameExtractor(use, recording, ArtifactWriter(tmp_path / "artifact"))
        for message in recording.messages(["/cam"]):
            extractor.add(message)
        assert extractor.finish()["counts"]["written"] == 12
    for number in range(12):
        picture = cv2.imread(str(tmp_path / f"artifact/files/{100 * 10**9 + number * 50_000_000}.png"))
        assert number_in(picture) == number
