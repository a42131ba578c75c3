"""Foxglove's messages in protobuf (written by the real foxglove-sdk), JSON and CDR give the readings of what was written."""

import numpy as np
import pytest

from bagassets.base.errors import DecodeError
from bagassets.decode.loading import load_decoder, own_decoder
from bagassets.decode.poses import decode_transform
from bagassets.decode.registry import find_decoder
from bagassets.geometry.se3 import SE3
from bagassets.recordings.open import open_recording
from bagassets_tests.foxglove_files import NS, WRITERS, E, M, T, pose, write_protobuf

HALF = 0.5**0.5
TURN = (HALF, 0.0, 0.0, HALF)  # a quarter to the left
PNG = b"\x89PNG\r\n\x1a\nrest"


@pytest.fixture(params=WRITERS)
def read(request, tmp_path):
    """Write messages, and return what a family's decoder makes of them."""

    def reading(family, *messages):
        items = [("/topic", NS + number, message) for number, message in enumerate(messages)]
        return decoded(WRITERS[request.param](tmp_path / "a.mcap", items), family)

    return reading


def decoded(path, family):
    with open_recording(path) as recording:
        topic = recording.topics["/topic"]
        assert topic.problem is None
        heads, readings = [], []
        for raw in recording.messages(["/topic"]):
            message = recording.decode(raw)
            heads.append(topic.header(raw.data))
            decoder = load_decoder(find_decoder(family, topic.msgtype))
            match family:
                case "boxes":
                    readings += [decoder.decode(message, item) for item in decoder.items(message)]
                case "transforms":
                    readings += [decode_transform(item) for item in decoder(message)]
                case "cloud":
                    readings.append(decoder(message, None, "end"))
                case _:
                    readings.append(decoder(message))
        return topic.msgtype, heads, readings


def stamped(kind, **fields):
    return M(kind, timestamp=T(NS), frame_id="/sensor", **fields)


def test_compressed_images(read):
    msgtype, heads, (reading,) = read("image", stamped("CompressedImage", data=PNG, format="png"))
    assert msgtype == "foxglove_msgs/msg/CompressedImage"
    assert heads == [(NS, "sensor")]
    assert (reading.stamp_ns, reading.frame_id, reading.encoding) == (NS, "sensor", "png")
    assert bytes(reading.encoded) == PNG


def test_raw_images(read):
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    fields = {"width": 4, "height": 2, "encoding": "rgb8", "step": 12, "data": pixels.tobytes()}
    _, _, (reading,) = read("image", stamped("RawImage", **fields))
    assert np.array_equal(reading.pixels, pixels)
    assert reading.encoding == "rgb8"


