#!/usr/bin/env bash
# A legged robot, turned to the left by 90 degrees, walks straight ahead at 1 m/s and tips forward at 0.5 rad/s: in ROS' Odometry, whose twist is in the
# frame of the robot, (1, 0, 0) and (0, 0.5, 0). Its base has six velocities in simulators and libraries of dynamics, too. Which?
# Guess: the same six, or all six in the frame of the world, and the position of its base with the quaternion in one order.
# Seen with pin (Pinocchio) 4.1.0 and mujoco 4.0.0 on 2026-11-29, for a free joint:
#   pin      (1, 0, 0), (0, 0.5, 0): both in the frame of the robot; position, then x, y, z, w
#   mujoco   (0, 1, 0), (0, 0.5, 0): linear in the world, ANGULAR in the frame of the robot; position, then w, x, y, z
# So a state of seven and six numbers, which fits both, walks sideways in the other; and a robot that stands as it was put (not turned), as most
# first tests do, shows no difference in velocities. The sensors `framelinvel` and `frameangvel` of mujoco are both in the world, and
# `mj_objectVelocity` and `cvel` have the rotation first.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pin==4.1.0 mujoco==4.0.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import mujoco
import numpy as np
import pinocchio

HALF, STEP_S = np.sqrt(0.5), 1e-6
LINEAR_MPS, ANGULAR_RADPS = np.array([1.0, 0, 0]), np.array([0, 0.5, 0])  # in the frame of the robot, as in ROS
ROBOT = """
<mujoco><option gravity="0 0 0" timestep="1e-6"/>
  <worldbody><body name="base"><freejoint/><geom type="box" size="0.3 0.2 0.1" mass="20"/></body></worldbody>
  <sensor><framelinvel objtype="body" objname="base"/><frameangvel objtype="body" objname="base"/></sensor></mujoco>"""
world_R_robot = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])

model = mujoco.MjModel.from_xml_string(ROBOT)
data = mujoco.MjData(model)
data.qpos[:] = [1, 2, 3, HALF, 0, 0, HALF]
data.qvel[:] = [*world_R_robot @ LINEAR_MPS, *ANGULAR_RADPS]
mujoco.mj_forward(model, data)
assert np.allclose(data.xmat[1].reshape(3, 3), world_R_robot)
sensors, spatial = data.sensordata.copy(), data.cvel[1].copy()
mujoco.mj_step(model, data)
moved = {"mujoco": (data.qpos[:3] - [1, 2, 3]) / STEP_S}
turned = world_R_robot.T @ data.xmat[1].reshape(3, 3)
assert np.allclose(sensors, [*world_R_robot @ LINEAR_MPS, *world_R_robot @ ANGULAR_RADPS])
assert np.allclose(spatial, [*world_R_robot @ ANGULAR_RADPS, *world_R_robot @ LINEAR_MPS])

free = pinocchio.Model()
free.addJoint(0, pinocchio.JointModelFreeFlyer(), pinocchio.SE3.Identity(), "base")
there = pinocchio.integrate(free, np.array([1, 2, 3, 0, 0, HALF, HALF]), np.array([*LINEAR_MPS, *ANGULAR_RADPS]) * STEP_S)
moved["pin"] = (there[:3] - [1, 2, 3]) / STEP_S
mixed = pinocchio.integrate(free, np.array([1, 2, 3, 0, 0, HALF, HALF]), np.array([*world_R_robot @ LINEAR_MPS, *ANGULAR_RADPS]) * STEP_S)
moved["pin, with mujoco's numbers"] = (mixed[:3] - [1, 2, 3]) / STEP_S
for name, speed in moved.items():
    print(f"{name}: {np.round(speed, 3).tolist()} m/s in the world")
mujoco.mj_kinematics(model, data)
assert np.allclose(moved["mujoco"], [0, 1, 0], atol=1e-3) and np.allclose(moved["pin"], [0, 1, 0], atol=1e-3)
assert np.allclose(moved["pin, with mujoco's numbers"], [-1, 0, 0], atol=1e-3)
PYTHON
