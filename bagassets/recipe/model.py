"""The recipe: the configuration of one dataset build, validated field by field.

A step never sees a `Recipe`. It gets a small parameter object made from the fields that it reads (`bagassets.assets`), so
that changing any other field cannot make it stale.

Paths in a loaded recipe are absolute; relative ones are relative to the recipe's folder.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import ConfigDict, Field, PrivateAttr, model_validator

from bagassets.base.json_types import JsonMapping
from bagassets.recipe.format_settings import OUR_FORMATS, with_our_sections
from bagassets.recipe.model_annotations import AnnotationFiles, AnnotationTopic
from bagassets.recipe.model_base import (
    ChannelName,
    Clock,
    DatasetSettings,
    FieldValueError,
    FrameName,
    Model,
    Slug,
    TopicName,
    Transform,
)
from bagassets.recipe.model_calibration import (
    CalibrationFile,
    CameraExtrinsics,
    CameraIntrinsics,
    PinholeIntrinsics,
)
from bagassets.recipe.model_checks import Checks
from bagassets.recipe.model_datasets import NamedDataset
from bagassets.recipe.model_poses import PoseSource
from bagassets.recipe.model_signals import Signal, SignalName
from bagassets.recipe.model_splits import Splits

S = TypeVar("S", bound=DatasetSettings)
Recover = Literal["refuse", "complete", "all"]
"""What becomes of damaged recordings."""


class GreyRange(Model):
    """How 16-bit grey values become 8-bit ones: the same for the whole recording, never per image."""

    range: tuple[float, float] | None = Field(None, description="Grey values that are mapped to 0 and 255.")
    percentiles: tuple[float, float] | None = Field(
        None, description="Percentiles of the whole recording that are mapped to 0 and 255."
    )

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.range is None) == (self.percentiles is None):
            raise ValueError("give either range or percentiles")
        field = "percentiles" if self.range is None else "range"
        low, high = self.range or self.percentiles or (0.0, 0.0)
        if not low < high:
            raise FieldValueError((field,), "the first value must be smaller than the second")
        if self.percentiles is not None and not (low >= 0.0 and high <= 100.0):
            raise FieldValueError((field,), "percentiles must be between 0 and 100")
        return self


class _Channel(Model):
    topic: TopicName = Field(description="Topic with the data.")
    frame: FrameName | None = Field(None, description="Sensor frame; default: the header's frame_id.")
    clock: Clock | None = Field(
        None,
        description="Time of this channel's messages: their header stamps, or when they were logged; default: "
        "that of the rig. Other channels keep their stamps.",
    )

    @property
    def calibration_files(self) -> dict[str, CalibrationFile]:
        """Field -> the calibration file that it names."""
        return {field: value for field, value in self if isinstance(value, CalibrationFile)}


class _PlacedChannel(_Channel):
    extrinsics: Transform | None = Field(
        None, description="Transform `ego <- sensor`; default: from TF or the URDF."
    )


DEPTH_UNIT_M = 0.001


class CameraChannel(_Channel):
    """A camera: images, or the pictures of a video, become image files."""

    modality: Literal["camera"] = "camera"
    camera_info: TopicName | None = Field(
        None, description="CameraInfo topic; default: `camera_info` beside the topic."
    )
    extrinsics: CameraExtrinsics | None = Field(
        None, description="Transform `ego <- sensor`, or the file that has it; default: from TF or the URDF."
    )
    intrinsics: CameraIntrinsics | None = Field(
        None, description="Calibration that replaces CameraInfo, or the file that has it."
    )
    output: Literal["jpeg", "png", "as_recorded"] = Field(
        "jpeg",
        description="File format. `as_recorded` keeps the bytes of a JPEG or PNG unless it needs undistortion, "
        "holds a Bayer mosaic, or has red and blue swapped.",
    )
    quality: int = Field(90, ge=1, le=100, description="JPEG quality.")
    undistort: bool = Field(True, description="Remove lens distortion (with R = identity); needs intrinsics.")
    rectified: bool | None = Field(
        None,
        description="The recorded images are rectified, so P and R of CameraInfo apply, not K and D; default: true if a part of the topic's name starts with image_rect.",
    )
    target: PinholeIntrinsics | None = Field(
        None, description="Another K for undistorted images; default: the camera's K."
    )
    to_8bit: GreyRange | None = Field(None, description="How 16-bit grey becomes 8-bit; required for jpeg.")
    depth_unit_m: float = Field(
        DEPTH_UNIT_M,
        gt=0,
        le=1,
        description="Metres that a grey level of 16-bit PNGs stands for, where depth was recorded in metres (32FC1, also as "
        "compressedDepth); 0 is no depth. Depth of 16 bit keeps its unit, mostly millimetres.",
    )


class PointTimes(Model):
    """What the times of the points of a PointCloud2 are."""

    unit: Literal["s", "ms", "us", "ns"] = Field(description="What they count.")
    since: Literal["header", "clock"] = Field(
        description="They count from the header stamp of their cloud, or are those of a clock: that of the header stamps, if "
        "these are near, or another one, of which only differences are used.",
    )


class LidarChannel(_PlacedChannel):
    """A lidar: its clouds, scans, or packets of Velodyne, Hesai and Ouster become `.pcd.bin` files."""

    modality: Literal["lidar"] = "lidar"
    model: str | None = Field(
        None, description="Velodyne model of packets, such as VLP-16 or VLS-128; default: as the packets say."
    )
    stamp: Literal["end", "start", "middle"] = Field(
        "end",
        description="Which moment of a revolution its stamp is; for clouds without point times only if header_stamp_is is given.",
    )
    header_stamp_is: Literal["end", "start", "middle"] | None = Field(
        None,
        description="Which moment of a revolution the header stamp of a cloud is; default: as the times of its "
        "points show; without such times the stamp is kept.",
    )
    stamp_offset_s: float = Field(
        0.0,
        description="Added to all stamps of the channel; positive for a sensor whose clock is behind.",
    )
    cut_angle_deg: float | None = Field(
        None,
        ge=0,
        lt=360,
        description="Azimuth at which packets are cut into revolutions; default: 0 or, if the field of view is "
        "restricted, the middle of the arc outside it.",
    )
    metadata: Path | None = Field(
        None,
        description="File about the lidar whose packets are read, as its driver saves it: the metadata of an Ouster (JSON) or the "
        "correction file of a Hesai (CSV); default: the topic `metadata` or `lidar_corrections` beside that of the packets.",
    )
    deskew: bool = Field(
        False,
        description="Move each point to where it would be seen at the stamp of its revolution, using ego poses.",
    )
    min_range_m: float = Field(0.0, ge=0, description="Points nearer than this are dropped and counted.")
    max_range_m: float | None = Field(
        None, gt=0, description="Points farther than this are dropped and counted."
    )
    point_times: PointTimes | Literal["ignore"] | None = Field(
        None,
        description="What the times of the points of a PointCloud2 are, or that they are not used; default: as the first "
        "clouds show.",
    )
    zero_points: Literal["drop", "keep"] = Field(
        "drop",
        description="What becomes of points of a cloud at exactly 0, 0, 0, which mean that nothing was hit; they are counted.",
    )
    intensity_scale: float = Field(
        1.0,
        gt=0,
        allow_inf_nan=False,
        description="Recorded intensities are multiplied by this; nuScenes has 0 to 255, so 255 for a lidar with 0 to 1.",
    )


class RadarChannel(_PlacedChannel):
    """A radar: clouds, RadarScan or track messages become 18-field `.pcd` files."""

    modality: Literal["radar"] = "radar"
    azimuth_positive: Literal["left", "right"] | None = Field(
        None,
        description="Side of positive recorded azimuths; default: as the message type defines it.",
    )
    velocities: Literal["relative", "over_ground"] | None = Field(
        None,
        description="What recorded velocities are: `relative` to the radar, so that ego poses compensate them for its motion "
        "(even if the messages hold compensated ones, too), or `over_ground`, so that they stay as they are; default: as "
        "the message type defines it, else as recorded.",
    )


Channel = Annotated[CameraChannel | LidarChannel | RadarChannel, Field(discriminator="modality")]


class Rig(Model):
    """One sensor set-up: the recordings that it made, and the meaning of their topics.

    It needs ego poses if a format asks for them: nuScenes does, vision does for trajectories in the `global` frame.
    """

    name: Slug = Field(description="Name, used in tokens and logs.")
    match: tuple[str, ...] = Field(
        ("**",), description="Globs for the path below `bags.root`; the first rig that matches is used."
    )
    ego_frame: FrameName = Field("base_link", description="Frame that ego poses and extrinsics refer to.")
    clock: Clock | None = Field(
        None,
        description="Time of this rig's messages: their header stamps, or when they were logged; default: the recipe's "
        "`clock`. A channel may have a `clock` of its own.",
    )
    channels: dict[ChannelName, Channel] = Field(
        default_factory=dict, description="Canonical channel -> sensor; required without `signals`."
    )
    signals: dict[SignalName, Signal] = Field(
        default_factory=dict, description="Name -> series of numbers, such as joint positions and commands."
    )
    required: tuple[ChannelName, ...] = Field(
        (), description="A recording that lacks one of these channels is skipped."
    )
    ego_pose: PoseSource | None = Field(
        None, description="Source of ego poses; for a rig that stands still, `source: fixed`."
    )
    tf_static: tuple[TopicName, ...] = Field(("/tf_static",), description="Topics with static transforms.")
    tf: tuple[TopicName, ...] = Field(
        ("/tf",), description="Topics with transforms; also searched for fixed joints."
    )
    urdf: Path | None = Field(None, description="URDF file whose fixed joints give extrinsics.")
    annotations: tuple[AnnotationTopic, ...] = Field((), description="Topics with 3-D boxes.")
    annotation_files: tuple[AnnotationFiles, ...] = Field(
        (), description="Files with 3-D boxes beside the recordings."
    )
    vehicle: str | None = Field(
        None, description="Name of the vehicle in the log table; default: the rig's name."
    )
    location: str = Field("unknown", description="Name of the place in the log table.")

    _questions: tuple[str, ...] = PrivateAttr(())

    @property
    def questions(self) -> tuple[str, ...]:
        """What is to be decided before its recordings can be built: a sentence each, with its line in the recipe."""
        return self._questions

    def with_questions(self, questions: Iterable[str]) -> Self:
        """Return the rig with questions; what they ask for holds a stand-in."""
        rig = self.model_copy()
        rig._questions = tuple(questions)  # noqa: SLF001  (its own)
        return rig

    @model_validator(mode="after")
    def _known_channels(self) -> Self:
        if not self.channels and not self.signals:
            raise FieldValueError(("channels",), "needs at least one channel, unless the rig has signals")
        for number, channel in enumerate(self.required):
            if channel not in self.channels:
                known = ", ".join(self.channels)
                raise FieldValueError(
                    ("required", number), f"{channel} is not a channel of rig {self.name}, which has {known}"
                )
        return self


class Bags(Model):
    """Where recordings are, and which of them to use."""

    root: Path = Field(description="Folder searched for recordings.")
    include: tuple[str, ...] = Field(
        ("**",), description="Globs of recordings to use, for the path below the root."
    )
    exclude: tuple[str, ...] = Field((), description="Globs of recordings to leave out.")
    min_duration_s: float = Field(0.0, ge=0, description="Shorter recordings are skipped.")
    settle_s: float = Field(
        5.0, ge=0, description="A new file is read only after its size has not changed for this long."
    )
    message_definitions: tuple[Path, ...] = Field(
        (), description="Folders of .msg files for recordings without type definitions."
    )
    series: dict[str, bool | Annotated[tuple[str, ...], Field(min_length=2)]] = Field(
        {},
        description="Drives in several files: path of the whole drive below the root -> paths of its parts in order, `true` for "
        "the numbered files beside it (`drive.bag: true` joins drive_0.bag, drive_1.bag, …), or `false` to keep these apart; "
        "default: files are joined if their numbers, topics and times leave no doubt.",
    )
    recover: Recover = Field(
        "complete",
        description="What becomes of damaged recordings, which are read in place: `refuse` fails them; `complete` uses those of which "
        "every record is whole and no count is contradicted, such as one whose recorder was stopped before it wrote an index; "
        "`all` uses what can be read, and counts the rest as lost.",
    )
    digest_attributes: bool = Field(
        False,
        description="Store the digest of a recording with its files, as an extended attribute, so that other projects and "
        "machines need not read them to know what they are; without, builds write nothing to recordings, and keep "
        "digests in the state folder.",
    )

    _state: Path | None = PrivateAttr(None)

    @property
    def state(self) -> Path | None:
        """State folder of the project, if it is known, where what was seen of parts is remembered."""
        return self._state

    def with_state(self, state: Path) -> Self:
        """Return it with the state folder."""
        bags = self.model_copy()
        bags._state = state  # noqa: SLF001  (its own)
        return bags


class Scenes(Model):
    """How a recording is cut into scenes and keyframes."""

    reference: ChannelName | None = Field(
        None, description="Channel whose readings become keyframes; default LIDAR_TOP, else the first camera."
    )
    keyframe_hz: float = Field(2.0, gt=0, description="Keyframes per second.")
    length_s: float = Field(20.0, gt=0, description="Length of a scene.")
    min_length_s: float = Field(
        1.0, ge=0, description="A shorter remainder does not become a scene; it is counted."
    )
    tolerance_s: float = Field(
        0.1, gt=0, description="A channel's reading may differ this much in time from its keyframe."
    )
    box_gap_s: float = Field(
        1.0,
        gt=0,
        description="Boxes of a track are interpolated to keyframes between observations at most this far apart; "
        "elsewhere the nearest observation within tolerance_s is used, moved with the velocity of the track there.",
    )
    missing: Literal["allow", "refuse"] = Field(
        "refuse",
        description="If a channel has no reading within tolerance_s of a keyframe: `refuse` moves the keyframe to the "
        "nearest reading of the reference at which all channels in the recording have one, and drops it if there is "
        "none; `allow` keeps the sample without the channel, which breaks code that expects every channel. Builds "
        "report the numbers of dropped keyframes and of samples that lack a channel.",
    )


class Preview(Model):
    """Pictures of each recording: in the web UI, on disk and in `bagassets report`."""

    enabled: bool = Field(True, description="Make pictures.")
    camera: ChannelName | None = Field(
        None,
        description="Camera in pictures that show one camera; default: CAM_FRONT, else the rig's first camera.",
    )
    lidar: ChannelName | None = Field(
        None, description="Lidar in pictures; default: LIDAR_TOP, else the rig's first lidar."
    )
    columns: int = Field(6, ge=1, le=24, description="Number of moments on the contact sheet.")
    width: int = Field(1280, ge=320, le=3840, description="Width of each picture in pixels.")
    future_s: float = Field(
        4.0, gt=0, description="Seconds of the future trajectory drawn into the front image."
    )
    range_m: float | None = Field(
        None,
        gt=0,
        description="Half the side of the bird's-eye view; default: 2 to 200 m, so that it shows most points.",
    )
    trajectory_map: bool = Field(True, description="Make the map of all recordings (`trajectory_map`).")

    @property
    def has_map(self) -> bool:
        """True if the map of all recordings is made."""
        return self.enabled and self.trajectory_map


class Limits(Model):
    """How much may be lost before a recording fails, and how large things in a recording may be.

    Damaged and hostile files may announce any size. Sizes are checked before memory is allocated; exceeding a limit
    costs the message, the topic or the recording.
    """

    lost_messages: float = Field(
        0.01, ge=0, le=1, description="Share of a channel's messages that may fail to decode."
    )
    reported_losses: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Share of a channel's messages that may be lost, for any reason, before builds, "
        "`build --check` and `bagassets check` report it; also of those of ego poses, which `build --check` leaves out.",
    )
    chunk_bytes: int = Field(
        256_000_000,
        ge=1_000_000,
        le=4_000_000_000,
        description="Uncompressed size of a chunk of a bag or MCAP; a larger one costs the recording.",
    )
    message_bytes: int = Field(
        256_000_000,
        ge=1_000_000,
        le=4_000_000_000,
        description="Uncompressed size of a message; a larger one is lost.",
    )
    message_elements: int = Field(
        1_000_000,
        ge=1_000,
        description="Strings and nested messages in the lists of one message; one with more is lost. "
        "Numbers do not count.",
    )
    array_length: int = Field(
        2_000,
        ge=100,
        description="Strings and nested messages in the fixed-length arrays of a definition; more cost "
        "the topic. Numbers do not count.",
    )
    definition_bytes: int = Field(
        500_000,
        ge=10_000,
        description="Size of the definition of a message type; a larger one costs the topic.",
    )
    compression_ratio: int = Field(
        1_000,
        ge=10,
        description="Uncompressed size of a recording relative to its files, if it is more than a gigabyte; more costs "
        "the recording.",
    )
    topics: int = Field(5_000, ge=1, description="Topics of a recording; more cost the recording.")
    connections: int = Field(
        50_000,
        ge=1,
        description="Connections (publishers, channels) of a recording; more cost the recording.",
    )
    image_pixels: int = Field(
        50_000_000,
        ge=10_000,
        description="Width times height of an image; a larger one is lost. A calibration for a larger one costs the "
        "channel.",
    )
    cloud_points: int = Field(
        5_000_000, ge=1_000, description="Points of a cloud, scan or radar message; one with more is lost."
    )

    def changed(self, *names: str) -> dict[str, int]:
        """Return the named limits that differ from their defaults, for the parameters of an action.

        Defaults belong to a step's version: a step whose default changes gets a new one.
        """
        fields = type(self).model_fields
        return {name: value for name in names if (value := getattr(self, name)) != fields[name].default}

    @classmethod
    def of(cls, params: JsonMapping) -> Self:
        """Return the limits that the parameters of an action hold; what they leave out is as by default."""
        return cls(**{name: params[name] for name in cls.model_fields if name in params})


_OF_CHANNELS = {"lost_messages", "reported_losses", "image_pixels", "cloud_points"}
# The limits that apply to every reader of a recording.
READING_LIMITS = tuple(name for name in Limits.model_fields if name not in _OF_CHANNELS)


@with_our_sections
class Recipe(Model):
    """Everything that shapes a dataset.

    It asks for datasets by their sections: `nuscenes`, `vision`, those in `formats`. One without any of them, or with
    `datasets`, has a nuScenes dataset, if need be with all defaults.
    """

    model_config = ConfigDict(defer_build=True)  # it is built once, with the sections

    name: Slug = Field(description="Name of the project and of its partitions in Dagster.")
    bags: Bags = Field(description="Where recordings are, and which of them to use.")
    state: Path = Field(Path(".bagassets"), description="Folder of the store and of Dagster's state.")
    store: Path | None = Field(
        None,
        description="Folder of the artifact store; default: `store` in the state folder. Projects and machines may share a store.",
    )
    clock: Clock = Field(
        "header",
        description="Time of a message: its header stamp, or when it was logged; a rig or a channel may have a `clock` of its own.",
    )
    rigs: tuple[Rig, ...] = Field(min_length=1, description="Sensor set-ups.")
    scenes: Scenes = Field(Scenes(), description="Scenes and keyframes.")
    splits: Splits = Field(Splits(), description="Which recordings belong to train, val and other splits.")
    formats: dict[Slug, Any] = Field(
        {},
        description="Datasets in formats that installed packages add (`bagassets docs page formats`): name of the format -> its "
        "settings, with an `output`.",
    )
    datasets: tuple[NamedDataset, ...] = Field(
        (), description="Further nuScenes datasets of selected scenes."
    )
    preview: Preview = Field(Preview(), description="Pictures of recordings.")
    limits: Limits = Field(Limits(), description="Accepted losses and sizes.")
    checks: Checks = Field(Checks(), description="Checks of finished assets.")

    @model_validator(mode="after")
    def _unique_rigs(self) -> Self:
        names: set[str] = set()
        for number, rig in enumerate(self.rigs):
            if rig.name in names:
                raise FieldValueError(("rigs", number, "name"), f"another rig is called {rig.name}, too")
            names.add(rig.name)
        return self

    @model_validator(mode="after")
    def _unique_datasets(self) -> Self:
        assets: dict[str, str] = {}
        for number, dataset in enumerate(self.datasets):
            if dataset.asset in assets:
                raise FieldValueError(
                    ("datasets", number, "name"),
                    f"would have the same asset name as the dataset {assets[dataset.asset]}; rename one",
                )
            assets[dataset.asset] = dataset.name
            unknown = [rig for rig in dataset.rigs if rig not in {rig.name for rig in self.rigs}]
            if unknown:
                raise FieldValueError(
                    ("datasets", number, "rigs"), f"{unknown[0]} is not a rig of this recipe"
                )
        return self

    def rig_named(self, name: str) -> Rig | None:
        """Return a rig by its name; None if there is none."""
        return next((rig for rig in self.rigs if rig.name == name), None)

    def channels(self, modality: str) -> list[str]:
        """Return the names of the channels of all rigs that have this modality."""
        return [
            name
            for rig in self.rigs
            for name, channel in rig.channels.items()
            if channel.modality == modality
        ]

    def clock_of(self, rig: Rig | None, channel: Channel | Signal | None = None) -> Clock:
        """Return which time of the messages of a rig, or of one of its channels or signals, counts."""
        own = None if channel is None else channel.clock
        return own or (None if rig is None else rig.clock) or self.clock

    @property
    def dataset_settings(self) -> Mapping[str, DatasetSettings]:
        """Format -> section, for the datasets of this recipe, in order; without those whose packages cannot be used."""
        # Of these, the section is left as plain data.
        sections = {name: getattr(self, name) for name in OUR_FORMATS} | self.formats
        return {name: one for name, one in sections.items() if isinstance(one, DatasetSettings)}

    def settings(self, model: type[S]) -> S | None:
        """Return the section of a format by the model of its settings; None if the recipe asks for no such dataset."""
        return next((one for one in self.dataset_settings.values() if isinstance(one, model)), None)

    @property
    def output(self) -> Path:
        """Folder of the first dataset; the state folder if the package of its only format cannot be used."""
        return next((one.output for one in self.dataset_settings.values()), self.state)

    @property
    def store_path(self) -> Path:
        """Folder of the artifact store."""
        return self.state / "store" if self.store is None else self.store

    @property
    def dagster_home(self) -> Path:
        """Folder of the Dagster instance of this recipe."""
        return self.state / "dagster"
