#!/usr/bin/env bash
# One AEDAT4 file of an event camera is read by two libraries: dv-processing, of the maker of the camera, which writes the format, and aedat. A
# picture of it is red, and it lies still, turning by 90 degrees per second. Do they agree?
# Guess: yes: a picture, and the units of the IMU as robotics has them, or the same in both.
# Seen with dv-processing 2.0.4 and aedat 2.3.0 on 2026-11-29:
# - the picture is blue, green, red in dv-processing, and red, green, blue in aedat, as an array of the same shape
# - the accelerations of aedat are in g and its rates in degrees per second: 1.0 and 90.0. dv-processing has the same numbers as attributes
#   (`accelerometerZ`), and m/s2 and radians per second in its functions (`getAccelerations`): 9.81 and 1.57
# - the time `t` of a frame of aedat is where the exposure begins (`exposure_begin_t`), as in dv-processing; its `begin_t` and `end_t` are 0
# None of the names has a unit.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dv-processing==2.0.4 aedat==2.3.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
from datetime import timedelta

import aedat
import dv_processing as dv
import numpy as np

START_US, SIZE = 1_700_000_000_000_000, (346, 260)
RED_BGR = (10, 20, 200)

config = dv.io.MonoCameraWriter.Config("DAVIS346")
config.addFrameStream(SIZE)
config.addImuStream()
writer = dv.io.MonoCameraWriter("camera.aedat4", config)
frame = dv.Frame(START_US, np.full((SIZE[1], SIZE[0], 3), RED_BGR, np.uint8))
frame.exposure = timedelta(milliseconds=8)
writer.writeFrame(frame)
writer.writeImu(dv.IMU(START_US, 30.0, 0.0, 0.0, 1.0, 90.0, 0.0, 0.0, 0.0, 0.0, 0.0))
del writer

recording = dv.io.MonoCameraRecording("camera.aedat4")
picture, (imu,) = recording.getNextFrame(), recording.getNextImuBatch()
packets = {name: packet[name] for packet in aedat.Decoder("camera.aedat4") for name in packet}
other, other_imu = packets["frame"], packets["imus"][0]
print(f"dv-processing: {picture.image[0, 0]}, {imu.accelerometerZ} or {imu.getAccelerations()[2]:.2f}, "
      f"{imu.gyroscopeX} or {imu.getAngularVelocities()[0]:.2f}")
print(f"aedat: {other['pixels'][0, 0]}, {other_imu['accelerometer_z']}, {other_imu['gyroscope_x']}, begin {other['begin_t']}")
assert picture.image[0, 0].tolist() == list(RED_BGR)
assert other["pixels"][0, 0].tolist() == list(RED_BGR[::-1])
assert (imu.accelerometerZ, imu.gyroscopeX) == (1.0, 90.0) == (other_imu["accelerometer_z"], other_imu["gyroscope_x"])
assert np.allclose((imu.getAccelerations()[2], imu.getAngularVelocities()[0]), (9.81, np.pi / 2), atol=1e-3)
assert other["t"] == other["exposure_begin_t"] == picture.timestamp == START_US
assert other["exposure_end_t"] == START_US + 8000
assert (other["begin_t"], other["end_t"]) == (0, 0)
PYTHON
