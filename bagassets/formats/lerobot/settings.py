"""The settings of the LeRobot format: the section `lerobot` of a recipe."""

import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, PlainSerializer, model_validator

from bagassets.base.json_types import Json
from bagassets.formats.lerobot.ranges import unknown_rows
from bagassets.recipe.model_base import ChannelName, DatasetSettings, FieldValueError, Model, TopicName
from bagassets.recipe.schema import suggestion

if TYPE_CHECKING:
    from bagassets.recipe.model import Recipe

MOST_S = 1024
"""A video file ends before this time: readers compare times as float32 to 0.1 ms, which is finer than its grid from there on."""

_PRESETS = {
    "h264": "ultrafast superfast veryfast faster fast medium slow slower veryslow placebo 0 1 2 3 4 5 6 7 8 9",
    "av1": "-2 -1 0 1 2 3 4 5 6 7 8 9 10 11 12 13",
}
_WORST_OF_X264 = 51  # which x264 takes for any that is greater
IMAGES = "observation.image"
OWN_COLUMNS = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Columns that every dataset has."""


def _feature_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z_][\w.]*", name):
        raise ValueError("must consist of letters, digits, '_' and '.', as in observation.state")
    if name in OWN_COLUMNS:
        raise ValueError("every LeRobot dataset has a column of that name; choose another")
    return name


FeatureName = Annotated[str, AfterValidator(_feature_name)]
FieldPaths = str | Annotated[tuple[str, ...], Field(min_length=1)]
# Where the file is does not matter, only what it says of a recording.
LooseFile = Annotated[Path, PlainSerializer(lambda path: path.name, str, when_used="json")]


class Feature(Model):
    """A feature of each frame, from signals, from a camera, or the next value of another feature."""

    signals: tuple[str, ...] = Field((), description="Signals of the rig whose elements it has, in order.")
    camera: ChannelName | None = Field(None, description="Camera whose images it has, as a video.")
    next_of: FeatureName | None = Field(
        None,
        description="Feature of signals whose value in the next frame it has: an `action` where no command was recorded. "
        "The last frame of each episode, which has no next one, is dropped.",
    )
    at: Literal["latest", "nearest", "linear", "hold"] = Field(
        "latest",
        description="Which value a frame gets: the latest one before it; the nearest; one interpolated between both neighbours "
        "(signals only); or the latest one however old it is.",
    )
    tolerance_s: float | None = Field(
        None,
        gt=0,
        description="Longest time between a frame and its value; default: 1.5 frames.",
    )
    gap: Literal["leave_out", "hold", "end"] = Field(
        "leave_out",
        description="What a frame without a value does: the episode is left out; the frame gets the latest value before it, "
        "and is counted; or the episode ends before it.",
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        given = [bool(self.signals), self.camera is not None, self.next_of is not None]
        if sum(given) != 1:
            raise FieldValueError((), "takes one of `signals`, `camera` and `next_of`")
        if self.camera is not None and self.at == "linear":
            raise FieldValueError(("at",), "images are not interpolated; use `latest` or `nearest`")
        return self


class Cuts(Model):
    """Where episodes are in a recording, as far as the recipe says so."""

    topic: TopicName | None = Field(
        None, description="Topic whose messages begin and end episodes; each one begins one without `start`."
    )
    field: FieldPaths = Field(
        "data",
        description="Path of the field in its messages that `start` and `end` compare, or a list of paths: the first that a message "
        "has.",
    )
    start: tuple[str | bool | int, ...] = Field(
        (), description="Values of the field that begin an episode (and end the one before)."
    )
    end: tuple[str | bool | int, ...] = Field((), description="Values of the field that end an episode.")
    signal: str | None = Field(
        None, description="Signal with one element; episodes are where it is not zero."
    )
    trim_s: float = Field(
        1.0,
        ge=0,
        description="Episodes begin when all features have begun and end when the first one ends; one that would lose more "
        "than this at either end is left out.",
    )
    min_length_s: float = Field(0.0, ge=0, description="Shorter episodes are left out.")
    max_length_s: float | None = Field(
        None,
        gt=0,
        lt=MOST_S,
        description="Longer episodes are cut into pieces of this length; default: those that one video file cannot hold are left out.",
    )


class Episodes(Cuts):
    """Where episodes are in a recording; without any of these fields, a recording is one episode."""

    ranges: LooseFile | None = Field(
        None,
        description="CSV file with the columns `recording`, `start_s` and `end_s` (seconds since the recording began) or `start_ns` "
        "and `end_ns` (stamps), and maybe `task`; the end is the first time after the episode. Recordings that it does not name have no episodes.",
    )

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ways = [name for name in ("topic", "signal", "ranges") if getattr(self, name) is not None]
        if len(ways) > 1:
            raise FieldValueError((ways[1],), f"episodes are cut by `{ways[0]}` already; give one of them")
        if (self.start or self.end) and self.topic is None:
            raise FieldValueError(("start" if self.start else "end",), "needs the `topic` that says so")
        if self.end and not self.start:
            raise FieldValueError(("end",), "needs `start`, too")
        return self


class TaskTopic(Model):
    """The task as messages say it."""

    topic: TopicName = Field(
        description="Topic with the text; the latest one before an episode holds for it."
    )
    field: FieldPaths = Field(
        "data",
        description="Path of the field with the text, or a list of paths: the first that a message has.",
    )


class Encoding(Model):
    """How videos are encoded: no B-frames, BT.601, 4:2:0; the same settings for all files of a camera."""

    codec: Literal["h264", "av1"] = Field("h264", description="H.264 by x264, or AV1 by SVT-AV1.")
    crf: int | None = Field(
        None,
        ge=1,
        le=63,
        description="Quality, smaller is better: 1 to 51 for h264 (default: 23), 1 to 63 for av1 (default: 30).",
    )
    preset: str | None = Field(
        None,
        description="Preset of the encoder: ultrafast to placebo for h264 (default: veryfast), -2 to 13 for av1 (default: 8; those "
        "above may leave out small things that change between key frames, such as a lamp).",
    )
    keyframes: int = Field(
        2, ge=1, description="Every n-th frame is a key frame: small numbers make random access fast."
    )
    odd_size: Literal["crop", "pad"] = Field(
        "crop",
        description="Images of odd width or height lose their last column or row, or have it twice: videos have even sizes.",
    )

    @model_validator(mode="after")
    def _is_known_to_the_encoder(self) -> Self:
        if self.codec == "h264" and (self.crf or 0) > _WORST_OF_X264:
            raise FieldValueError(("crf",), f"of h264 must be 1 to {_WORST_OF_X264}; found {self.crf}")
        known = _PRESETS[self.codec].split()
        if self.preset is None or self.preset.lower() in known:
            return self
        found = f"found {self.preset!r}{suggestion(self.preset, known)}"
        raise FieldValueError(("preset",), f"of {self.codec} must be one of {', '.join(known)}; {found}")


class LeRobot(DatasetSettings):
    """The LeRobot dataset, version 3.0."""

    needs_mounts: ClassVar[bool] = False

    output: Path = Field(Path("dataset/lerobot"), description="Its folder `v3.0` is the root of the dataset.")
    fps: int = Field(ge=1, le=1000, description="Frames per second.")
    robot: str | None = Field(None, description="Type of the robot; default: the name of the rig.")
    features: dict[FeatureName, Feature] = Field(
        min_length=1,
        description="Feature -> where it is from: `observation.state`, `action`, `observation.images.NAME` and others.",
    )
    episodes: Episodes = Field(Episodes(), description="Where episodes are in a recording.")
    task: str | TaskTopic = Field(
        "",
        description="Task of all episodes for which `episodes.ranges` has none, as a sentence or from a topic.",
    )
    video: Encoding = Field(Encoding(), description="How videos are encoded.")

    @classmethod
    def asks_for_poses(cls, section: Json) -> bool:
        """Return False: no feature needs an ego pose."""
        del section
        return False

    def with_absolute_paths(self, folder: Path) -> Self:
        """Return the settings with paths relative to `folder` made absolute."""
        found = super().with_absolute_paths(folder)
        if self.episodes.ranges is None:
            return found
        episodes = self.episodes.model_copy(update={"ranges": (folder / self.episodes.ranges).resolve()})
        return found.model_copy(update={"episodes": episodes})

    @property
    def files_read(self) -> tuple[Path, ...]:
        """The file of time ranges."""
        return () if self.episodes.ranges is None else (self.episodes.ranges,)

    def doubts(self, keys: Collection[str]) -> Iterator[str]:
        """Yield a sentence if rows of the file of time ranges are of no recording."""
        if self.episodes.ranges is not None:
            yield from unknown_rows(self.episodes.ranges, keys)

    def problems_in(self, recipe: "Recipe") -> Iterator[tuple[tuple[str | int, ...], str]]:
        """Yield features whose source no rig has, and names that readers take for something else."""
        cameras = recipe.channels("camera")
        signals = sorted({name for rig in recipe.rigs for name in rig.signals})
        for name, feature in self.features.items():
            at = ("features", name)
            if (IMAGES in name) != (feature.camera is not None):
                yield at, f"cameras, and only they, have features called {IMAGES}s.NAME"
            if feature.camera is not None and feature.camera not in cameras:
                yield (
                    (*at, "camera"),
                    f"no rig has a camera {feature.camera}{suggestion(feature.camera, cameras)}",
                )
            for number, one in enumerate(feature.signals):
                if one not in signals:
                    yield (*at, "signals", number), f"no rig has a signal {one}{suggestion(one, signals)}"
            source = None if feature.next_of is None else self.features.get(feature.next_of)
            if feature.next_of is not None and (source is None or not source.signals):
                yield (*at, "next_of"), f"{feature.next_of} is not a feature of signals"
        if self.episodes.signal is not None and self.episodes.signal not in signals:
            known = suggestion(self.episodes.signal, signals)
            yield ("episodes", "signal"), f"no rig has a signal {self.episodes.signal}{known}"
