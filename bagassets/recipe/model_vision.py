"""What a recipe may say about the vision dataset."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from bagassets.recipe.model_base import ChannelName, DatasetSettings

__all__ = ["FramePair", "Vision"]


def _pair(text: str) -> str:
    sensor, colon, reference = (part.strip().lstrip("/") for part in text.partition(":"))
    if not (sensor and colon and reference) or ":" in reference:
        msg = "name two frames, as in CAM_FRONT:global"
        raise ValueError(msg)
    return f"{sensor}:{reference}"


FramePair = Annotated[str, AfterValidator(_pair)]


class Vision(DatasetSettings):
    """The vision dataset: image sequences in plain folders, each with its trajectory."""

    output: Path = Field(Path("dataset/vision"), description="Folder of the dataset.")
    cameras: tuple[ChannelName, ...] | None = Field(
        None, description="Cameras whose images make sequences; default: all of the rig."
    )
    frames: int = Field(25, ge=1, description="Images in a sequence.")
    stride: int = Field(1, ge=1, description="Take every n-th image only.")
    max_gap_s: float = Field(
        1.0, gt=0, description="A longer time between two images of a sequence breaks it."
    )
    trajectories: tuple[FramePair, ...] = Field(
        ("ego:global",),
        description="Pairs `sensor:reference` whose trajectories are written as CSV and Parquet. A frame is `ego`, "
        "`global`, a channel, or a frame of the calibration or of TF.",
    )
    files: Literal["per_split", "one"] = Field(
        "per_split",
        description="Merged files: one for each split (train.json, val.json), or a single all.json.",
    )
