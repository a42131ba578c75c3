"""Intrinsics of cameras for `calibration.json`: from CameraInfo, from a calibration file or from the recipe.

The second camera of a stereo pair has Tx = -fx * baseline in P (sensor_msgs/CameraInfo), which projects points
given in the frame of the *first* camera. There is no agreement on what `frame_id` means: image_geometry and
stereo_image_proc want the first camera's frame in both messages, while many drivers give each camera the frame
of its own centre, with the baseline in TF. So the baseline is added to the extrinsics only if another camera, whose
Tx is 0, is in the same frame: two cameras cannot be in the same place.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import acos, degrees, hypot

import numpy as np

from bagassets.assets.calibration_files import FileContent, intrinsics_in
from bagassets.assets.channel import Counts
from bagassets.assets.sensors import CameraInfo, Lens, RecordedSensor
from bagassets.base.errors import CalibrationError, DecodeError
from bagassets.base.quantities import utc_text
from bagassets.decode.camera_info import CameraInfoReading, check_lens
from bagassets.decode.loading import own_decoder
from bagassets.geometry.calibration import CalibratedCamera, CameraCalibration
from bagassets.geometry.se3 import SE3, quaternion_from_rotation
from bagassets.recipe.model_calibration import Intrinsics, IntrinsicsFile
from bagassets.recordings.recording import Recording

# A smaller rotation between the camera and its rectified image is not noted.
NOTED_DEG = 0.01
# R, written with few digits, may be off a rotation by this much.
ROTATION_ERROR = 1e-3
# A shorter baseline in P is a rounding error.
LEAST_BASELINE_M = 1e-5
WITHOUT_INTRINSICS = "; its images have no intrinsics."
"""How a note ends on a camera whose CameraInfo cannot be used."""


def camera_intrinsics(
    name: str,
    camera: RecordedSensor,
    lens: Lens,
    recording: Recording,
    files: Mapping[str, FileContent],
    notes: list[str],
) -> tuple[CalibratedCamera | None, SE3]:
    """Return the entry `camera` of a channel in `calibration.json`, and `frame_SE3_image`.

    The latter is the pose of the image's centre and axes in the camera's frame: identity, except for images that were
    rectified by a rotation R before they were recorded, and for the second camera of a stereo pair that has the
    frame of the first.

    Args:
        name: the channel.
        camera: its sensor.
        lens: settings of the lens in the recipe.
        recording: has its CameraInfo topic.
        files: name -> content of calibration files.
        notes: gets sentences on what is unusual.

    Raises:
        CalibrationError: the camera needs intrinsics and has none, or they are implausible.
    """
    if isinstance(lens.intrinsics, IntrinsicsFile):
        calibration, has_projection = intrinsics_in(name, lens.intrinsics, camera.sensor.topic, files)
        # Without P, a file knows of one image only, and that is the recorded one.
        rectified = lens.rectified and has_projection
        source = lens.intrinsics.file.as_posix()
        return _calibrated(name, camera, _Found(calibration, source, source, rectified), recording, notes)
    if lens.intrinsics is not None:
        return _by_hand(name, lens.intrinsics), SE3()
    if lens.recorded is None:
        return None, SE3()
    return _from_messages(name, camera, lens.recorded, recording, notes, needed=lens.undistort)


def _from_messages(
    name: str,
    camera: RecordedSensor,
    info: CameraInfo,
    recording: Recording,
    notes: list[str],
    *,
    needed: bool,
) -> tuple[CalibratedCamera | None, SE3]:
    topic = info.camera_info
    if topic not in recording.topics:
        if not needed:
            return None, SE3()
        raise CalibrationError(
            f"{name} ({camera.sensor.topic}): no CameraInfo on {topic}, which undistortion needs; name the topic in "
            "`camera_info`, give `intrinsics`, or set `undistort: false` in the recipe."
        )
    reading, lost = _one_calibration(name, topic, recording, rectified=info.rectified)
    if reading is None:
        problem = f"{name}: no usable CameraInfo on {topic}{_reasons(lost)}"
        if needed:
            raise CalibrationError(f"{problem}; give `intrinsics` or set `undistort: false`.")
        notes.append(f"{problem}{WITHOUT_INTRINSICS}")
        return None, SE3()
    if lost:
        notes.append(f"{name}: {sum(lost.values())} messages on {topic} cannot be used{_reasons(lost)}.")
    place, rectified = f"the CameraInfo on {topic}", info.rectified or reading.rectified
    if rectified and not info.rectified:
        notes.append(f"{name}: K in {place} is zero, so its images are taken for rectified: P and R hold.")
    found = _Found(reading.calibration, place, "camera_info", rectified)
    return _calibrated(name, camera, found, recording, notes)


@dataclass(frozen=True)
class _Found:
    """A calibration, and where it is from.

    Attributes:
        calibration: as a CameraInfo has it.
        place: where it is from, in messages.
        source: the same in `calibration.json`.
        rectified: True if the recorded images are rectified.
    """

    calibration: CameraCalibration
    place: str
    source: str
    rectified: bool


def _calibrated(
    name: str, camera: RecordedSensor, found: _Found, recording: Recording, notes: list[str]
) -> tuple[CalibratedCamera, SE3]:
    """Return the camera of the recorded images, and `frame_SE3_image`."""
    calibration = found.calibration
    numbers = {name: _all_rounded(getattr(calibration, name)) for name in "kdrp"}
    known = CalibratedCamera(**vars(calibration) | numbers, source=found.source)
    first = _first_of_pair(name, camera, calibration, recording, notes, rectified=found.rectified)
    if not found.rectified:
        return known, SE3()
    if first is None:
        return _of_rectified(name, found.place, known, calibration), _turn(name, calibration, notes)
    # The frame is that of the first camera, and so is the turn from it to the axes that both images share.
    frame_SE3_image = _turn(name, first, notes) @ SE3.create((1.0, 0.0, 0.0, 0.0), _beside_m(calibration))
    return _of_rectified(name, found.place, known, calibration), frame_SE3_image


def _beside_m(calibration: CameraCalibration) -> tuple[float, float, float]:
    """Return where P has the centre of a camera, in the rectified axes of the first one of its stereo pair."""
    p = calibration.p
    return (-p[3] / p[0] if p[0] else 0.0, -p[7] / p[5] if p[5] else 0.0, 0.0)


def _first_of_pair(
    name: str,
    camera: RecordedSensor,
    calibration: CameraCalibration,
    recording: Recording,
    notes: list[str],
    *,
    rectified: bool,
) -> CameraCalibration | None:
    """Return the calibration of the first camera of a stereo pair if this is the second, in the frame of the first."""
    baseline_m = hypot(*_beside_m(calibration))
    if baseline_m < LEAST_BASELINE_M:
        return None
    sentence = f"{name}: P puts its centre {baseline_m:.4g} m beside the first camera of a stereo pair"
    for topic in camera.same_frame or ():
        try:
            reading, _ = _one_calibration(name, topic, recording, rectified=True)
        except CalibrationError:
            continue
        if reading is None or hypot(*_beside_m(reading.calibration)) >= LEAST_BASELINE_M:
            continue
        if rectified:
            notes.append(
                f"{sentence}, whose frame {camera.frame} it names ({topic}); its extrinsics include that."
            )
            return reading.calibration
        notes.append(
            f"{sentence}, whose frame {camera.frame} it names ({topic}); its extrinsics do not include that, as its "
            "images are not rectified. Give it a `frame` or `extrinsics` of its own."
        )
        return None
    if rectified:
        what = (
            "the extrinsics in the recipe are" if camera.sensor.extrinsics else f"its frame {camera.frame} is"
        )
        notes.append(f"{sentence}; {what} taken for its own centre, so nothing is added.")
    return None


def _of_rectified(
    name: str, place: str, camera: CalibratedCamera, calibration: CameraCalibration
) -> CalibratedCamera:
    """Return the camera of rectified images: P replaces K and D."""
    p = calibration.p
    if not (p[0] > 0 and p[5] > 0):
        raise CalibrationError(
            f"{name}: its images are rectified, but P in {place} has no focal length; give "
            "`intrinsics`, or set `rectified: false` in the recipe if they are not."
        )
    k = _all_rounded((p[0], 0.0, p[2], 0.0, p[5], p[6], 0.0, 0.0, 1.0))
    return replace(camera, model="none", k=k, d=())


def _turn(name: str, calibration: CameraCalibration, notes: list[str]) -> SE3:
    """Return `frame_SE3_image`: R turns vectors from the camera's axes to those of the rectified image."""
    image_R_frame = np.array(calibration.r).reshape(3, 3)
    x, y, z = image_R_frame
    # Rows of a rotation: two of length 1 at right angles, and the third is their product.
    off = [(x * x).sum() - 1.0, (y * y).sum() - 1.0, (x * y).sum(), *(np.cross(x, y) - z)]
    if np.abs(off).max() > ROTATION_ERROR:
        raise CalibrationError(
            f"{name}: its images are rectified, but R of their CameraInfo is no rotation; give `intrinsics` in the recipe."
        )
    frame_SE3_image = SE3.create(quaternion_from_rotation(image_R_frame.T), (0.0, 0.0, 0.0))
    turned_deg = degrees(2 * acos(min(1.0, abs(frame_SE3_image.rotation[0]))))
    if turned_deg > NOTED_DEG:
        notes.append(
            f"{name}: its images are rectified by a turn of {turned_deg:.2f} degrees, which its extrinsics include."
        )
    return frame_SE3_image


