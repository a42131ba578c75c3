"""Calibration files as other tools write them, for cameras whose truth is known."""

import cv2
import numpy as np
import yaml

KALIBR = {"plumb_bob": "radtan", "equidistant": "equidistant", "none": "none"}


def _matrix(rows, cols, values):
    return {"rows": rows, "cols": cols, "data": [float(v) for v in values]}


def ros_fields(model, name="narrow_stereo", r=None, p=None):
    """What `camera_calibration` of ROS writes into `ost.yaml`."""
    k = model.matrix.reshape(-1)
    p = np.hstack([model.matrix, np.zeros((3, 1))]).reshape(-1) if p is None else p
    return {
        "image_width": model.width,
        "image_height": model.height,
        "camera_name": name,
        "camera_matrix": _matrix(3, 3, k),
        "distortion_model": model.model,
        "distortion_coefficients": _matrix(1, len(model.distortion), model.distortion),
        "rectification_matrix": _matrix(3, 3, np.eye(3).reshape(-1) if r is None else r),
        "projection_matrix": _matrix(3, 4, p),
    }


def ros(model, **fields):
    return yaml.safe_dump(ros_fields(model, **fields), sort_keys=False)


def opencv(model, path, **more):
    """Written by OpenCV itself."""
    storage = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    storage.write("image_width", model.width)
    storage.write("image_height", model.height)
    if model.model == "equidistant":
        storage.write("fisheye_model", 1)
    storage.write("camera_matrix", model.matrix)
    storage.write("distortion_coefficients", np.array(model.distortion).reshape(-1, 1))
    for name, value in more.items():
        storage.write(name, value)
    storage.release()
    return path.read_text()


def kalibr_camera(model, topic, imu=None, previous=None):
    """One camera of a chain; `imu` is `cam_SE3_imu`, `previous` is `cam_SE3_previous`."""
    fields = {
        "cam_overlaps": [],
        "camera_model": "pinhole",
        "distortion_coeffs": [float(v) for v in model.distortion[:4]],
        "distortion_model": KALIBR[model.model],
        "intrinsics": [model.fx, model.fy, model.cx, model.cy],
        "resolution": [model.width, model.height],
        "rostopic": topic,
    }
    if imu is not None:
        fields |= {"T_cam_imu": imu.matrix.tolist(), "timeshift_cam_imu": 0.0}
    if previous is not None:
        fields["T_cn_cnm1"] = previous.matrix.tolist()
    return fields


def camchain(*cameras):
    return yaml.safe_dump({f"cam{number}": camera for number, camera in enumerate(cameras)})


def kapture_sensors(**models):
    lines = [
        "# kapture format: 1.1",
        "# sensor_device_id, name, sensor_type, [sensor_params]+",
        "lidar0, , lidar",
    ]
    for name, (kind, numbers) in models.items():
        lines.append(f"{name}, , camera, {kind}, {', '.join(str(float(v)) for v in numbers)}")
    return "\n".join(lines) + "\n"


def kapture_rigs(rig, **sensors):
    """`sensors` are `sensor_SE3_rig`."""
    lines = ["# kapture format: 1.1", "# rig_device_id, sensor_device_id, qw, qx, qy, qz, tx, ty, tz"]
    for name, pose in sensors.items():
        lines.append(f"{rig}, {name}, {', '.join(repr(v) for v in (*pose.rotation, *pose.translation))}")
    return "\n".join(lines) + "\n"
