"""What the web UI says about each asset of a recording."""

__all__ = ["DESCRIPTIONS", "KINDS"]

DESCRIPTIONS = {
    "bag": """A recording: a ROS 1 bag, a ROS 2 bag or an MCAP file.

Its data version is the digest of its content, each file hashed once. One that was only touched stays what it was.""",
    "inventory": """What is in the recording: topics, types, counts, rates, gaps, offsets between clocks, the place, day or night.

Has a digest of each topic, so that later steps depend on just the topics that they read, and packs the small messages
for them: `inventory.json`, `messages.parquet`.""",
    "calibration": """Where each sensor sits on the vehicle, and the lens of each camera.

Extrinsics `ego <- sensor` are resolved from TF, a URDF file or the recipe; intrinsics and distortion come from CameraInfo or
the recipe: `calibration.json`.""",
    "ego_poses": """Where the vehicle was, over time, in local metres.

From odometry, poses, TF, GNSS with IMU, or fixed; the origin in the world is kept where it is known:
`ego_poses.parquet`.""",
    "annotations": """3-D boxes with track ids, in the frame of the ego poses.

From topics of the recording or files beside it: `annotations.parquet`.""",
    "frames": """The camera images: undistorted and encoded as the recipe says, indexed by stamp.

One artifact per camera, so that a change to one leaves the others alone. Each image is extracted once, whether or not it
becomes a keyframe.""",
    "sweeps": """The lidar revolutions and radar scans as files of points, indexed by stamp.

One artifact per sensor: `.pcd.bin` for lidar, deskewed if the recipe says so, and `.pcd` for radar.""",
    "nuscenes_tables": """This recording's rows of the nuScenes tables: scenes, keyframes, readings, poses, boxes.

Keyframe rate, scene length and tolerance act here; changing them extracts nothing anew.""",
    "vision_sequences": "This recording's part of the vision dataset: image sequences with relative trajectories.",
    "preview": "Pictures of the recording for people; the small ones are shown with each materialization.",
}

KINDS = {
    "bag": {"ros", "file"},
    "inventory": {"json", "parquet"},
    "calibration": {"json"},
    "ego_poses": {"parquet"},
    "annotations": {"parquet"},
    "frames": {"image", "parquet"},
    "sweeps": {"pointcloud", "parquet"},
    "nuscenes_tables": {"nuscenes", "json"},
    "vision_sequences": {"image", "json"},
    "preview": {"image"},
}
