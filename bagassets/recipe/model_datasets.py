"""What a recipe may say about further datasets: selections of scenes of the one store."""

from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from bagassets.recipe.model_base import FieldValueError, Model, Slug

__all__ = ["NamedDataset", "moment_ns"]

LatLon = tuple[float, float]


def moment_ns(text: str) -> int:
    """Return nanoseconds since 1970 of an ISO date (its first moment, UTC) or date and time (UTC if not said).

    Raises:
        ValueError: it is neither.
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
        msg = "must be a date or a date with time, as in 2025-06-15 or 2025-06-15T14:30:00+02:00"
        raise ValueError(msg) from None
    return text


Moment = Annotated[str, AfterValidator(_moment)]


class NamedDataset(Model):
    """A nuScenes dataset of some of the scenes: those that satisfy all conditions that are given.

    Files are links and nothing is decoded again.
    """

    name: Slug = Field(description="Name of the dataset.")
    output: Path | None = Field(None, description="Dataroot; default: `dataset/NAME`.")
    version: Slug | None = Field(None, description="Version folder; default: that of `nuscenes`.")
    rigs: tuple[str, ...] = Field((), description="Rigs that made the recording; default: any.")
    recordings: tuple[str, ...] = Field((), description="Globs of recordings (their partition keys).")
    scenes: tuple[str, ...] = Field((), description="Globs of scene names; with these, a list of scenes.")
    place: tuple[LatLon, ...] = Field(
        (), description="Polygon of latitude, longitude in degrees; the way of a scene enters it somewhere."
    )
    daylight: tuple[Literal["day", "twilight", "night"], ...] = Field(
        (), description="By the elevation of the sun where and when the scene begins."
    )
    since: Moment | None = Field(
        None, description="Date, or date and time, at which scenes begin at the earliest."
    )
    until: Moment | None = Field(None, description="Date, or date and time, before which scenes begin.")
    labels: tuple[str, ...] = Field(
        (), description="Globs of categories, as vehicle.*; the scene has a box of each at a keyframe."
    )
    min_speed_mps: float | None = Field(None, ge=0, description="Mean speed over the scene, at least.")

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if self.place and len(self.place) < 3:
            raise FieldValueError(
                ("place",), f"a polygon needs three corners or more; found {len(self.place)}"
            )
        for number, (lat, lon) in enumerate(self.place):
            if abs(lat) > 90 or abs(lon) > 180:
                raise FieldValueError(
                    ("place", number), f"({lat:g}, {lon:g}) is no place on Earth; latitude comes first"
                )
        if self.since and self.until and moment_ns(self.since) >= moment_ns(self.until):
            raise FieldValueError(("until",), "must be later than since")
        return self

    @property
    def asset(self) -> str:
        """Name of its asset in Dagster, which takes letters, digits and '_' only."""
        return "dataset_" + "".join(c if c.isalnum() else "_" for c in self.name)
