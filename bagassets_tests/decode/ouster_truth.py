"""Packets of each profile as Ouster's own library writes them, and the points that it sees in them, for `test_ouster`.

By hand, in an environment of its own, as it does not fit beside the versions of rosbags and click that bagassets needs:

    python -m venv sdk && sdk/bin/pip install ouster-sdk==1.0.1
    sdk/bin/python bagassets_tests/decode/ouster_truth.py
"""

import json
from importlib.metadata import version
from pathlib import Path

import numpy as np

RESULT = Path(__file__).with_name("ouster_truth.json")
PROFILES = (
    "LEGACY", "RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_ZONE16", "RNG19_RFL8_SIG16_NIR16_RGB16",
    "RNG19_RFL8_SIG16_NIR16_DUAL", "RNG19_RFL8_SIG16_ZONE16_DUAL", "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL",
    "RNG15_RFL8_NIR8", "RNG15_RFL8_WIN8", "RNG15_RFL8_NIR8_ZONE16", "RNG15_RFL8_NIR8_DUAL", "FUSA_RNG15_RFL8_NIR8_DUAL",
)  # fmt: skip
COLUMNS, PER_PACKET = 6, 3
ALTITUDES, AZIMUTHS = [20.5, 3.25, -14.75], [3.1, -1.2, 0.9]
UP_MM = 2.5
IDENTITY = np.eye(4).ravel().tolist()


def metadata(profile):
    beam_to_lidar = np.eye(4)
    beam_to_lidar[0, 3], beam_to_lidar[2, 3] = 15.806, UP_MM
    return {
        "sensor_info": {
            "prod_line": "OS-1-32", "prod_sn": "1", "prod_pn": "1", "build_rev": "v3.1.0", "build_date": "", "status": "RUNNING",
            "image_rev": "ousteros-image-prod-aries-v3.1.0", "initialization_id": 5,
        },
        "beam_intrinsics": {
            "beam_altitude_angles": ALTITUDES, "beam_azimuth_angles": AZIMUTHS, "lidar_origin_to_beam_origin_mm": 15.806,
            "beam_to_lidar_transform": beam_to_lidar.ravel().tolist(),
        },
        "lidar_data_format": {
            "columns_per_frame": COLUMNS, "columns_per_packet": PER_PACKET, "pixels_per_column": len(ALTITUDES),
            "column_window": [0, COLUMNS - 1], "pixel_shift_by_row": [0, 0, 0], "udp_profile_lidar": profile,
            "udp_profile_imu": "LEGACY", "fps": 10,
        },
        # The library gives points in the frame of the housing, which is that of the lidar here.
        "lidar_intrinsics": {"lidar_to_sensor_transform": IDENTITY},
        "imu_intrinsics": {"imu_to_sensor_transform": IDENTITY},
        "config_params": {"lidar_mode": "1024x10", "udp_profile_lidar": profile, "columns_per_packet": PER_PACKET},
        "calibration_status": {}, "user_data": "",
    }  # fmt: skip


def case(profile, random):
    """Return metadata, packets in hexadecimal, and points: column, x, y, z (m), reflectivity, row."""
    from ouster.sdk.core import LidarFrame, PacketFormat, SensorInfo, XYZLut, frame_to_packets

    described = metadata(profile)
    info = SensorInfo(json.dumps(described))
    frame, shape = LidarFrame(info), (len(ALTITUDES), COLUMNS)
    frame.frame_id = 4711
    step = 8 if "RNG15" in profile else 1
    returns = [("RANGE", "REFLECTIVITY")] + [("RANGE2", "REFLECTIVITY2")] * (frame.has_field("RANGE2"))
    for ranges, reflectivities in returns:
        frame.field(ranges)[:] = random.integers(1, 200_000 // step, shape) * step
        frame.field(reflectivities)[:] = random.integers(0, 256, shape)
        frame.field(ranges)[1, 2] = 0
    frame.timestamp[:] = 1_700_000_000_000_000_000 + np.arange(COLUMNS) * 97_657
    frame.status[:] = 0xFFFFFFFF if profile == "LEGACY" else 1
    frame.status[4] = 0
    frame.measurement_id[:] = np.arange(COLUMNS)
    made = frame_to_packets(frame, PacketFormat(info), 5, 1)
    places = XYZLut(info)
    points = [
        [
            column,
            *(round(float(one), 6) for one in xyz[row, column]),
            int(frame.field(reflectivities)[row, column]),
            row,
        ]
        for ranges, reflectivities in returns
        for xyz in [places(frame.field(ranges))]
        for row, column in np.ndindex(shape)
        if column != 4 and frame.field(ranges)[row, column]
    ]
    packets = [bytes(packet.buf).hex() for packet in made]
    return {"metadata": described, "packets": packets, "points": sorted(points)}


def main():
    random = np.random.default_rng(1)
    cases = {profile: case(profile, random) for profile in PROFILES}
    RESULT.write_text(json.dumps({"ouster-sdk": version("ouster-sdk"), "cases": cases}) + "\n", "utf-8")


if __name__ == "__main__":
    main()
