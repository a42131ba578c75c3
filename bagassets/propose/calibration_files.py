"""Calibration files that lie beside recordings, and the cameras that they are of by their topics or names."""

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from bagassets.base.errors import CalibrationError
from bagassets.geometry.calibration_files.model import CalibrationFile
from bagassets.geometry.calibration_files.read import MOST_BYTES, read_calibration_file
from bagassets.propose.naming import sensor_of, tokens

_ENDINGS = (".yaml", ".yml")
_HINT = re.compile(rb"camera_matrix|camera_model")
_DEPTH = 3
# Folders of results may hold thousands of YAML files that do not concern us.
_MOST_FILES = 300


@dataclass(frozen=True)
class FoundCalibration:
    """A calibration file.

    Attributes:
        written: its path as a recipe should have it.
        path: where it is.
        content: its cameras.
    """

    written: str
    path: Path
    content: CalibrationFile


@dataclass(frozen=True)
class ProposedCalibration:
    """The calibration of one camera.

    Attributes:
        written: path of the file as a recipe should have it.
        reason: what tells that it is this camera's.
        relative_to: what the file places the camera relative to, as in `the IMU`; "" if it does not say where it is.
    """

    written: str
    reason: str
    relative_to: str = ""


def find_calibrations(root: Path, project: Path | None, *, nested: bool = True) -> list[FoundCalibration]:
    """Return the calibration files near recordings, in order of path.

    Args:
        root: folder of the recordings.
        project: folder of the recipe; paths inside it are written relative to it.
        nested: look into folders below, too, down to a few levels.
    """
    found = []
    for path in islice(_candidates(root, nested=nested), _MOST_FILES):
        try:
            if path.stat().st_size > MOST_BYTES:
                continue
            data = path.read_bytes()
            if not _HINT.search(data):  # parsing takes far longer than looking
                continue
            content = read_calibration_file(data, str(path))
        except (OSError, CalibrationError):
            continue  # some other YAML, such as the metadata of a ROS 2 bag
        written = path if project is None or not path.is_relative_to(project) else path.relative_to(project)
        found.append(FoundCalibration(str(written), path, content))
    return found


def _candidates(root: Path, *, nested: bool) -> Iterator[Path]:
    for folder, folders, files in os.walk(root):
        here = Path(folder)
        deep = len(here.relative_to(root).parts)
        folders[:] = sorted(name for name in folders if not name.startswith(".")) if nested else []
        if deep == _DEPTH:
            folders.clear()
        for name in sorted(files):
            if name.endswith(_ENDINGS) and name != "metadata.yaml" and not name.startswith("."):
                yield here / name


def calibration_of(topic: str, found: Sequence[FoundCalibration]) -> ProposedCalibration | None:
    """Return the calibration of the camera with a topic; None if no file is of it, or several are.

    Args:
        topic: its images.
        found: the files.
    """
    for rule in (_by_topic, _by_name):
        matches: list[ProposedCalibration] = []
        for one in found:
            with suppress(CalibrationError):
                matches += rule(topic, one)
        if matches:
            return matches[0] if len(matches) == 1 else None
    return None


def _by_topic(topic: str, one: FoundCalibration) -> Iterator[ProposedCalibration]:
    """Yield the calibration in a file that names the topic of its camera."""
    if any(one.content.topic(name) for name in one.content.cameras):
        camera = one.content.of_topic(topic)
        if camera is not None:
            one.content.lens(camera, None)  # fails if it cannot be used
            reference = ""
            with suppress(CalibrationError):
                reference = one.content.pose(camera).reference
            yield ProposedCalibration(one.written, f"its {camera} has this topic", reference)


def _by_name(topic: str, one: FoundCalibration) -> Iterator[ProposedCalibration]:
    """Yield the calibration of one camera whose name, or that of its file or the folder, is that of the topic."""
    own, names = _words(sensor_of(topic)), one.content.cameras
    if len(names) != 1 or one.content.topic(names[0]) or not own:
        return
    for name, what in (
        (names[0], f"it is of a camera {names[0]}"),
        (one.path.stem, "of its name"),
        (one.path.parent.name, "of the name of its folder"),
    ):
        if _words(name) == own:
            one.content.lens(names[0], None)
            yield ProposedCalibration(one.written, what)
            return


def _words(name: str) -> list[str]:
    """Return the words of a name, without those that only say that it is a camera's."""
    return [word for word in tokens(name) if word not in {"cam", "camera"}] or tokens(name)
