#!/usr/bin/env bash
# An estimator's poses come with covariances: 2 m, 1 m and 0.5 m along x, y and z, and 1, 2 and 10 mrad about them. They are turned by 90 degrees into another map with
# cnspy-trajectory (`TrajectoryEstimated.transform`); covariances of the body's orientation are brought into the map (`convert_to_global_covariance`); and a flat robot's
# poses (x, y, yaw) are read (`Pose2DStamped`). Guess: 1, 2, 0.5 m and 2, 1, 10 mrad; and yaw as it was.
# Seen with cnspy-trajectory 0.2.14 on 2026-11-30, without a word:
# - both in the map's frame (type 6): 2 mm, 1 mm and 10 mm along x, y and z: the turned covariance of the orientation is kept as that of the position
# - in the body's frame (type 5): `convert_to_global_covariance` says type 6 afterwards, and has the numbers of before; so does the trajectory that it was cloned from
# - yaw of 90 degrees is 76, of 180 degrees 115: half of it goes into the quaternion without a sine
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check cnspy-trajectory==0.2.14 cnspy-timestamp-association==0.2.1 cnspy-csv2dataframe==0.2.3 cnspy-numpy-utils==0.2.1 \
  cnspy-spatial-csv-formats==0.2.2 spatialmath-python==1.1.18 numpy==2.4.6 pandas==3.1.1 2>/dev/null
cat > covariances.py <<'PYTHON'
import numpy as np
import pandas as pd
from cnspy_spatial_csv_formats.CSVSpatialFormat import CSVSpatialFormat
from cnspy_spatial_csv_formats.CSVSpatialFormatType import CSVSpatialFormatType
from cnspy_spatial_csv_formats.ErrorRepresentationType import ErrorRepresentationType
from cnspy_spatial_csv_formats.EstimationErrorType import EstimationErrorType
from cnspy_trajectory.Trajectory import Trajectory
from cnspy_trajectory.TrajectoryEstimated import TrajectoryEstimated

QUARTER_TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
SIGMAS_M, SIGMAS_RAD = np.array([2, 1, 0.5]), np.array([1e-3, 2e-3, 1e-2])


def estimated(kind):
    """One pose, turned to the left by 90 degrees, with covariances of this kind."""
    left = np.array([[0, 0, np.sqrt(0.5), np.sqrt(0.5)]])
    covariances = {"Sigma_p_vec": np.diag(SIGMAS_M**2)[None], "Sigma_R_vec": np.diag(SIGMAS_RAD**2)[None]}
    poses = TrajectoryEstimated(t_vec=np.zeros((1, 1)), p_vec=np.zeros((1, 3)), q_vec=left, **covariances)
    poses.set_format(CSVSpatialFormat(CSVSpatialFormatType.PosOrientWithCov, est_err_type=kind, err_rep_type=ErrorRepresentationType.theta_so3))
    return poses


def sigmas(covariances):
    return np.sqrt(np.diag(covariances[0]))


turned = estimated(EstimationErrorType.type6)
turned.transform(R_GN=QUARTER_TURN)
print("turned by 90 degrees:", sigmas(turned.Sigma_p_vec), "m,", sigmas(turned.Sigma_R_vec), "rad")
assert np.allclose(sigmas(turned.Sigma_p_vec), SIGMAS_RAD[[1, 0, 2]]) and np.allclose(sigmas(turned.Sigma_R_vec), SIGMAS_RAD)

local = estimated(EstimationErrorType.type5)
converted = local.clone()
converted.convert_to_global_covariance()
print("from the body's frame:", sigmas(converted.Sigma_R_vec), "rad,", converted.format.estimation_error_type, "and that it was cloned from", local.format.estimation_error_type)
assert np.allclose(sigmas(converted.Sigma_R_vec), SIGMAS_RAD)
assert converted.format.estimation_error_type == local.format.estimation_error_type == EstimationErrorType.type6

yaws_deg = np.array([0, 30, 90, 150, 180.0])
table = pd.DataFrame({"t": np.arange(5.0), "tx": 0.0, "ty": 0.0, "yaw": np.radians(yaws_deg)})
read_deg = np.degrees(Trajectory(df=table, fmt=CSVSpatialFormatType.Pose2DStamped).get_rpy_vec()[:, 2])
print("yaw of", yaws_deg, "degrees:", read_deg.round(1))
assert np.allclose(read_deg, np.degrees(2 * np.arctan(np.radians(yaws_deg) / 2)))
PYTHON
venv/bin/python covariances.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
