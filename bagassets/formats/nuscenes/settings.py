"""The settings of the nuScenes format: the section `nuscenes` of a recipe."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field

from bagassets.recipe.model_base import DatasetSettings, Model, Slug

if TYPE_CHECKING:
    from bagassets.recipe.model import Recipe


class NamedText(Model):
    """A category or attribute with its description."""

    name: str = Field(description="Name, as in vehicle.car.")
    description: str = Field("", description="One sentence for people.")


class AttributesByMotion(Model):
    """Attributes for boxes whose source gives none: moving, stopped, parked, standing (`bagassets docs page annotations`)."""

    enabled: bool = Field(True, description="Give attributes by motion.")
    moving_mps: float = Field(0.5, gt=0, description="An object at least this fast is moving.")
    window_s: float = Field(
        1.0,
        gt=0,
        description="Speeds are measured over this time around the keyframe, or over at least half of it.",
    )
    parked_m: float = Field(
        1.0,
        gt=0,
        description="A vehicle is parked if it never moves in the recording and stays within this distance of "
        "where it is first seen; any other vehicle at rest is stopped.",
    )


class NuScenes(DatasetSettings):
    """The nuScenes dataset."""

    output: Path = Field(Path("dataset/nuscenes"), description="Dataroot.")
    version: Slug = Field("v1.0-custom", description="Version folder.")
    categories: tuple[NamedText, ...] = Field(
        (), description="Categories; others in the recordings are added."
    )
    attributes: tuple[NamedText, ...] = Field(
        (), description="Attributes; others in the recordings are added."
    )
    attributes_by_motion: AttributesByMotion = Field(
        AttributesByMotion(), description="Attributes for boxes whose source gives none."
    )

    @property
    def own_folder(self) -> str:
        """The version folder: versions may share a dataroot, as in nuScenes itself."""
        return self.version

    def problems_in(self, recipe: "Recipe") -> Iterator[tuple[tuple[str | int, ...], str]]:
        """Yield the categories and attributes that are listed before."""
        del recipe
        for field, entries in (("categories", self.categories), ("attributes", self.attributes)):
            names = [entry.name for entry in entries]
            for number, name in enumerate(names):
                if name in names[:number]:
                    yield (field, number, "name"), f"{name} is listed twice"
