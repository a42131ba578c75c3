"""Recipe sections about annotations: boxes in topics of a recording, and in files beside it."""

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from bagassets.recipe.model_base import FrameName, Model, TopicName, not_empty

_PATH = (
    "Relative to the recording's folder; `{stem}` (file name without suffix), `{name}` and `{key}` are replaced by those "
    "of the recording."
)


_PLACEHOLDERS = ("stem", "name", "key")


def _template(text: str) -> str:
    for name in re.findall(r"\{(.*?)\}", text):
        if name not in _PLACEHOLDERS:
            raise ValueError(
                f"`{{{name}}}` is not a placeholder; the placeholders are {', '.join(f'`{{{p}}}`' for p in _PLACEHOLDERS)}"
            )
    return not_empty(text)


Template = Annotated[str, AfterValidator(_template)]


class _BoxRules(Model):
    frame: FrameName | None = Field(
        None, description="Frame of the boxes; default: the frame that they name."
    )
    categories: dict[str, str] = Field(
        default_factory=dict, description="Recorded class -> category; others keep their names."
    )
    attributes: dict[str, tuple[str, ...]] = Field(
        default_factory=dict, description="Category -> attributes of all its boxes."
    )
    attribute_names: dict[str, str] = Field(
        default_factory=dict,
        description="Recorded attribute -> attribute; others keep their names. An empty name drops the attribute.",
    )
    unmapped: Literal["keep", "count", "refuse"] = Field(
        "keep",
        description="A class that is not in `categories` keeps its own name (and is counted), is left out and "
        "counted, or fails the recording.",
    )
    bad_boxes: Literal["count", "refuse"] = Field(
        "count", description="An unusable box is left out and counted, or fails the recording."
    )


class AnnotationTopic(_BoxRules):
    """Boxes published in the recording."""

    topic: TopicName = Field(
        description="Topic with 3-D boxes, such as vision_msgs/Detection3DArray or visualization_msgs/MarkerArray; "
        "`bagassets docs page decoders` lists all types."
    )


class TopicTimes(Model):
    """Frames are the messages of a topic, counted in order of log time."""

    by: Literal["topic"] = "topic"
    topic: TopicName = Field(description="The labelled topic.")
    first: int = Field(0, ge=0, description="Frame number of the first message.")


class FileTimes(Model):
    """Frames are the lines of a file of stamps: nanoseconds, or date and time (UTC) as in KITTI."""

    by: Literal["file"] = "file"
    path: Template = Field(description=f"File with one stamp per line. {_PATH}")
    first: int = Field(0, ge=0, description="Frame number of the first line.")


class NameTimes(Model):
    """The number at the end of each label file's name is its time."""

    by: Literal["name"] = "name"
    unit: Literal["ns", "us", "ms", "s"] = Field("ns", description="Unit of the number.")


FrameTimes = Annotated[TopicTimes | FileTimes | NameTimes, Field(discriminator="by")]
NumberedTimes = Annotated[TopicTimes | FileTimes, Field(discriminator="by")]


class _AnnotationFiles(_BoxRules):
    path: Template = Field(description=f"File or folder. {_PATH}")
    offset_s: float = Field(0.0, description="Added to the stamp of each box.")
    outside: Literal["count", "keep", "refuse"] = Field(
        "count",
        description="A box more than a second before or after the recording is left out and counted, kept (and counted), or fails it.",
    )
    missing: Literal["allow", "refuse"] = Field(
        "allow", description="A recording without this file or folder has no boxes from it, or fails."
    )
    bad_files: Literal["count", "refuse"] = Field(
        "refuse",
        description="A file that does not parse fails the recording, or is left out and counted.",
    )


class BoxFiles(_AnnotationFiles):
    """Boxes in our own JSON or Parquet form (`bagassets docs page annotations`): a file, or a folder of them."""

    format: Literal["boxes"] = "boxes"


class SustechFolder(_AnnotationFiles):
    """A label folder of SUSTechPOINTS: one JSON file per labelled cloud."""

    format: Literal["sustechpoints"] = "sustechpoints"
    times: FrameTimes = Field(description="Times of the label files.")


class KittiTracklets(_AnnotationFiles):
    """`tracklet_labels.xml` of KITTI raw data: tracks in the lidar frame."""

    format: Literal["kitti_tracklets"] = "kitti_tracklets"
    times: NumberedTimes = Field(description="Times of the numbered frames.")


class KittiLabels(_AnnotationFiles):
    """KITTI labels in the frame of the rectified camera: a tracking file, or a folder with one file per frame."""

    format: Literal["kitti_labels"] = "kitti_labels"
    times: FrameTimes = Field(description="Times of the numbered frames, or of the label files.")


class NuScenesTables(_AnnotationFiles):
    """A version folder of a nuScenes dataset; boxes in its global frame."""

    format: Literal["nuscenes"] = "nuscenes"
    logfile: Template | None = Field(
        None,
        description="Only boxes of the log with this logfile; `{stem}`, `{name}` and `{key}` as in the path. "
        "Default: all logs.",
    )


AnnotationFiles = Annotated[
    BoxFiles | SustechFolder | KittiTracklets | KittiLabels | NuScenesTables, Field(discriminator="format")
]
