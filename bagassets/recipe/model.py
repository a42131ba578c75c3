"""What a recipe may say: the configuration of one dataset build, checked field by field.

A step never sees a `Recipe`. It is handed a small parameter object made from the fields it
reads (`bagassets.assets`), so that changing any other field cannot make it stale.

Paths in a loaded recipe are absolute; relative ones are relative to the recipe's folder.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from bagassets.json_types import JsonMapping
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
from bagassets.recipe.model_checks import Checks
from bagassets.recipe.model_datasets import NamedDataset
from bagassets.recipe.model_poses import PoseSource
from bagassets.recipe.model_preview import Preview
from bagassets.recipe.model_splits import Splits
from bagassets.recipe.model_vision import Vision


class Intrinsics(Model):
    """Camera calibration given by hand, for recordings without CameraInfo."""

    model: Literal["plumb_bob", "rational_polynomial", "equidistant"] = Field(
        "plumb_bob", description="Distortion model, named as in sensor_msgs/CameraInfo."
    )
    width: int = Field(gt=0, description="Image width in pixels.")
    height: int = Field(gt=0, description="Image height in pixels.")
    fx: float = Field(gt=0, description="Focal length in pixels.")
    fy: float = Field(gt=0, description="Focal length in pixels.")
    cx: float = Field(description="Principal point in pixels.")
    cy: float = Field(description="Principal point in pixels.")
    distortion: tuple[float, ...] = Field(
        (), description="Coefficients in the order of the model; empty = none."
    )


class PinholeIntrinsics(Model):
    """The pinhole matrix that undistorted images are written with."""

    fx: float = Field(gt=0, description="Focal length in pixels.")
    fy: float = Field(gt=0, description="Focal length in pixels.")
    cx: float = Field(description="Principal point in pixels.")
    cy: float = Field(description="Principal point in pixels.")


class GreyRange(Model):
    """How 16-bit grey values become 8 bit: one rule for the whole recording, never per image."""

    range: tuple[float, float] | None = Field(None, description="Fixed grey values mapped to 0 and 255.")
    percentiles: tuple[float, float] | None = Field(
        None, description="Percentiles over the whole recording mapped to 0 and 255."
    )

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.range is None) == (self.percentiles is None):
            msg = "give either range or percentiles"
            raise ValueError(msg)
        field = "percentiles" if self.range is None else "range"
        low, high = self.range or self.percentiles or (0.0, 0.0)
        if not low < high:
            raise FieldValueError((field,), "the first value must be smaller than the second")
        if self.percentiles is not None and not (low >= 0.0 and high <= 100.0):
            raise FieldValueError((field,), "percentiles lie between 0 and 100")
        return self


class _Channel(Model):
    topic: TopicName = Field(description="Topic that carries the data.")
    frame: FrameName | None = Field(None, description="Sensor frame; default: the header's frame_id.")
    extrinsics: Transform | None = Field(
        None, description="ego <- sensor given by hand; default: from TF or the URDF."
    )
    clock: Clock | None = Field(
        None,
        description="Time of this channel's messages: their header stamps, or when they were logged; default: the "
        "that of the rig. Other channels keep their stamps.",
    )


class CameraChannel(_Channel):
    """A camera: Image or CompressedImage messages become image files."""

    modality: Literal["camera"] = "camera"
    camera_info: TopicName | None = Field(
        None, description="CameraInfo topic; default: `camera_info` beside the topic."
    )
    intrinsics: Intrinsics | None = Field(None, description="Calibration by hand; wins over CameraInfo.")
    output: Literal["jpeg", "png", "as_recorded"] = Field(
        "jpeg",
        description="File format. as_recorded passes a JPEG or PNG through byte for byte if it needs no undistortion "
        "and holds neither a Bayer mosaic nor red and blue exchanged.",
    )
    quality: int = Field(90, ge=1, le=100, description="JPEG quality.")
    undistort: bool = Field(True, description="Remove lens distortion (R = identity); needs intrinsics.")
    rectified: bool | None = Field(
        None,
        description="The recorded images are rectified: P and R of CameraInfo hold, not K and D; default: if a part of the topic starts with image_rect.",
    )
    target: PinholeIntrinsics | None = Field(
        None, description="Another K for undistorted images; default: the camera's K."
    )
    to_8bit: GreyRange | None = Field(None, description="Rule that makes 16-bit grey 8 bit, needed for jpeg.")


class LidarChannel(_Channel):
    """A lidar: PointCloud2, Velodyne packets or LaserScan messages become `.pcd.bin` files."""

    modality: Literal["lidar"] = "lidar"
    model: str | None = Field(
        None, description="Velodyne model for packets, e.g. VLP-16, VLS-128; default: asked from the packets."
    )
    stamp: Literal["end", "start", "middle"] = Field(
        "end",
        description="Which time of a revolution is its stamp; of clouds without point times, if header_stamp_is is given.",
    )
    header_stamp_is: Literal["end", "start", "middle"] | None = Field(
        None,
        description="Which time of a revolution the recording's own stamp means, for clouds; default: what the points' "
        "own times say, and without such times the stamp stays as recorded.",
    )
    stamp_offset_s: float = Field(
        0.0,
        description="Added to all stamps of the channel, for a sensor whose clock runs behind (positive) or ahead.",
    )
    cut_angle_deg: float | None = Field(
        None,
        ge=0,
        lt=360,
        description="Azimuth at which packets are cut into revolutions; default: 0, or the middle of the arc that a "
        "lidar with a restricted field of view does not report.",
    )
    deskew: bool = Field(False, description="Move each point to the stamp of its revolution, with ego poses.")
    min_range_m: float = Field(0.0, ge=0, description="Nearer points are dropped and counted.")
    max_range_m: float | None = Field(None, gt=0, description="Farther points are dropped and counted.")


class RadarChannel(_Channel):
    """A radar: clouds, RadarScan or track messages become 18-field `.pcd` files."""

    modality: Literal["radar"] = "radar"
    azimuth_positive: Literal["left", "right"] | None = Field(
        None,
        description="Side on which recorded azimuths are positive; default: as the message type defines it.",
    )


Channel = Annotated[CameraChannel | LidarChannel | RadarChannel, Field(discriminator="modality")]


class Rig(Model):
    """One sensor set-up: which recordings it made and what their topics mean."""

    name: Slug = Field(description="Name, used in tokens and logs.")
    match: tuple[str, ...] = Field(
        ("**",), description="Globs on the path below the bag root; the first rig that matches wins."
    )
    ego_frame: FrameName = Field("base_link", description="Frame that ego poses and extrinsics refer to.")
    clock: Clock | None = Field(
        None,
        description="Time of this rig's messages: their header stamps, or when they were logged; default: the recipe's "
        "`clock`. A channel may have a `clock` of its own.",
    )
    channels: dict[ChannelName, Channel] = Field(min_length=1, description="Canonical channel -> sensor.")
    required: tuple[ChannelName, ...] = Field(
        (), description="Channels without which a recording is skipped."
    )
    ego_pose: PoseSource = Field(
        description="Where poses come from; a rig that stands still says `source: fixed`."
    )
    tf_static: tuple[TopicName, ...] = Field(("/tf_static",), description="Topics with static transforms.")
    tf: tuple[TopicName, ...] = Field(
        ("/tf",), description="Topics with transforms, searched for fixed joints too."
    )
    urdf: Path | None = Field(None, description="URDF file whose fixed joints give extrinsics.")
    annotations: tuple[AnnotationTopic, ...] = Field((), description="Topics with 3-D boxes.")
    annotation_files: tuple[AnnotationFiles, ...] = Field(
        (), description="Files with 3-D boxes beside the recordings."
    )
    vehicle: str | None = Field(None, description="Vehicle named in the log table; default: the rig's name.")
    location: str = Field("unknown", description="Place named in the log table.")

    @model_validator(mode="after")
    def _known_channels(self) -> Self:
        for number, channel in enumerate(self.required):
            if channel not in self.channels:
                known = ", ".join(self.channels)
                raise FieldValueError(
                    ("required", number), f"{channel} is not a channel of rig {self.name}, which has {known}"
                )
        return self


class Bags(Model):
    """Where recordings are and which of them count."""

    root: Path = Field(description="Folder searched for recordings.")
    include: tuple[str, ...] = Field(("**",), description="Globs on the path below the root.")
    exclude: tuple[str, ...] = Field((), description="Globs of recordings to leave out.")
    min_duration_s: float = Field(0.0, ge=0, description="Shorter recordings are skipped.")
    settle_s: float = Field(
        5.0, ge=0, description="A new file must keep its size this long before it is read."
    )
    message_definitions: tuple[Path, ...] = Field(
        (), description="Folders of .msg files for recordings without type definitions."
    )
    digest_attributes: bool = Field(
        False,
        description="Store the digest of a recording with its files, as an extended attribute, so that other projects and "
        "machines need not read them to know what they are; without, builds write nothing to recordings, and keep "
        "digests in the state folder.",
    )


class Scenes(Model):
    """How a recording is cut into scenes and keyframes."""

    reference: ChannelName | None = Field(
        None, description="Channel whose readings become keyframes; default LIDAR_TOP, else the first camera."
    )
    keyframe_hz: float = Field(2.0, gt=0, description="Keyframes per second.")
    length_s: float = Field(20.0, gt=0, description="Length of a scene.")
    min_length_s: float = Field(1.0, ge=0, description="A shorter remainder makes no scene (and is counted).")
    tolerance_s: float = Field(
        0.1, gt=0, description="A channel's reading may be this far from its keyframe."
    )
    box_gap_s: float = Field(
        1.0,
        gt=0,
        description="Boxes of a track are interpolated to keyframes between observations at most this far apart; "
        "elsewhere the nearest observation within tolerance_s counts, moved on as the track moved there.",
    )
    missing: Literal["allow", "refuse"] = Field(
        "refuse",
        description="What if a channel has no reading within tolerance_s of a keyframe: refuse moves the keyframe to the "
        "nearest reading of the reference where all channels that the recording has are at hand, and drops it if there "
        "is none; allow keeps the sample without the channel, which code that takes every channel for granted stumbles "
        "over. Builds say how many keyframes are dropped, or samples lack a channel.",
    )


class NamedText(Model):
    """A category or attribute with its description."""

    name: str = Field(description="Name, as in vehicle.car.")
    description: str = Field("", description="One sentence for people.")


class AttributesByMotion(Model):
    """Attributes for boxes whose source gives none: moving, stopped, parked, standing (`bagassets docs page annotations`)."""

    enabled: bool = Field(True, description="Determine attributes by motion.")
    moving_mps: float = Field(0.5, gt=0, description="An object at this speed or more is moving.")
    window_s: float = Field(
        1.0,
        gt=0,
        description="A speed is measured over this time around the keyframe, at least over half of it.",
    )
    parked_m: float = Field(
        1.0,
        gt=0,
        description="A vehicle is parked if it was never moving in the recording and never farther than this from "
        "where it was first seen; otherwise, when at rest, it has stopped.",
    )


class NuScenes(DatasetSettings):
    """The nuScenes dataset that is written."""

    output: Path = Field(Path("dataset/nuscenes"), description="Dataroot.")
    version: Slug = Field("v1.0-custom", description="Version folder.")
    categories: tuple[NamedText, ...] = Field((), description="Categories; those met in the bags are added.")
    attributes: tuple[NamedText, ...] = Field((), description="Attributes; those met in the bags are added.")
    attributes_by_motion: AttributesByMotion = Field(
        AttributesByMotion(), description="Attributes for boxes whose source gives none."
    )


class Limits(Model):
    """What may go wrong before a recording counts as failed, and what one may ask of the memory.

    Damaged and hostile files declare any size. Sizes are held against these limits before memory is
    taken; what exceeds one is lost with the message, the topic or the recording that it belongs to.
    """

    lost_messages: float = Field(
        0.01, ge=0, le=1, description="Share of a channel's messages that may fail to decode."
    )
    reported_losses: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Share of a channel's messages that may be lost, for whatever reason, before the end of a build, "
        "`build --check` and `bagassets check` name it.",
    )
    chunk_bytes: int = Field(
        256_000_000,
        ge=1_000_000,
        le=4_000_000_000,
        description="Size of a chunk of a bag or MCAP, unpacked; a larger one costs the recording.",
    )
    message_bytes: int = Field(
        256_000_000,
        ge=1_000_000,
        le=4_000_000_000,
        description="Size of a message, unpacked; a larger one is lost.",
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
        description="Strings and nested messages that a definition announces in arrays of fixed length; more cost "
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
        description="How many times its size a recording may unpack to once that is more than a gigabyte; more cost "
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
        description="Width times height of an image; a larger one is lost. A calibration of a larger one costs the "
        "channel.",
    )
    cloud_points: int = Field(
        5_000_000, ge=1_000, description="Points of a cloud, scan or radar message; one with more is lost."
    )

    def changed(self, *names: str) -> dict[str, int]:
        """Return those of the named limits that are not the defaults, for the parameters of an action.

        Defaults are part of a step's version: a step whose default changes gets a new one.
        """
        fields = type(self).model_fields
        return {name: value for name in names if (value := getattr(self, name)) != fields[name].default}

    @classmethod
    def of(cls, params: JsonMapping) -> Self:
        """Return the limits that the parameters of an action hold; what they leave out is as by default."""
        return cls(**{name: params[name] for name in cls.model_fields if name in params})


# Those that reading a recording is held to, whatever reads it.
READING_LIMITS = (
    "chunk_bytes",
    "message_bytes",
    "message_elements",
    "array_length",
    "definition_bytes",
    "compression_ratio",
    "topics",
    "connections",
)


class Recipe(Model):
    """Everything that shapes a dataset."""

    name: Slug = Field(description="Name of the project; also names the partitions in Dagster.")
    bags: Bags = Field(description="Where recordings are and which of them count.")
    state: Path = Field(Path(".bagassets"), description="Folder that keeps store and Dagster state.")
    store: Path | None = Field(
        None,
        description="Folder of the artifact store; default: `store` in the state folder. Projects and machines may share one.",
    )
    clock: Clock = Field(
        "header",
        description="Time of a message: its header stamp, or when it was logged; a rig or a channel may have a `clock` of its own.",
    )
    rigs: tuple[Rig, ...] = Field(min_length=1, description="Sensor set-ups.")
    scenes: Scenes = Field(Scenes(), description="Scenes and keyframes.")
    splits: Splits = Field(Splits(), description="Which recordings belong to train, val and so on.")
    nuscenes: NuScenes = Field(NuScenes(), description="The nuScenes dataset.")
    vision: Vision | None = Field(None, description="The vision dataset; default: none is made.")
    formats: dict[Slug, Any] = Field(
        {},
        description="Datasets in formats that installed packages add (`bagassets docs page formats`): the name of the format -> its "
        "settings, of which all have an `output`.",
    )
    datasets: tuple[NamedDataset, ...] = Field((), description="Further datasets of some of the scenes.")
    preview: Preview = Field(Preview(), description="Pictures for people.")
    limits: Limits = Field(Limits(), description="Accepted losses and sizes.")
    checks: Checks = Field(Checks(), description="Checks of finished assets.")

    @model_validator(mode="after")
    def _unique_rigs(self) -> Self:
        names: set[str] = set()
        for number, rig in enumerate(self.rigs):
            if rig.name in names:
                raise FieldValueError(("rigs", number, "name"), f"another rig is called {rig.name} too")
            names.add(rig.name)
        return self

    @model_validator(mode="after")
    def _unique_datasets(self) -> Self:
        assets: dict[str, str] = {}
        for number, dataset in enumerate(self.datasets):
            if dataset.asset in assets:
                raise FieldValueError(
                    ("datasets", number, "name"), f"is too much like {assets[dataset.asset]}, another dataset"
                )
            assets[dataset.asset] = dataset.name
            unknown = [rig for rig in dataset.rigs if rig not in {rig.name for rig in self.rigs}]
            if unknown:
                raise FieldValueError(("datasets", number, "rigs"), f"{unknown[0]} is no rig of this recipe")
        return self

    def rig_named(self, name: str) -> Rig | None:
        """Return a rig by its name; None if there is none."""
        return next((rig for rig in self.rigs if rig.name == name), None)

    def clock_of(self, rig: Rig | None, channel: Channel | None = None) -> Clock:
        """Return which time of the messages of a rig, or of one of its channels, counts."""
        own = None if channel is None else channel.clock
        return own or (None if rig is None else rig.clock) or self.clock

    @property
    def dataset_settings(self) -> Mapping[str, DatasetSettings]:
        """Name of a dataset format -> its section, of the datasets that are made; in order."""
        sections: dict[str, DatasetSettings] = {"nuscenes": self.nuscenes}
        sections |= {} if self.vision is None else {"vision": self.vision}
        # A section whose package cannot be used is no such object.
        return sections | {
            name: section for name, section in self.formats.items() if isinstance(section, DatasetSettings)
        }

    @property
    def store_path(self) -> Path:
        """Folder of the artifact store."""
        return self.state / "store" if self.store is None else self.store

    @property
    def dagster_home(self) -> Path:
        """Folder of the Dagster instance of this recipe."""
        return self.state / "dagster"
