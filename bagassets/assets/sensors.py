"""The sensors of a rig for `calibration`: their topics, frames, extrinsics and lenses."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from bagassets.assets.asset import inlined, omitted
from bagassets.decode.registry import own_types
from bagassets.recipe.model import CameraChannel, Channel
from bagassets.recipe.model_base import Transform
from bagassets.recipe.model_calibration import CalibrationFile, ExtrinsicsFile, Intrinsics, IntrinsicsFile
from bagassets.recordings.inventory import Inventory

F = TypeVar("F", bound=CalibrationFile)


@dataclass(frozen=True)
class CameraInfo:
    """The source of recorded intrinsics.

    Attributes:
        camera_info: topic of CameraInfo messages.
        rectified: True if the recorded images are rectified.
    """

    camera_info: str
    rectified: bool


@dataclass(frozen=True)
class Lens:
    """The lens of a camera.

    Attributes:
        intrinsics: intrinsics in the recipe, the file that has them, or None.
        undistort: True if images are undistorted, which needs intrinsics.
        recorded: source of recorded intrinsics; None if the recipe has them.
        rectified: True if the recorded images are rectified and a file has the intrinsics.
    """

    intrinsics: Intrinsics | IntrinsicsFile | None
    undistort: bool
    recorded: CameraInfo | None = inlined()
    rectified: bool = omitted(default=False)

    @classmethod
    def of(cls, channel: CameraChannel) -> "Lens":
        """Return the lens of a channel in the recipe."""
        given, rectified = channel.intrinsics, is_rectified(channel)
        if given is None:
            return cls(None, channel.undistort, CameraInfo(camera_info_topic(channel), rectified))
        return cls(given, channel.undistort, None, rectified and isinstance(given, IntrinsicsFile))


@dataclass(frozen=True)
class Sensor:
    """The sensor of a channel.

    Attributes:
        topic: topic of its messages.
        modality: camera, lidar or radar.
        frame: its frame in the recipe; None to take it from the messages.
        extrinsics: `ego_SE3_sensor` in the recipe, or the file that has the pose.
        lens: the lens of a camera.
    """

    topic: str
    modality: str
    frame: str | None
    extrinsics: Transform | ExtrinsicsFile | None
    lens: Lens | None = inlined()

    @classmethod
    def of(cls, channel: Channel) -> "Sensor":
        """Return the sensor of a channel in the recipe."""
        lens = Lens.of(channel) if isinstance(channel, CameraChannel) else None
        return cls(channel.topic, channel.modality, channel.frame, channel.extrinsics, lens)

    @property
    def files(self) -> tuple[Path, ...]:
        """The calibration files that it needs."""
        named = (self.extrinsics, None if self.lens is None else self.lens.intrinsics)
        return tuple(one.file for one in named if isinstance(one, CalibrationFile))

    def with_files(self, names: Mapping[Path, str]) -> "Sensor":
        """Return it with files called by other names.

        Args:
            names: path -> name.
        """
        sensor = self
        if isinstance(sensor.extrinsics, ExtrinsicsFile):
            sensor = replace(sensor, extrinsics=_renamed(sensor.extrinsics, names))
        if sensor.lens is not None and isinstance(sensor.lens.intrinsics, IntrinsicsFile):
            lens = replace(sensor.lens, intrinsics=_renamed(sensor.lens.intrinsics, names))
            sensor = replace(sensor, lens=lens)
        return sensor

    def needs_transforms(self, ego_frame: str) -> bool:
        """Return whether TF or the URDF has a part in its pose."""
        if isinstance(self.extrinsics, ExtrinsicsFile):
            return self.extrinsics.relative_to not in {None, ego_frame}
        return self.extrinsics is None


def _renamed(given: F, names: Mapping[Path, str]) -> F:
    return given.model_copy(update={"file": Path(names[given.file])})


@dataclass(frozen=True)
class RecordedSensor:
    """A sensor with facts from its messages in a recording.

    Attributes:
        sensor: the sensor in the recipe.
        frame: its frame; empty if its messages name none.
        same_frame: for a camera with CameraInfo, other CameraInfo topics in the frame of the camera: if it is the
            second camera of a stereo pair, the first one may be among these.
    """

    sensor: Sensor = inlined()
    frame: str = ""
    same_frame: tuple[str, ...] | None = omitted()

    @classmethod
    def of(cls, sensor: Sensor, inventory: Inventory) -> "RecordedSensor":
        """Return a sensor with facts from the recording, which must have its topic."""
        frames = inventory.topic(sensor.topic).frame_ids
        frame = sensor.frame or (frames[0] if frames else "")
        if sensor.lens is None or sensor.lens.recorded is None:
            return cls(sensor, frame)
        if sensor.extrinsics is not None or not frame:
            return cls(sensor, frame, ())
        own, infos = sensor.lens.recorded.camera_info, inventory.of_type(*own_types("camera_info"))
        others = (info.name for info in infos if info.name != own and frame in info.frame_ids)
        return cls(sensor, frame, tuple(others))

    @property
    def infos(self) -> tuple[str, ...]:
        """The CameraInfo topics that describe its lens."""
        lens = self.sensor.lens
        own = () if lens is None or lens.recorded is None else (lens.recorded.camera_info,)
        return (*own, *(self.same_frame or ()))


def camera_info_topic(channel: CameraChannel) -> str:
    """Return the CameraInfo topic: the recipe's, else `camera_info` beside the image topic."""
    if channel.camera_info is not None:
        return channel.camera_info
    parts = channel.topic.split("/")
    if parts[-1] == "compressed" and len(parts) > 2:
        parts = parts[:-1]
    return "/".join([*parts[:-1], "camera_info"])


def is_rectified(channel: CameraChannel) -> bool:
    """Return whether the recorded images are rectified: by the recipe, else by the name of the topic."""
    if channel.rectified is not None:
        return channel.rectified
    return any(part.startswith("image_rect") for part in channel.topic.split("/"))
