#!/usr/bin/env bash
# Policies for arms take a rotation as six numbers, two columns of its matrix (Zhou et al., 2019), next to the position; datasets keep them so. A hand is turned by (yaw, pitch, roll) = (20, 10, 5)
# degrees from one step to the next. Which six numbers are they? Guess: the first column, then the second, in all libraries, and each reads its own. Seen on 2026-11-30, none says so in its data:
#   pybvh 0.9.0, bvhTools 1.6.0, eastworlds-forge 0.7.0, mcap-data-loader 0.3.5 (`Rotation6D`)   the first column, then the second
#   pytorch-kinematics 0.10.0 (as PyTorch3D), robot-utils 0.1.4                                  the first ROW, then the second
#   mcap-data-loader 0.3.5 (`to_relative_pose`, so its `RelaPose` with rot6d)                    both columns by turns, row by row
# What one writes and another reads is the inverse rotation: 45 degrees off. What mcap-data-loader makes relative is 56 or 79 degrees off in each of them, itself included; all are proper rotations,
# by Gram-Schmidt, so nothing is refused.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 scipy==1.17.1 torch==2.13.0 pybvh==0.9.0 bvhTools==1.6.0 av==18.1.0
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps mcap-data-loader==0.3.5 eastworlds-forge==0.7.0 robot-utils==0.1.4 pytorch-kinematics==0.10.0
cd "$folder"
venv/bin/python -W ignore - 2>errors.txt <<'PYTHON' || { tail -5 errors.txt; exit 1; }
import importlib.util
import sys
from pathlib import Path

import numpy as np
import torch
from bvhTools.angleConversion import scipyToSixD, sixDToScipy
from forge_cli.convert.handheld import matrix_to_6d, sixd_to_matrix
from mcap_data_loader.utils.rela_abs import to_relative_pose
from mcap_data_loader.utils.rot6d import Rotation6D
from pybvh import rotations
from scipy.spatial.transform import Rotation


def module(path):
    """Return the module of one file, without the others of its package and what these import."""
    found = next(Path(folder) / path for folder in sys.path if (Path(folder) / path).exists())
    spec = importlib.util.spec_from_file_location(found.stem, found)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


kinematics = module("pytorch_kinematics/transforms/rotation_conversions.py")
utilities = module("robot_utils/pose_utils.py")
turn = Rotation.from_euler("ZYX", [20, 10, 5], degrees=True)
before = Rotation.from_euler("ZYX", [40, -30, 60], degrees=True)
zero = np.zeros(3)
written = {
    "pybvh": rotations.rotmat_to_rot6d(turn.as_matrix()),
    "bvhTools": scipyToSixD(turn),
    "eastworlds-forge": matrix_to_6d(turn.as_matrix()),
    "mcap-data-loader": Rotation6D.matrix_to_rot6d(turn.as_matrix()),
    "pytorch-kinematics": kinematics.matrix_to_rotation_6d(torch.tensor(turn.as_matrix())).numpy(),
    "robot-utils": utilities.mat_to_rot_6d(turn.as_matrix()),
    "mcap-data-loader, relative": to_relative_pose(zero, before.as_quat(), zero, (before * turn).as_quat())[2],
}
readers = {
    "pybvh": rotations.rot6d_to_rotmat,
    "bvhTools": lambda six: sixDToScipy(six).as_matrix(),
    "eastworlds-forge": sixd_to_matrix,
    "mcap-data-loader": Rotation6D.rot6d_to_matrix,
    "pytorch-kinematics": lambda six: kinematics.rotation_6d_to_matrix(torch.tensor(six)).numpy(),
    "robot-utils": utilities.rot_6d_to_mat,
}
off = {}
for writer, six in written.items():
    read = {reader: Rotation.from_matrix(to_matrix(np.asarray(six))) for reader, to_matrix in readers.items()}
    off[writer] = {reader: round(np.degrees((each * turn.inv()).magnitude())) for reader, each in read.items()}
    print(f"{writer:27}", np.round(six, 2).tolist(), off[writer])
columns, rows = list(readers)[:4], list(readers)[4:]
for writer in readers:
    same = columns if writer in columns else rows
    assert all(off[writer][reader] == (0 if reader in same else 45) for reader in readers), off
assert set(off["mcap-data-loader, relative"].values()) == {79, 56}, off
PYTHON
