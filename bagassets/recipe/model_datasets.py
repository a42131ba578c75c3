"""The recipe section about nuScenes datasets of selected scenes."""

from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from bagassets.recipe.model_base import FieldValueError, Model, Slug

LatLon = tuple[float, float]


def moment_ns(text: str) -> int:
    """Return nanoseconds since 1970 of an ISO date (its start, UTC) or date and time (UTC without offset).

    Raises:
        ValueError: the text is neither.
    """
    try:
        moment = datetime.combine(date.fromisoformat(text), datetime.min.time())
    except ValueError:
        moment = datetime.fromisoformat(text)
    moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    return round(moment.timestamp()) * 1_000_000_000


def _moment(text: str) -> str:
    try:
        moment_ns(text)
    except ValueError:
        raise ValueError(
            "must be a date or a date with time, as in 2025-06-15 or 2025-06-15T14:30:00+02:00"
        ) from None
    return text


Moment = Annotated[str, AfterValidator(_moment)]


class NamedDataset(Model):
    """A nuScenes dataset of those scenes that meet all the given conditions.

    Its files are links; nothing is decoded again.
    """

    name: Slug = Field(description="Name of the dataset.")
    output: Path | None = Field(None, description="Dataroot; default: `dataset/NAME`.")
    version: Slug | None = Field(None, description="Version folder; default: that of `nuscenes`.")
    rigs: tuple[str, ...] = Field((), description="Names of rigs; default: any.")
    recordings: tuple[str, ...] = Field((), description="Globs of partition keys.")
    scenes: tuple[str, ...] = Field((), description="Globs of scene names, or names.")
    place: tuple[LatLon, ...] = Field(
        (),
        description="Polygon of latitude and longitude in degrees, which the trajectory of a scene enters.",
    )
    daylight: tuple[Literal["day", "twilight", "night"], ...] = Field(
        (), description="By the elevation of the sun at the beginning of the scene."
    )
    since: Moment | None = Field(None, description="Scenes begin at this date, or date and time, or later.")
    until: Moment | None = Field(None, description="Scenes begin before this date, or date and time.")
    labels: tuple[str, ...] = Field(
        (), description="Globs of categories, as in vehicle.*; a scene has a box of each at a keyframe."
    )
    min_speed_mps: float | None = Field(None, ge=0, description="Lowest mean speed of the scene.")

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if self.place and len(self.place) < 3:
            raise FieldValueError(
                ("place",), f"a polygon needs three corners or more; found {len(self.place)}"
            )
        for number, (lat, lon) in enumerate(self.place):
            if abs(lat) > 90 or abs(lon) > 180:
                raise FieldValueError(
                    ("place", number), f"({lat:g}, {lon:g}) is not a place on Earth; latitude comes first"
                )
        if self.since and self.until and moment_ns(self.since) >= moment_ns(self.until):
            raise FieldValueError(("until",), "must be later than since")
        return self

    @property
    def asset(self) -> str:
        """Name of its asset in Dagster, which takes letters, digits and '_' only."""
        return "dataset_" + "".join(c if c.isalnum() else "_" for c in self.name)
