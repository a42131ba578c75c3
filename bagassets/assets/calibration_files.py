"""Calibration files that a recipe names, for `calibration`: their names and contents in an action, and what they say.

An action knows a file by its content's digest and by as much of its path as tells it from others, so that a project that is
moved stays as fresh as it is.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from bagassets.assets.asset import Facts
from bagassets.base.errors import CalibrationError, DecodeError
from bagassets.decode.camera_info import check_lens, named_distortion
from bagassets.geometry.calibration import CameraCalibration
from bagassets.geometry.calibration_files.model import FilePose
from bagassets.geometry.calibration_files.read import MOST_BYTES, read_calibration_file
from bagassets.recipe.model_calibration import ExtrinsicsFile, IntrinsicsFile


@dataclass(frozen=True)
class FileContent:
    """A calibration file.

    Attributes:
        path: where it is, for messages.
        data: its content.
    """

    path: Path
    data: bytes


def short_names(paths: Collection[Path]) -> dict[Path, str]:
    """Return path -> its last parts, as many as tell it from the others, with `/` between them."""
    names = {}
    for path in paths:
        others = [other.parts for other in paths if other != path]
        parts = path.parts
        length = 1
        while length < len(parts) and any(other[-length:] == parts[-length:] for other in others):
            length += 1
        names[path] = PurePosixPath(*parts[-length:]).as_posix()
    return names


def read_file(path: Path, facts: Facts) -> FileContent:
    """Return the content of a calibration file.

    Raises:
        CalibrationError: it cannot be read, or is too large for a calibration file.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise CalibrationError(
                f"{path}: {path.stat().st_size} bytes are too many for a calibration file; name another file."
            )
        return FileContent(path, facts.file(path))
    except OSError as err:
        raise CalibrationError(
            f"{path}: the calibration file cannot be read ({err.strerror}); correct `file` in the recipe, or put it there."
        ) from err


def intrinsics_in(
    channel: str, given: IntrinsicsFile, topic: str, files: Mapping[str, FileContent]
) -> tuple[CameraCalibration, bool]:
    """Return the intrinsics that a file has for a channel, and whether it has P, which describes rectified images.

    They are as a CameraInfo would have them; P is K without a baseline if the file has none.

    Args:
        channel: its name, for messages.
        given: names the file as `files` does, and the camera.
        topic: topic of the channel.
        files: name -> content.

    Raises:
        CalibrationError: the file has none, or they are implausible.
    """
    file = files[given.file.as_posix()]
    try:
        source = read_calibration_file(file.data, str(file.path))
        camera = source.choose(given.camera, topic)
        lens = source.lens(camera, given.model)
    except CalibrationError as err:
        raise CalibrationError(f"{channel}: {err}") from err
    try:
        model, d = named_distortion(lens.model, lens.d)
        check_lens(model, lens.width, lens.height, lens.k, d)
    except DecodeError as err:
        which = f" of {camera}" if camera else ""
        raise CalibrationError(
            f"{channel}: {file.path}: the intrinsics{which} cannot be used: {err}; correct the file or name another one."
        ) from err
    calibration = CameraCalibration.of_lens(model, lens.width, lens.height, lens.k, d)
    if lens.r is not None and any(lens.r):
        calibration = replace(calibration, r=lens.r)
    if lens.p is not None:
        calibration = replace(calibration, p=lens.p)
    return calibration, lens.p is not None


def pose_in(channel: str, given: ExtrinsicsFile, topic: str, files: Mapping[str, FileContent]) -> FilePose:
    """Return the pose that a file has for a channel.

    Args:
        channel: its name, for messages.
        given: names the file as `files` does, the camera, and the frame that the pose is in.
        topic: topic of the channel.
        files: name -> content.

    Raises:
        CalibrationError: the file has none, or it is relative to a frame that is not named.
    """
    file = files[given.file.as_posix()]
    try:
        source = read_calibration_file(file.data, str(file.path))
        pose = source.pose(source.choose(given.camera, topic))
    except CalibrationError as err:
        raise CalibrationError(f"{channel}: {err}") from err
    if pose.is_sensor and given.relative_to is None:
        raise CalibrationError(
            f"{channel}: {file.path}: it places cameras relative to {pose.reference}, not to an IMU (no T_cam_imu); name the "
            f"frame of {pose.reference} in `relative_to` of `extrinsics`."
        )
    return pose
