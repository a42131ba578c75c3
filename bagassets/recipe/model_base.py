"""Shared parts of the recipe model: strict base models, names, transforms."""

import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

if TYPE_CHECKING:
    from bagassets.base.json_types import Json
    from bagassets.recipe.model import Recipe

Clock = Literal["header", "log"]
Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class FieldValueError(ValueError):
    """A check across fields failed; `at` is the path from the checked mapping to the wrong field."""

    def __init__(self, at: tuple[str | int, ...], problem: str) -> None:
        super().__init__(problem)
        self.at = at


def matching(pattern: str, problem: str) -> AfterValidator:
    """Return what refuses a text that does not match a pattern as a whole."""

    def check(name: str) -> str:
        if not re.fullmatch(pattern, name):
            raise ValueError(problem)
        return name

    return AfterValidator(check)


def _frame_name(name: str) -> str:
    """Return a frame without leading slash; recordings write it with or without."""
    return not_empty(name.lstrip("/"))


def not_empty(text: str) -> str:
    """Return a text; refuse it if there is none."""
    if not text.strip():
        raise ValueError("must not be empty")
    return text


_SLUG = "must consist of letters, digits, '-', '_' and '.', and not start with '-' or '.'"
Slug = Annotated[str, matching(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", _SLUG)]
_CHANNEL = "a channel's name has capitals, digits and '_' only, as in CAM_FRONT"
ChannelName = Annotated[str, matching(r"[A-Z][A-Z0-9_]*", _CHANNEL)]
CameraName = Annotated[str, AfterValidator(not_empty)]
FrameName = Annotated[str, AfterValidator(_frame_name)]
TopicName = Annotated[str, AfterValidator(not_empty)]


class Model(BaseModel):
    """Base of all recipe parts: immutable, and an unknown field is an error.

    Attributes:
        keyed_by: for one of two models that a field takes: its required field that the other one lacks.
    """

    keyed_by: ClassVar[str] = ""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class DatasetSettings(Model):
    """Base of sections for the dataset of one format.

    Attributes:
        without_poses: what to set in the section so that rigs need no ego poses; "" if nothing helps.
        needs_mounts: whether it matters where sensors are; if to no dataset, rigs need no extrinsics.
    """

    without_poses: ClassVar[str] = ""
    needs_mounts: ClassVar[bool] = True

    output: Path = Field(description="Folder of the dataset.")

    @classmethod
    def asks_for_poses(cls, section: "Json") -> bool:
        """Return whether a section, as plain data that need not be valid, asks for the ego poses of all rigs; default: yes."""
        del section
        return True

    def with_absolute_paths(self, folder: Path) -> Self:
        """Return the settings with paths relative to `folder` made absolute."""
        return self.model_copy(update={"output": (folder / self.output).resolve()})

    @property
    def files_read(self) -> tuple[Path, ...]:
        """Files that the section names and that the parts of recordings are made from."""
        return ()

    @property
    def own_folder(self) -> str | None:
        """Name of the one folder in `output` that is this dataset's alone, if other datasets may share the output."""
        return None

    def doubts(self, keys: Collection[str]) -> Iterator[str]:
        """Yield sentences about what files that it reads say of recordings other than these, which are all there are."""
        del keys
        yield from ()

    def problems_in(self, recipe: "Recipe") -> Iterator[tuple[tuple[str | int, ...], str]]:
        """Yield what a recipe, otherwise valid, cannot ask of this format: where in the section, and a sentence without full stop."""
        del recipe
        yield from ()


class Transform(Model):
    """A rigid transform given by hand, `parent <- child`."""

    translation: Vector3 = Field((0.0, 0.0, 0.0), description="x, y, z in metres.")
    rotation: Quaternion = Field((1.0, 0.0, 0.0, 0.0), description="Unit quaternion w, x, y, z.")

    @model_validator(mode="after")
    def _unit(self) -> Self:
        norm = sum(q * q for q in self.rotation) ** 0.5
        if abs(norm - 1.0) > 1e-3:
            raise FieldValueError(
                ("rotation",), f"must be a unit quaternion w, x, y, z; its length is {norm:.4f}"
            )
        return self
