"""Ouster's packets and metadata: against what Ouster's own library makes of them, and what is wrong with them."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bagassets.base.errors import DecodeError
from bagassets.decode.ouster import OusterLidar, packet_in
from bagassets_tests import ouster_data
from bagassets_tests.ouster_data import COLUMNS, metadata, packet

TRUTH = json.loads(Path(__file__).with_name("ouster_truth.json").read_text("utf-8"))


@pytest.mark.parametrize("profile", TRUTH["cases"])
def test_points_are_those_of_ousters_own_library(profile):
    case = TRUTH["cases"][profile]
    lidar = OusterLidar.parse(json.dumps(case["metadata"]))
    packets = [lidar.read(bytes.fromhex(data)) for data in case["packets"]]
    assert [lidar.frame_of(one) for one in packets] == [4711] * len(packets)
    columns = lidar.decode(np.array(packets))
    assert columns.numbers.tolist() == [0, 1, 2, 3, 5]  # one is marked as invalid
    assert (columns.times_ns == 1_700_000_000_000_000_000 + columns.numbers * 97_657).all()
    beams = len(lidar.altitudes_deg)
    found = sorted(
        [column, *point[:3].tolist(), point[3], beams - 1 - point[4]]
        for column, point in zip(columns.numbers[columns.of_points].tolist(), columns.points, strict=True)
    )
    expected = np.array(case["points"])
    assert np.array(found).shape == expected.shape
    order = np.lexsort(np.round(expected[:, [1, 5, 0]], 3).T)
    own = np.lexsort(np.round(np.array(found)[:, [1, 5, 0]], 3).T)
    np.testing.assert_allclose(np.array(found)[own], expected[order], rtol=1e-6, atol=2e-6)
    assert columns.without_return == 1


def test_metadata_of_every_firmware_says_the_same():
    flat = json.loads(metadata())
    nested = {
        "beam_intrinsics": {key: flat[key] for key in flat if key.startswith(("beam_", "lidar_origin"))},
        "lidar_data_format": flat["data_format"],
        "config_params": {"lidar_mode": "64x10"},
    }
    first = flat | {
        "data_format": {"udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16"}
    }  # as of firmware 1, all from the mode
    known = vars(OusterLidar.parse(metadata()))
    for other in (nested, first):
        assert vars(OusterLidar.parse(json.dumps(other))) == known
    del first["data_format"]
    assert OusterLidar.parse(json.dumps(first)).profile == "LEGACY"
    refused = json.dumps(first | {"lidar_data_format": "error: invalid path"})  # what firmware 1.12 answers
    assert vars(OusterLidar.parse(refused)) == vars(OusterLidar.parse(json.dumps(first)))


@pytest.mark.parametrize(
    ("model", "origin_mm"),
    [("OS-0-32-U0", 27.67), ("OS-1-64", 15.806), ("OS-2-128", 13.762), (None, 12.163)],
)
def test_where_firmware_1_does_not_say_where_beams_begin_the_model_does(model, origin_mm):
    flat = json.loads(metadata())
    del flat["lidar_origin_to_beam_origin_mm"]
    for where in ({"prod_line": model}, {"sensor_info": {"prod_line": model}}):
        assert OusterLidar.parse(json.dumps(flat | where)).origin_mm == (origin_mm, 0.0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"", "no metadata of an Ouster"),
        (b"[1]", "no metadata of an Ouster"),
        (b"{}", "no metadata of an Ouster .*beam_altitude_angles"),
        (b"\xff", "no metadata of an Ouster"),
        (json.dumps(json.loads(metadata()) | {"lidar_origin_to_beam_origin_mm": None}), "no metadata of an Ouster"),
        (json.dumps(json.loads(metadata()) | {"beam_azimuth_angles": [1.0]}), "one altitude and one azimuth for each of 4"),
        (json.dumps(json.loads(metadata()) | {"beam_azimuth_angles": [1.0, 2.0, 3.0, float("nan")]}), "not finite"),
        (metadata(pixels_per_column=8), "for each of 8 beams"),
        (metadata(udp_profile_lidar="RNG99"), "the profile RNG99 of its packets cannot be read"),
        (metadata(columns_per_packet=128), "columns do not fit"),
        (metadata(column_window=[0, 64]), "columns do not fit"),
        (metadata(columns_per_frame=10**9), "columns do not fit"),
    ],
)  # fmt: skip
def test_metadata_that_cannot_be_used_says_why(text, reason):
    with pytest.raises(DecodeError, match=reason):
        OusterLidar.parse(text)


@pytest.mark.parametrize(
    "message", [object(), *(SimpleNamespace(buf=odd) for odd in (None, "text", 4, 1 << 63, ["text"]))]
)
def test_a_message_of_that_name_without_a_packet_says_so(message):
    with pytest.raises(DecodeError, match="no field buf with the bytes of a packet"):
        packet_in(message)


def test_packets_of_another_lidar_are_told_by_size_and_columns():
    lidar = OusterLidar.parse(metadata())
    with pytest.raises(
        DecodeError, match=r"its packet has 48 bytes, those of the metadata \d+; name the metadata of"
    ):
        lidar.read(bytes(48))
    assert lidar.read(packet(0) + b"\0") == lidar.read(packet(0))  # of drivers before 2023
    with pytest.raises(DecodeError, match="its packet has"):
        lidar.read(packet(0) + b"\0\0")
    half = OusterLidar.parse(metadata(columns_per_frame=32, column_window=[0, 31]))
    with pytest.raises(DecodeError, match="a lidar with more than 32 columns"):
        half.read(packet(32))


def test_columns_count_once_in_the_order_of_their_times():
    lidar = OusterLidar.parse(metadata())
    packets = [np.frombuffer(packet(first), lidar.packet)[0] for first in (0, 16)]
    expected = lidar.decode(np.array(packets))
    other = lidar.decode(np.array([packets[1], packets[0], packets[1]]))
    assert other.numbers.tolist() == expected.numbers.tolist() == list(range(32))
    assert other.points.tobytes() == expected.points.tobytes()


def test_columns_that_a_turn_does_not_have_are_left_out():
    lidar = OusterLidar.parse(metadata())
    data = np.frombuffer(packet(0), lidar.packet).copy()
    data["columns"]["number"][0, 3] = COLUMNS
    assert lidar.decode(data).numbers.tolist() == [0, 1, 2, *range(4, 16)]


def test_a_second_return_from_the_same_place_is_no_point():
    case = TRUTH["cases"]["RNG19_RFL8_SIG16_NIR16_DUAL"]
    lidar = OusterLidar.parse(json.dumps(case["metadata"]))
    data = np.frombuffer(b"".join(bytes.fromhex(one) for one in case["packets"]), lidar.packet).copy()
    pixels = data["columns"]["pixels"].view(np.uint8).reshape(-1, 16)
    pixels[:, 4:8] = pixels[:, :4]
    data["columns"]["pixels"] = pixels.reshape(-1).view("V16").reshape(data["columns"]["pixels"].shape)
    assert len(lidar.decode(data).points) == len(case["points"]) / 2


def test_turns_are_counted_in_32_bits_where_the_header_is_for_functional_safety():
    case = TRUTH["cases"]["FUSA_RNG15_RFL8_NIR8_DUAL"]
    data = bytearray.fromhex(case["packets"][0])
    data[4:8] = (1 << 20).to_bytes(4, "little")
    for change in ({}, {"udp_profile_lidar": "RNG15_RFL8_NIR8_DUAL", "header_type": "FUSA"}):
        described = case["metadata"] | {"lidar_data_format": case["metadata"]["lidar_data_format"] | change}
        lidar = OusterLidar.parse(json.dumps(described))
        assert (lidar.frame_of(lidar.read(bytes(data))), lidar.frames) == (1 << 20, 1 << 32)


def test_the_beams_are_where_they_point():
    lidar = OusterLidar.parse(metadata())
    columns = lidar.decode(np.frombuffer(packet(16), lidar.packet))
    for point, of in zip(columns.points, columns.of_points, strict=True):
        beam = 3 - int(point[4])  # the lidar counts from the highest
        expected = ouster_data.seen(int(columns.numbers[of]), beam)
        np.testing.assert_allclose(point[:3], expected, atol=1e-6)
        assert point[3] == 40 + beam
