"""The settings of the vision format: the section `vision` of a recipe."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from bagassets.base.json_types import Json
from bagassets.recipe.model_base import ChannelName, DatasetSettings
from bagassets.recipe.schema import suggestion

if TYPE_CHECKING:
    from bagassets.recipe.model import Recipe


def _pair(text: str) -> str:
    sensor, colon, reference = (part.strip().lstrip("/") for part in text.partition(":"))
    if not (sensor and colon and reference) or ":" in reference:
        raise ValueError("name two frames, as in CAM_FRONT:global")
    return f"{sensor}:{reference}"


FramePair = Annotated[str, AfterValidator(_pair)]


class Vision(DatasetSettings):
    """The vision dataset: image sequences in plain folders, each with its trajectory."""

    without_poses: ClassVar[str] = "`trajectories` without `global`, such as `trajectories: []`"

    output: Path = Field(Path("dataset/vision"), description="Folder of the dataset.")
    cameras: tuple[ChannelName, ...] | None = Field(
        None, description="Cameras with sequences; default: all cameras of the rig."
    )
    frames: int = Field(25, ge=1, description="Images per sequence.")
    stride: int = Field(1, ge=1, description="Use only every n-th image.")
    max_gap_s: float = Field(
        1.0, gt=0, description="Longest time between two consecutive images of a sequence."
    )
    trajectories: tuple[FramePair, ...] = Field(
        ("ego:global",),
        description="Pairs `sensor:reference` whose trajectories are written as CSV and Parquet. A frame is `ego`, "
        "`global`, a channel, or a frame in the calibration or in TF.",
    )
    files: Literal["per_split", "one"] = Field(
        "per_split",
        description="Merged files: one per split (train.json, val.json), or a single all.json.",
    )

    @classmethod
    def asks_for_poses(cls, section: Json) -> bool:
        """Return whether a trajectory is in the global frame, where only ego poses say what is."""
        given = section.get("trajectories") if isinstance(section, Mapping) else None
        pairs = given if isinstance(given, list) else cls.model_fields["trajectories"].default
        return any("global" in str(pair).replace(" ", "").split(":") for pair in pairs)

    def problems_in(self, recipe: "Recipe") -> Iterator[tuple[tuple[str | int, ...], str]]:
        """Yield the cameras that no rig has."""
        cameras = recipe.channels("camera")
        for number, name in enumerate(self.cameras or ()):
            if name not in cameras:
                yield ("cameras", number), f"no rig has a camera {name}{suggestion(name, cameras)}"
