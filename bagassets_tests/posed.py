"""The asset `ego_poses`, made of a recording of a known motion."""

import json
import math

import numpy as np

from bagassets.assets import ego_poses
from bagassets.assets.asset import as_json
from bagassets.geometry.se3 import SE3
from bagassets.geometry.wgs84 import LocalFrame
from bagassets.recipe.model import Limits, Rig
from bagassets_tests.facts import MadeUpFacts, use_of
from bagassets_tests.pose_data import T0, TFMESSAGE, Recorded, S, Written, about_z, tf, transform

ORIGIN = LocalFrame(48.137, 11.575, 520.0)
TIMES = np.arange(0.0, 2.0, 0.02)
BETWEEN = np.arange(0.001, 1.96, 0.0137)
SPEED, TURN = 8.0, 0.3


def truth(t):
    """A circle at constant speed, nose along the path, climbing a little."""
    radius, angle = SPEED / TURN, TURN * t
    return SE3.create(about_z(angle), (radius * math.sin(angle), radius * (1 - math.cos(angle)), 0.05 * t))


def at(t):
    return T0 + round(t * S)


def rig(source, **fields):
    channels = {"LIDAR_TOP": {"modality": "lidar", "topic": "/points"}}
    return Rig.model_validate({"name": "car", "channels": channels, "ego_pose": source} | fields)


class Posed:
    """The asset, made of a recording."""

    def __init__(self, folder, source, *entries, clock="header", limits=None, urdf=None, **fields):
        self.recording = Recorded(*entries)
        if urdf is not None:
            fields["urdf"] = folder / "car.urdf"
            fields["urdf"].write_bytes(urdf)
        facts = MadeUpFacts(self.recording.inventory())
        use = use_of(
            ego_poses.EGO_POSES, rig(source, **fields), facts, clock=clock, limits=limits or Limits()
        )
        self.use = use
        json.dumps(as_json(use.params))
        view = Recorded(*entries) if entries else Recorded()
        self.view = view
        made = Written(folder / "out", lambda out: ego_poses.make_ego_poses(use.params, view, out))
        self.summary, self.digest, self.artifact = made.summary, made.digest, made.artifact
        self.json = made.artifact.read_json("ego_poses.json")
        self.table = made.artifact.read_table("ego_poses.parquet").to_pylist()
        self.trajectory = ego_poses.load_trajectory(made.artifact)
        assert set(view.read) <= set(use.topics)
        counts = self.json["counts"]
        assert counts["read"] == counts["written"] + counts["merged"] + sum(counts["lost"].values())

    def errors_m_rad(self, times, expected=truth):
        """Largest distance and angle from the truth."""
        positions, rotations, valid = self.trajectory.at(np.array([at(t) for t in times]))
        assert valid.all()
        metres, radians = 0.0, 0.0
        for t, position, rotation in zip(times, positions, rotations, strict=True):
            difference = expected(t).inverse() @ SE3.create(rotation, position)
            metres = max(metres, float(np.linalg.norm(difference.translation)))
            radians = max(radians, 2 * math.asin(min(1.0, float(np.linalg.norm(difference.rotation[1:])))))
        return metres, radians


def static(parent, child, value, stamp_ns=0):
    return "/tf_static", TFMESSAGE, T0 - S, tf(transform(stamp_ns, parent, child, value))
