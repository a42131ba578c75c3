"""Radar messages: whatever they are called, targets come out at the same place."""

import math

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bagassets.base.errors import DecodeError
from bagassets.decode.radar import decode_radar, is_single_track
from bagassets.decode.radar_fields import radar_reading
from bagassets_tests.sweep_data import cloud

STAMP = 1_700_000_000_500_000_000
CLOUD = "sensor_msgs/msg/PointCloud2"

RADAR_RETURN = (
    "float32 range\nfloat32 azimuth\nfloat32 elevation\nfloat32 doppler_velocity\nfloat32 amplitude"
)
RADAR_TRACK = (
    "unique_identifier_msgs/UUID uuid\ngeometry_msgs/Point position\ngeometry_msgs/Vector3 velocity\n"
    "geometry_msgs/Vector3 acceleration\ngeometry_msgs/Vector3 size\nuint16 classification\n"
    "float32[6] position_covariance"
)
OLD_TRACK = "uint16 track_id\ngeometry_msgs/Polygon track_shape\ngeometry_msgs/Vector3 linear_velocity"
ESR_TRACK = (
    "std_msgs/Header header\nstring canmsg\nuint8 track_ID\nfloat32 track_lat_rate\nbool track_group_changed\n"
    "uint8 track_status\nfloat32 track_angle\nfloat32 track_range\nfloat32 track_range_rate"
)
OBJECT = "int32 id\nfloat32 x_distance\nfloat32 y_distance\nfloat32 vrel_long\nfloat32 vrel_lat\nfloat32 rcs"
TYPES = {
    "radar_msgs/msg/RadarReturn": RADAR_RETURN,
    "radar_msgs/msg/RadarScan": "std_msgs/Header header\nradar_msgs/RadarReturn[] returns",
    "radar_msgs/msg/RadarTrack": RADAR_TRACK,
    "radar_msgs/msg/RadarTracks": "std_msgs/Header header\nradar_msgs/RadarTrack[] tracks",
    "old_msgs/msg/RadarTrack": OLD_TRACK,
    "old_msgs/msg/RadarTrackArray": "std_msgs/Header header\nold_msgs/RadarTrack[] tracks",
    "delphi_esr_msgs/msg/EsrTrack": ESR_TRACK,
    "ars_msgs/msg/Object": OBJECT,
    "ars_msgs/msg/ObjectList": "std_msgs/Header header\nstring[] warnings\nars_msgs/Object[] items",
    "sick/msg/RadarScan": (
        "std_msgs/Header header\nsensor_msgs/PointCloud2 targets\nars_msgs/Object[] objects"
    ),
}


@pytest.fixture(scope="module")
def types():
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in TYPES.items():
        store.register(get_types_from_msg(text, name))
    return store


