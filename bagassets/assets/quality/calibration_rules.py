"""Rules about calibration: sensors are on the vehicle, and cameras have plausible lenses and directions."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import asin, atan, degrees, isfinite, sqrt

from bagassets.assets.intrinsics import WITHOUT_INTRINSICS
from bagassets.assets.quality.finding import Finding
from bagassets.geometry.calibration import UNPLACED, CalibratedSensor, Calibration, RegionOfInterest
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.se3 import SE3
from bagassets.recipe.model import Rig
from bagassets.recipe.model_checks import CalibrationCheck

STEPS = 200


def calibration_plausible(calibration: Calibration, rig: Rig, check: CalibrationCheck) -> Finding:
    """Check extrinsics and intrinsics.

    Args:
        calibration: content of `calibration.json`.
        rig: says which channels are cameras.
        check: thresholds.
    """
    problems = []
    facts = {}
    channels = {
        name: sensor for name, sensor in sorted(calibration.channels.items()) if sensor.source != UNPLACED
    }
    for name, sensor in channels.items():
        ego_SE3_sensor = sensor.ego_SE3_sensor.normalised()
        is_camera = name in rig.channels and rig.channels[name].modality == "camera"
        problems += [f"{name}: {text}" for text in _extrinsics(ego_SE3_sensor, is_camera, check)]
        if sensor.camera is not None:
            lens = sensor.camera
            # Of the whole image, because a region of interest may be off centre.
            whole = RegionOfInterest(0, 0, lens.width, lens.height, do_rectify=False)
            camera = CameraModel.from_calibration(replace(lens, roi=whole, binning=(1, 1)))
            problems += [f"{name}: {text}" for text in _intrinsics(camera, check)]
            facts[name] = {"view_deg": round(_view_deg(camera), 1)}
        elif is_camera:
            unusable = (
                note.removeprefix(f"{name}: ").removesuffix(WITHOUT_INTRINSICS)
                for note in calibration.notes
                if note.startswith(f"{name}: ") and note.endswith(WITHOUT_INTRINSICS)
            )
            why = next((f"{note};" for note in unusable), "record its CameraInfo, or")
            problems.append(
                f"{name}: has no intrinsics, so nothing can be projected into its images; {why} give `intrinsics` in the recipe"
            )
    return Finding([*problems, *_copies(channels, rig)], {"sensors": len(channels), "cameras": facts})


def _extrinsics(ego_SE3_sensor: SE3, is_camera: bool, check: CalibrationCheck) -> Iterator[str]:
    distance_m = sqrt(sum(value * value for value in ego_SE3_sensor.translation))
    if distance_m > check.max_distance_m:
        yield (
            f"is {distance_m:.2f} m from the ego frame, at most {check.max_distance_m:g} m expected; "
            "check units and direction of the extrinsics"
        )
    if not is_camera:
        return
    _, x, y, _ = ego_SE3_sensor.rotation
    # Third row of the third column: the upward component of the optical axis z in the ego frame.
    up = max(-1.0, min(1.0, 1 - 2 * (x * x + y * y)))
    tilt_deg = degrees(asin(up))
    if abs(tilt_deg) > check.max_tilt_deg:
        yield (
            f"looks {abs(tilt_deg):.0f} degrees {'up' if tilt_deg > 0 else 'down'}, at most "
            f"{check.max_tilt_deg:g} expected; its frame is probably not the optical one (z forward, y down); if it "
            "does look there, raise checks.calibration_plausible.max_tilt_deg"
        )


def _intrinsics(camera: CameraModel, check: CalibrationCheck) -> Iterator[str]:
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    if not all(isfinite(value) for value in numbers) or min(camera.fx, camera.fy) <= 0:
        yield f"focal lengths {camera.fx:g} and {camera.fy:g} are impossible for a lens"
        return
    view_deg = _view_deg(camera)
    if not check.min_view_deg <= view_deg <= check.max_view_deg:
        yield (
            f"fx {camera.fx:g} at {camera.width} pixels means a field of view of {view_deg:.1f} degrees, "
            f"{check.min_view_deg:g} to {check.max_view_deg:g} expected"
        )
    aspect = max(camera.fx / camera.fy, camera.fy / camera.fx)
    if aspect > check.max_aspect:
        yield f"fx {camera.fx:g} and fy {camera.fy:g} differ by a factor of {aspect:.2f}, at most {check.max_aspect:g} expected"
    for axis, center, size in (("cx", camera.cx, camera.width), ("cy", camera.cy, camera.height)):
        offset = abs(center - (size - 1) / 2) / size
        if offset > check.max_offset:
            yield (
                f"{axis} {center:g} is {offset:.0%} of {size} pixels off the image centre, "
                f"at most {check.max_offset:.0%} expected"
            )
    folded = _folds_at(camera)
    if folded is not None:
        yield f"distortion folds the image at {folded:.0%} of the distance to its corner; the coefficients belong to another model or image"


def _view_deg(camera: CameraModel) -> float:
    """Return the horizontal field of view, with the lens's angles for a fisheye and a pinhole's for others."""
    if camera.fx <= 0:
        return 0.0
    left, right = (camera.cx + 0.5) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
    if camera.model == "equidistant":
        return degrees(left + right)
    return degrees(atan(left) + atan(right))


def _folds_at(camera: CameraModel) -> float | None:
    """Return where from the centre (0) to the corner (1) the distorted radius stops growing; None if it never does.

    Tangential terms are ignored: they are small if the radial ones are plausible.
    """
    if not camera.distorts:
        return None
    dx = max(camera.cx, camera.width - 1 - camera.cx) / camera.fx
    dy = max(camera.cy, camera.height - 1 - camera.cy) / camera.fy
    corner = sqrt(dx * dx + dy * dy)
    before = 0.0
    # The distorted radius must reach the corner; undistorted ones grow without bound for a wide lens.
    for step in range(1, STEPS * 20):
        radius = corner * step / STEPS
        now = _distorted(camera, radius)
        if now >= corner:
            return None
        if now <= before:
            return before / corner
        before = now
    return None


def _distorted(camera: CameraModel, radius: float) -> float:
    """Return the radius in the recorded image of a ray at `radius` in a pinhole image, both for focal length 1."""
    if camera.model == "equidistant":
        k1, k2, k3, k4 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
        theta = atan(radius)
        t2 = theta * theta
        return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    k1, k2, _, _, k3, k4, k5, k6 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:8]
    r2 = radius * radius
    return radius * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / max(1 + r2 * (k4 + r2 * (k5 + r2 * k6)), 1e-9)


def _copies(channels: Mapping[str, CalibratedSensor], rig: Rig) -> Iterator[str]:
    """Find sensors of one modality with the same pose although their frames differ."""
    seen: dict[tuple[str, SE3], str] = {}
    for name, sensor in channels.items():
        if name not in rig.channels:
            continue
        first = seen.setdefault((rig.channels[name].modality, sensor.ego_SE3_sensor), name)
        if first != name and channels[first].frame != sensor.frame:
            yield f"{name}: has the same extrinsics as {first}; one of them was probably copied"