def _one_calibration(
    name: str, topic: str, recording: Recording, *, rectified: bool
) -> tuple[CameraInfoReading | None, dict[str, int]]:
    """Return the calibration that all messages of `topic` share, and why other messages cannot be used."""
    first: CameraInfoReading | None = None
    repeated: bytes | None = None
    counts = Counts()
    for message in recording.messages([topic]):
        content = recording.topics[topic].unstamped(message.data)
        if content is not None and content == repeated:
            continue  # most cameras send the same with each image, and decoding it takes a tenth of a millisecond
        try:
            reading: CameraInfoReading = own_decoder("camera_info", message.msgtype)(
                recording.decode(message)
            )
        except DecodeError as err:
            counts.lose(str(err))
            continue
        if first is None:
            first, repeated = reading, content
            continue
        now, then = reading.calibration, first.calibration
        if now.lens != then.lens or ((rectified or first.rectified) and (now.r, now.p) != (then.r, then.p)):
            raise CalibrationError(
                f"{name}: the calibration on {topic} changes at {utc_text(reading.stamp_ns)}; one recording has "
                "one calibration. Split the recording there, or give `intrinsics` in the recipe."
            )
    return first, counts.lost


def _reasons(lost: Mapping[str, int]) -> str:
    return ": " + "; ".join(lost) if lost else ""


def _by_hand(name: str, given: Intrinsics) -> CalibratedCamera:
    k = (given.fx, 0.0, given.cx, 0.0, given.fy, given.cy, 0.0, 0.0, 1.0)
    model: str = given.model
    d = tuple(given.distortion)
    if not d:  # without coefficients, an equidistant lens still distorts
        model, d = ("equidistant", (0.0,) * 4) if model == "equidistant" else ("none", ())
    try:
        check_lens(model, given.width, given.height, k, d)
    except DecodeError as err:
        raise CalibrationError(f"{name}: intrinsics in the recipe: {err}.") from err
    return CalibratedCamera(
        **vars(CameraCalibration.of_lens(model, given.width, given.height, k, d)), source="recipe"
    )


def _all_rounded(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(rounded(value) for value in values)


def rounded(value: float) -> float:
    """Round to 12 significant digits, which hides the last bits of composed transforms."""
    return float(f"{value:.12g}") + 0.0
