"""What the fields of radar data mean, by their names.

Radars and their drivers agree on no message. What is read is therefore found by name: fields of
a cloud (`vx_comp`), or members of a message in dotted form (`position.x`), without regard to case.
Positions come as x, y, z or as range, azimuth, elevation; velocities as vx, vy or as the radial
(Doppler) speed, positive when the target moves away, which is laid along the line of sight.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Literal

import numpy as np

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import Column
from bagassets.decode.model import RadarReading
from bagassets.geometry.portable import sin_cos
from bagassets.geometry.se3 import Floats

Side = Literal["left", "right"]

# In messages of objects the position may lie in a pose.
_POSES = ("", "position.", "pose.position.", "pose.pose.position.", "centroid.", "track_shape.centroid.")
_BOXES = ("object_box_center.pose.position.", "bounding_box_center.position.", "kinematics.position.")
_TWISTS = ("velocity.", "linear_velocity.", "velocity.twist.linear.", "twist.linear.", "twist.twist.linear.")


def _position(axis: str, *names: str) -> tuple[str, ...]:
    return (*(prefix + axis for prefix in (*_POSES, *_BOXES)), *names)


def _velocity(axis: str, *names: str) -> tuple[str, ...]:
    return (*(prefix + axis for prefix in ("v", "v_", "vel_", "velocity_", *_TWISTS)), *names)


_X = _position("x", "pos_x", "position_x", "x_distance", "dist_long", "long_dist", "longitude_dist")
_Y = _position("y", "pos_y", "position_y", "y_distance", "dist_lat", "lat_dist", "lateral_dist")
_Z = _position("z", "pos_z", "position_z")
_RANGE = ("range", "distance", "rng", "r", "track_range", "can_tx_detect_range", "radial_distance")
_AZIMUTH = ("azimuth", "azimuth_angle", "az", "angle", "azimuth_deg", "track_angle", "can_tx_detect_angle")
_ELEVATION = ("elevation", "elevation_angle", "el", "elevation_deg")
_RADIAL = (
    "doppler",
    "doppler_velocity",
    "range_rate",
    "radial_velocity",
    "radial_speed",
    "vrad",
    "v_r",
    "vr",
    "velocity",
    "speed",
    "rate",
    "track_range_rate",
    "can_tx_detect_range_rate",
)
_RADIAL_COMP = ("v_r_comp", "vr_comp", "doppler_comp", "radial_velocity_comp", "v_r_compensated", "vrad_comp")
_VX = _velocity("x", "vrel_long", "x_velocity", "longitude_vel")
_VY = _velocity("y", "vrel_lat", "y_velocity", "lateral_vel")
_RCS = ("rcs", "radar_cross_section", "amplitude", "power", "intensity", "snr", "can_tx_detect_amplitude")

TRACK_NUMBERS = ("id", "track_id", "object_id", "target_id", "detection_id", "cluster_id", "objid", "uuid")

_NAMED_ALIKE = ("is_quality_valid", "x_rms", "y_rms", "invalid_state", "pdh0", "vx_rms", "vy_rms")
# Field of the nuScenes format -> names it is recorded under, taken as they are.
_AS_RECORDED: dict[str, tuple[str, ...]] = {
    "rcs": _RCS,
    "id": TRACK_NUMBERS,
    "vx_comp": ("vx_comp", "vx_compensated", "v_x_comp"),
    "vy_comp": ("vy_comp", "vy_compensated", "v_y_comp"),
    "dyn_prop": ("dyn_prop", "dynprop", "dynamic_property"),
    "ambig_state": ("ambig_state", "ambiguity_state"),
    **{name: (name,) for name in _NAMED_ALIKE},
}

# Names of angles that count degrees; all others count radians (REP 103).
_DEGREES = {"angle", "track_angle", "can_tx_detect_angle"}


@dataclass(frozen=True)
class _Columns:
    """Columns of equal length, found by the first of several names."""

    columns: Mapping[str, Column]

    def find(self, names: tuple[str, ...]) -> Floats | None:
        name = self.name(names)
        return None if name is None else np.asarray(self.columns[name], dtype=np.float64).reshape(-1)

    def name(self, names: tuple[str, ...]) -> str | None:
        return next((name for name in names if name in self.columns), None)

    def angle(self, names: tuple[str, ...]) -> Floats | None:
        """Return an angle in radians."""
        name, values = self.name(names), self.find(names)
        if name is None or values is None:
            return None
        return values * (pi / 180.0) if name in _DEGREES or name.endswith("_deg") else values


def radar_reading(stamp_ns: int, frame_id: str, fields: Mapping[str, Column], side: Side) -> RadarReading:
    """Return the targets whose fields have the given names and values.

    Targets that are not finite are dropped and counted, and so are those at no distance at all:
    drivers fill arrays of fixed length with them.

    Args:
        stamp_ns: time of the targets.
        frame_id: radar frame.
        fields: name in lower case, dotted for members of members -> (N,) values.
        side: to which side azimuths are positive, seen from above.

    Raises:
        DecodeError: the fields give no position.
    """
    columns = _Columns(fields)
    x, y, z = _cartesian(columns, side)
    targets = {"x": x, "y": y, "z": z}
    for name, aliases in _AS_RECORDED.items():
        values = columns.find(aliases)
        if values is not None:
            targets[name] = values
    distance = np.sqrt(x * x + y * y + z * z)
    with np.errstate(invalid="ignore", divide="ignore"):
        toward_x, toward_y = x / distance, y / distance
        vx, vy = columns.find(_VX), columns.find(_VY)
        radial = columns.find(_RADIAL)
        if vx is not None:
            targets["vx"], targets["vy"] = vx, np.zeros_like(vx) if vy is None else vy
        elif radial is not None:
            targets["vx"], targets["vy"] = radial * toward_x, radial * toward_y
        radial_comp = columns.find(_RADIAL_COMP)
        if "vx_comp" not in targets and radial_comp is not None:
            targets["vx_comp"], targets["vy_comp"] = radial_comp * toward_x, radial_comp * toward_y
        keep = np.isfinite(distance) & (distance > 0.0)
    kept = {name: values[keep] for name, values in targets.items()}
    dropped = len(x) - int(keep.sum())
    return RadarReading(stamp_ns, frame_id, kept, dropped, radial=vx is None and radial is not None)


def _cartesian(columns: _Columns, side: Side) -> tuple[Floats, Floats, Floats]:
    x, y, z = columns.find(_X), columns.find(_Y), columns.find(_Z)
    if x is not None and y is not None:
        return x, y, np.zeros_like(x) if z is None else z
    distance, azimuth = columns.find(_RANGE), columns.angle(_AZIMUTH)
    if distance is None or azimuth is None:
        raise DecodeError("it has neither x and y, nor range and azimuth")
    elevation = columns.angle(_ELEVATION)
    with np.errstate(invalid="ignore"):
        sin_azimuth, cos_azimuth = sin_cos(azimuth if side == "left" else -azimuth)
        if elevation is None:
            return distance * cos_azimuth, distance * sin_azimuth, np.zeros_like(distance)
        sin_elevation, cos_elevation = sin_cos(elevation)
    ground = distance * cos_elevation
    return ground * cos_azimuth, ground * sin_azimuth, distance * sin_elevation