@pytest.fixture(scope="module")
def make(types):
    """Builds a message by type and fields, through serialization as recordings have it."""

    def build(msgtype, **fields):
        return types.types[msgtype](**fields)

    def message(msgtype, **fields):
        stamp = build("builtin_interfaces/msg/Time", sec=STAMP // 10**9, nanosec=STAMP % 10**9)
        header = build("std_msgs/msg/Header", stamp=stamp, frame_id="/radar")
        whole = build(msgtype, header=header, **fields)
        return types.deserialize_cdr(types.serialize_cdr(whole, msgtype), msgtype)

    message.part = build
    return message


def near(actual, expected):
    assert np.allclose(actual, expected, atol=1e-6), (actual, expected)


def test_cartesian_cloud_with_all_the_fields_of_nuscenes():
    columns = {name: np.array([value, value], np.float32) for name, value in {
        "x": 10, "y": -2, "z": 0.5, "rcs": 7, "vx": 1, "vy": 2, "vx_comp": 3, "vy_comp": 4, "dyn_prop": 1, "id": 9,
    }.items()}  # fmt: skip
    reading = decode_radar(cloud(STAMP, columns, "radar"), CLOUD)
    assert reading.stamp_ns == STAMP
    assert reading.frame_id == "radar"
    for name, values in columns.items():
        near(reading.targets[name], values)


@pytest.mark.parametrize("doppler", ["doppler", "vrad", "radial_velocity", "range_rate"])
def test_polar_cloud_is_laid_out_with_angles_to_the_left(doppler):
    columns = {
        "range": np.array([10.0, 20.0]),
        "azimuth": np.array([0.5, -0.25]),
        "elevation": np.array([0.1, 0.0]),
        doppler: np.array([-3.0, 2.0]),
        "power": np.array([30.0, 40.0]),
    }
    targets = decode_radar(cloud(STAMP, columns), CLOUD).targets
    near(targets["x"], [10 * math.cos(0.1) * math.cos(0.5), 20 * math.cos(0.25)])
    near(targets["y"], [10 * math.cos(0.1) * math.sin(0.5), -20 * math.sin(0.25)])
    near(targets["z"], [10 * math.sin(0.1), 0])
    near(targets["vx"], [-3 * math.cos(0.1) * math.cos(0.5), 2 * math.cos(0.25)])
    near(targets["vy"], [-3 * math.cos(0.1) * math.sin(0.5), -2 * math.sin(0.25)])
    near(targets["rcs"], [30, 40])


def test_the_recipe_can_turn_the_side_of_angles():
    columns = {"range": np.array([10.0]), "azimuth": np.array([0.5])}
    assert decode_radar(cloud(STAMP, columns), CLOUD, "left").targets["y"][0] > 0
    assert decode_radar(cloud(STAMP, columns), CLOUD, "right").targets["y"][0] < 0


def test_radial_speed_lies_along_the_line_of_sight_of_cartesian_targets():
    columns = {"x": np.array([3.0]), "y": np.array([4.0]), "z": np.array([0.0]), "vrad": np.array([10.0]),
               "vr_comp": np.array([5.0])}  # fmt: skip
    targets = decode_radar(cloud(STAMP, columns), CLOUD).targets
    near([targets[name][0] for name in ("vx", "vy", "vx_comp", "vy_comp")], [6, 8, 3, 4])


def test_targets_that_are_none_are_dropped_and_counted():
    columns = {"x": np.array([1.0, np.nan, 0.0, 5.0]), "y": np.array([1.0, 1.0, 0.0, np.inf])}
    reading = decode_radar(cloud(STAMP, columns), CLOUD)
    assert reading.targets["x"].tolist() == [1.0]
    assert reading.dropped == 3


@pytest.mark.parametrize("names", [("range",), ("azimuth",), ("x",), ("y",), ("y", "z"), ("x", "range")])
def test_a_cloud_without_position_is_refused(names):
    with pytest.raises(DecodeError, match="neither x and y"):
        decode_radar(cloud(STAMP, {name: np.array([1.0]) for name in names}), CLOUD)


def test_half_a_position_does_not_hide_a_whole_one():
    columns = {"x": np.array([7.0]), "range": np.array([10.0]), "azimuth": np.array([0.0])}
    near(decode_radar(cloud(STAMP, columns), CLOUD).targets["x"], [10.0])


def test_radar_scan_has_angles_to_the_left_as_its_definition_says(make):
    returns = [
        make.part(
            "radar_msgs/msg/RadarReturn", range=10.0, azimuth=azimuth, elevation=0.0, doppler_velocity=-2.0, amplitude=5.0
        )
        for azimuth in (0.5, -0.5)
    ]  # fmt: skip
    message = make("radar_msgs/msg/RadarScan", returns=returns)
    assert not is_single_track(message)
    reading = decode_radar(message, "radar_msgs/msg/RadarScan")
    assert reading.frame_id == "radar"
    near(reading.targets["y"], [10 * math.sin(0.5), -10 * math.sin(0.5)])
    near(reading.targets["vx"], [-2 * math.cos(0.5)] * 2)
    near(reading.targets["rcs"], [5, 5])
    turned = decode_radar(message, "radar_msgs/msg/RadarScan", "right")
    near(turned.targets["y"], -reading.targets["y"])


def test_radar_tracks_have_positions_and_velocities(make):
    point = lambda kind, x, y, z: make.part(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)
    tracks = [
        make.part(
            "radar_msgs/msg/RadarTrack",
            uuid=make.part("unique_identifier_msgs/msg/UUID", uuid=np.arange(number, number + 16, dtype=np.uint8)),
            position=point("Point", 10.0 + number, 2.0, 0.5),
            velocity=point("Vector3", 3.0, -1.0, 0.0),
            acceleration=point("Vector3", 9.0, 9.0, 9.0),
            size=point("Vector3", 4.0, 2.0, 1.5),
            classification=1,
            position_covariance=np.zeros(6, np.float32),
        )
        for number in range(3)
    ]  # fmt: skip
    reading = decode_radar(make("radar_msgs/msg/RadarTracks", tracks=tracks), "radar_msgs/msg/RadarTracks")
    near(reading.targets["x"], [10, 11, 12])
    near(reading.targets["y"], [2, 2, 2])
    near(reading.targets["z"], [0.5] * 3)
    near(reading.targets["vx"], [3] * 3)
    near(reading.targets["vy"], [-1] * 3)
    assert len(set(reading.targets["id"].tolist())) == 3
    assert reading.targets["id"].max() < 1 << 15


def test_tracks_with_an_outline_lie_at_its_centre(make):
    corner = lambda x, y: make.part("geometry_msgs/msg/Point32", x=x, y=y, z=0.0)
    shape = make.part("geometry_msgs/msg/Polygon", points=[corner(9.0, 1.0), corner(11.0, 3.0)])
    velocity = make.part("geometry_msgs/msg/Vector3", x=1.0, y=0.0, z=0.0)
    track = make.part("old_msgs/msg/RadarTrack", track_id=7, track_shape=shape, linear_velocity=velocity)
    message = make("old_msgs/msg/RadarTrackArray", tracks=[track])
    targets = decode_radar(message, "old_msgs/msg/RadarTrackArray").targets
    near([targets[name][0] for name in ("x", "y", "vx", "id")], [10, 2, 1, 7])


def test_objects_by_the_names_of_a_can_bus(make):
    item = make.part("ars_msgs/msg/Object", id=3, x_distance=8.0, y_distance=-1.0, vrel_long=2.0, vrel_lat=0.5, rcs=4.0)  # fmt: skip
    message = make("ars_msgs/msg/ObjectList", warnings=["blind"], items=[item])
    targets = decode_radar(message, "ars_msgs/msg/ObjectList").targets
    near([targets[name][0] for name in ("id", "x", "y", "z", "vx", "vy", "rcs")], [3, 8, -1, 0, 2, 0.5, 4])


def test_an_esr_track_is_a_message_of_its_own_in_degrees_to_the_right(make):
    message = make(
        "delphi_esr_msgs/msg/EsrTrack", canmsg="x", track_ID=5, track_lat_rate=0.0, track_group_changed=False,
        track_status=3, track_angle=30.0, track_range=20.0, track_range_rate=-4.0,
    )  # fmt: skip
    assert is_single_track(message)
    targets = decode_radar(message, "delphi_esr_msgs/msg/EsrTrack").targets
    near(targets["x"], [20 * math.cos(math.pi / 6)])
    near(targets["y"], [-10])
    near(targets["vx"], [-4 * math.cos(math.pi / 6)])
    near(targets["id"], [5])


def test_an_esr_track_without_target_is_dropped(make):
    message = make(
        "delphi_esr_msgs/msg/EsrTrack", canmsg="x", track_ID=5, track_lat_rate=0.0, track_group_changed=False,
        track_status=0, track_angle=0.0, track_range=0.0, track_range_rate=0.0,
    )  # fmt: skip
    reading = decode_radar(message, "delphi_esr_msgs/msg/EsrTrack")
    assert len(reading.targets["x"]) == 0
    assert reading.dropped == 1


@pytest.mark.parametrize("points", [0, 2])
def test_a_message_with_a_cloud_and_objects_takes_what_is_filled(make, points):
    point_field = lambda name, offset: make.part("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=7, count=1)  # fmt: skip
    header = make("radar_msgs/msg/RadarScan", returns=[]).header
    targets = make.part(
        "sensor_msgs/msg/PointCloud2", header=header, height=1, width=points,
        fields=[point_field(name, 4 * place) for place, name in enumerate("xyz")] if points else [],
        is_bigendian=False, point_step=12, row_step=12 * points,
        data=np.frombuffer(np.ones((points, 3), np.float32).tobytes(), np.uint8), is_dense=True,
    )  # fmt: skip
    item = make.part("ars_msgs/msg/Object", id=3, x_distance=8.0, y_distance=-1.0, vrel_long=2.0, vrel_lat=0.5, rcs=4.0)  # fmt: skip
    message = make("sick/msg/RadarScan", targets=targets, objects=[item])
    found = decode_radar(message, "sick/msg/RadarScan").targets["x"].tolist()
    assert found == ([1.0, 1.0] if points else [8.0])
    assert not is_single_track(message)


def test_a_scan_without_returns_is_a_reading_without_targets(make):
    message = make("radar_msgs/msg/RadarScan", returns=[])
    reading = decode_radar(message, "radar_msgs/msg/RadarScan")
    assert len(reading.targets["x"]) == 0
    assert reading.dropped == 0


def test_a_message_that_is_no_radar_is_refused(types, make):
    message = make("sensor_msgs/msg/Temperature", temperature=1.0, variance=0.0)
    with pytest.raises(DecodeError, match="neither x and y"):
        decode_radar(message, "sensor_msgs/msg/Temperature")
    with pytest.raises(DecodeError, match="header"):
        decode_radar(make.part("std_msgs/msg/Float32", data=1.0), "std_msgs/msg/Float32")


# Field of the nuScenes format, or part of a position -> names under which drivers publish it.
NAMES = {
    "vx": "vx v_x vel_x velocity_x velocity.x linear_velocity.x twist.linear.x twist.twist.linear.x "
    "velocity.twist.linear.x vrel_long x_velocity longitude_vel",
    "vy": "vy v_y vel_y velocity_y velocity.y linear_velocity.y twist.linear.y twist.twist.linear.y "
    "velocity.twist.linear.y vrel_lat y_velocity lateral_vel",
    "rcs": "rcs radar_cross_section amplitude power intensity snr can_tx_detect_amplitude",
    "id": "id track_id object_id target_id detection_id cluster_id objid uuid",
    "vx_comp": "vx_comp vx_compensated v_x_comp",
    "vy_comp": "vy_comp vy_compensated v_y_comp",
    "dyn_prop": "dyn_prop dynprop dynamic_property",
    "is_quality_valid": "is_quality_valid",
    "ambig_state": "ambig_state ambiguity_state",
    "x_rms": "x_rms",
    "y_rms": "y_rms",
    "invalid_state": "invalid_state",
    "pdh0": "pdh0",
    "vx_rms": "vx_rms",
    "vy_rms": "vy_rms",
}


@pytest.mark.parametrize(
    ("field", "name"), [(field, name) for field, names in NAMES.items() for name in names.split()]
)
def test_fields_go_by_the_names_of_drivers(field, name):
    values = np.array([3.0, 4.0])
    columns = {"x": np.array([1.0, 2.0]), "y": np.array([5.0, 6.0]), name: values}
    if field == "vy":
        columns["vx"] = np.array([7.0, 8.0])
    targets = radar_reading(STAMP, "radar", columns, "left").targets
    near(targets[field], values)
    if field == "vx":
        near(targets["vy"], [0.0, 0.0])


PLACES = "position. pose.position. pose.pose.position. centroid. track_shape.centroid. object_box_center.pose.position. "
PLACES += "bounding_box_center.position. kinematics.position."
POSITIONS = [("x", "y", "z"), *((f"{place}x", f"{place}y", f"{place}z") for place in PLACES.split())]
POSITIONS += [
    ("pos_x", "pos_y", "pos_z"), ("position_x", "position_y", "position_z"), ("x_distance", "y_distance", "z"),
    ("dist_long", "dist_lat", "z"), ("long_dist", "lat_dist", "z"), ("longitude_dist", "lateral_dist", "z"),
]  # fmt: skip


@pytest.mark.parametrize("names", POSITIONS)
def test_positions_go_by_the_names_of_drivers(names):
    columns = dict(
        zip(names, (np.array([1.0, 2.0]), np.array([-3.0, 4.0]), np.array([0.5, 0.25])), strict=True)
    )
    targets = radar_reading(STAMP, "radar", columns, "left").targets
    near([targets[axis] for axis in "xyz"], list(columns.values()))


@pytest.mark.parametrize(
    "distance", ["range", "distance", "rng", "r", "track_range", "can_tx_detect_range", "radial_distance"]
)
@pytest.mark.parametrize(
    ("azimuth", "unit"),
    [
        ("azimuth", 1.0), ("azimuth_angle", 1.0), ("az", 1.0), ("angle", math.pi / 180), ("azimuth_deg", math.pi / 180),
        ("track_angle", math.pi / 180), ("can_tx_detect_angle", math.pi / 180),
    ],
)  # fmt: skip
def test_polar_positions_go_by_the_names_of_drivers(distance, azimuth, unit):
    targets = radar_reading(
        STAMP, "radar", {distance: np.array([10.0]), azimuth: np.array([0.75])}, "left"
    ).targets
    near([targets["x"][0], targets["y"][0]], [10 * math.cos(0.75 * unit), 10 * math.sin(0.75 * unit)])
    near(targets["z"], [0.0])


@pytest.mark.parametrize(
    ("name", "unit"),
    [("elevation", 1.0), ("elevation_angle", 1.0), ("el", 1.0), ("elevation_deg", math.pi / 180)],
)
def test_elevations_go_by_the_names_of_drivers(name, unit):
    columns = {"range": np.array([10.0]), "azimuth": np.array([0.5]), name: np.array([0.25])}
    near(radar_reading(STAMP, "radar", columns, "left").targets["z"], [10 * math.sin(0.25 * unit)])


RADIAL = "doppler doppler_velocity range_rate radial_velocity radial_speed vrad v_r vr velocity speed rate "
RADIAL += "track_range_rate can_tx_detect_range_rate"
RADIAL_COMP = "v_r_comp vr_comp doppler_comp radial_velocity_comp v_r_compensated vrad_comp"


@pytest.mark.parametrize(
    ("name", "fields"),
    [(name, ("vx", "vy")) for name in RADIAL.split()]
    + [(name, ("vx_comp", "vy_comp")) for name in RADIAL_COMP.split()],
)
def test_radial_speeds_go_by_the_names_of_drivers(name, fields):
    columns = {"x": np.array([3.0]), "y": np.array([4.0]), name: np.array([10.0])}
    targets = radar_reading(STAMP, "radar", columns, "left").targets
    near([targets[field][0] for field in fields], [6.0, 8.0])


def test_velocities_as_measured_win_over_the_radial_speed():
    columns = {
        "x": np.array([3.0]), "y": np.array([4.0]), "vrad": np.array([10.0]), "vr_comp": np.array([10.0]),
        "vx": np.array([1.0]), "vy": np.array([2.0]), "vx_comp": np.array([0.5]), "vy_comp": np.array([0.25]),
    }  # fmt: skip
    targets = radar_reading(STAMP, "radar", columns, "left").targets
    near([targets[name][0] for name in ("vx", "vy", "vx_comp", "vy_comp")], [1.0, 2.0, 0.5, 0.25])
    near(targets["z"], [0.0])


def test_an_outline_without_points_is_no_target(make):
    empty = make.part("geometry_msgs/msg/Polygon", points=[])
    still = make.part("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    track = make.part("old_msgs/msg/RadarTrack", track_id=7, track_shape=empty, linear_velocity=still)
    reading = decode_radar(
        make("old_msgs/msg/RadarTrackArray", tracks=[track]), "old_msgs/msg/RadarTrackArray"
    )
    assert len(reading.targets["x"]) == 0
    assert reading.dropped == 1