def cloud(**fields):
    points = np.zeros(
        2, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1"), ("pad", "u1")])
    )
    points["x"], points["y"], points["z"], points["intensity"] = [1, 2], [3, 4], [5, 6], [7, 255]
    packed = [
        M("PackedElementField", name=name, offset=offset, type=E(kind))
        for name, offset, kind in (("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 1))
    ]
    given = {"pose": pose(), "point_stride": 14, "fields": packed, "data": points.tobytes()}
    return stamped("PointCloud", **(given | fields))


def test_point_clouds(read):
    _, _, (reading,) = read("cloud", cloud())
    assert reading.points.tolist() == [[1, 3, 5, 7, -1], [2, 4, 6, 255, -1]]
    assert (reading.stamp_ns, reading.frame_id) == (NS, "sensor")


def test_points_are_placed_where_their_origin_is(read):
    _, _, (reading,) = read("cloud", cloud(pose=pose(10.0, 0.0, 0.0, TURN)))
    assert np.allclose(reading.points[:, :3], [[7, 1, 5], [6, 2, 6]], atol=1e-6)


def test_laser_scans(read):
    scan = stamped(
        "LaserScan", pose=pose(0.0, 0.0, 2.0), start_angle=0.0, end_angle=np.pi / 2,
        ranges=[1.0, 0.0, 2.0], intensities=[5.0, 6.0, 7.0],
    )  # fmt: skip
    _, _, (reading,) = read("cloud", scan)
    assert np.allclose(reading.points, [[1, 0, 2, 5, 0], [0, 2, 2, 7, 0]], atol=1e-6)
    assert reading.dropped == 1
    assert reading.times_ns is None


def edge(child, x):
    return M(
        "FrameTransform", timestamp=T(NS), parent_frame_id="/base", child_frame_id=child,
        translation=M("Vector3", x=x, y=0.0, z=0.0), rotation=M("Quaternion", x=0.0, y=0.0, z=HALF, w=HALF),
    )  # fmt: skip


def test_transforms_one_by_one_and_together(read):
    truth = [SE3.create(TURN, (x, 0.0, 0.0)) for x in (1.0, 2.0)]
    _, heads, single = read("transforms", edge("cam", 1.0), edge("lidar", 2.0))
    assert heads == [(NS, "base")] * 2
    _, heads, together = read(
        "transforms", M("FrameTransforms", transforms=[edge("cam", 1.0), edge("lidar", 2.0)])
    )
    assert heads == [(NS, "base")]
    for readings in (single, together):
        assert [(one.stamp_ns, one.parent, one.child) for one in readings] == [
            (NS, "base", "cam"),
            (NS, "base", "lidar"),
        ]
        for one, true in zip(readings, truth, strict=True):
            assert np.allclose(one.parent_SE3_child.rotation, true.rotation)
            assert one.parent_SE3_child.translation == true.translation


def test_poses(read):
    _, _, (reading,) = read("pose", stamped("PoseInFrame", pose=pose(1.5, -2.5, 3.5, (0.0, 1.0, 0.0, 0.0))))
    assert (reading.stamp_ns, reading.parent, reading.child) == (NS, "sensor", "")
    assert reading.parent_SE3_child == SE3((0.0, 1.0, 0.0, 0.0), (1.5, -2.5, 3.5))


def test_fixes(read):
    fix = stamped("LocationFix", latitude=48.25, longitude=11.5, altitude=500.0)
    _, _, (reading,) = read("fix", fix)
    assert (reading.lat_deg, reading.lon_deg, reading.alt_m, reading.stamp_ns) == (48.25, 11.5, 500.0, NS)


def test_calibrations(read):
    k = [100.0, 0.0, 32.0, 0.0, 100.0, 24.0, 0.0, 0.0, 1.0]
    r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    p = [100.0, 0.0, 32.0, 0.0, 0.0, 100.0, 24.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    fields = {"width": 64, "height": 48, "distortion_model": "plumb_bob", "D": [0.1, 0.0, 0.0, 0.0, 0.0]}
    _, _, (reading,) = read("camera_info", stamped("CameraCalibration", **fields, K=k, R=r, P=p))
    calibration = reading.calibration
    assert (calibration.k, calibration.d, calibration.model) == (
        tuple(k),
        (0.1, 0.0, 0.0, 0.0, 0.0),
        "plumb_bob",
    )
    assert (calibration.width, calibration.height, calibration.binning) == (64, 48, (1, 1))
    assert (calibration.roi.width, calibration.roi.height) == (64, 48)


def entity(track, category, **more):
    metadata = {"category": category, "attributes": "moving, wet", "score": "0.5"} | more
    pairs = [M("KeyValuePair", key=key, value=value) for key, value in metadata.items() if value]
    cube = M("CubePrimitive", pose=pose(1.0, 2.0, 3.0), size=M("Vector3", x=4.0, y=2.0, z=1.5))
    return stamped("SceneEntity", id=track, metadata=pairs, cubes=[cube])


def test_boxes(read):
    _, heads, boxes = read(
        "boxes", M("SceneUpdate", entities=[entity("t1", "car"), entity("t2", "", label="bus")])
    )
    assert heads == [(NS, "sensor")]
    assert [(box.track_id, box.category, box.size_m, box.attributes) for box in boxes] == [
        ("t1", "car", (2.0, 4.0, 1.5), ("moving", "wet")),
        ("t2", "bus", (2.0, 4.0, 1.5), ("moving", "wet")),
    ]
    assert {(box.stamp_ns, box.frame_id, box.score) for box in boxes} == {(NS, "sensor", 0.5)}
    assert {box.frame_SE3_box for box in boxes} == {SE3(translation=(1.0, 2.0, 3.0))}


def test_a_box_without_a_class_is_lost(read):
    with pytest.raises(DecodeError, match="name no class"):
        read("boxes", M("SceneUpdate", entities=[entity("t", "")]))


def test_odometry_names_its_child(tmp_path):
    odometry = M("Odometry", timestamp=T(NS), frame_id="odom", body_frame_id="base", pose=pose(1.0))
    _, _, (reading,) = decoded(write_protobuf(tmp_path / "a.mcap", [("/topic", NS, odometry)]), "pose")
    assert (reading.parent, reading.child) == ("odom", "base")


def test_what_protobuf_leaves_out_is_absent(tmp_path):
    """No stamp is no stamp, rather than 1970; no origin is the origin; no quaternion is no pose."""
    path = write_protobuf(tmp_path / "a.mcap", [("/topic", NS, M("PoseInFrame", frame_id="map"))])
    with open_recording(path) as recording:
        (raw,) = recording.messages(["/topic"])
        message = recording.decode(raw)
        assert not message.HasField("timestamp")
        assert recording.topics["/topic"].header(raw.data) == (0, "map")
        with pytest.raises(DecodeError, match="quaternion"):
            own_decoder("pose", raw.msgtype)(message)
    bare = cloud(pose=None)
    _, _, (reading,) = decoded(write_protobuf(tmp_path / "b.mcap", [("/topic", NS, bare)]), "cloud")
    assert reading.points[:, 0].tolist() == [1, 2]
