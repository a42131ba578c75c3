"""The recipe section about splits."""

from typing import Self

from pydantic import Field, model_validator

from bagassets.recipe.model_base import FieldValueError, Model, Slug


class Splits(Model):
    """How recordings are dealt to train, val and other splits, for all datasets alike.

    Only the set of recordings decides, not their order; no split is empty if there are at least as many recordings as
    splits. In small sets a new recording may move another one, which the build and `build --check` report and `pinned`
    prevents; in large ones a hash of the key decides. Shares of recordings are met approximately, shares of driven time
    less closely. In `splits.json`, train and val are called custom_train and custom_val, because nuscenes-devkit
    answers the plain names with the scenes of nuScenes.
    """

    shares: dict[Slug, float] = Field(
        default_factory=lambda: {"train": 0.8, "val": 0.2},
        description="Split -> share of the recordings; shares add up to 1.",
    )
    seed: int = Field(0, description="Another seed deals all recordings differently.")
    pinned: dict[str, Slug] = Field(
        default_factory=dict,
        description="Partition key -> split of the recording; `pin` is another name of this field.",
    )

    @model_validator(mode="before")
    @classmethod
    def _pin(cls, value: object) -> object:
        if isinstance(value, dict) and "pin" in value:
            if "pinned" in value:
                raise FieldValueError(("pin",), "is the same as pinned; give one of them")
            return {"pinned" if name == "pin" else name: content for name, content in value.items()}
        return value

    @model_validator(mode="after")
    def _shares(self) -> Self:
        total = sum(self.shares.values())
        if not self.shares or min(self.shares.values()) < 0 or abs(total - 1.0) > 1e-6:
            raise FieldValueError(
                ("shares",), f"shares must not be negative and must add up to 1; they add up to {total:g}"
            )
        for key, split in self.pinned.items():
            if split not in self.shares:
                raise FieldValueError(
                    ("pinned", key),
                    f"{split} is not a split; shares has {', '.join(self.shares)} (a share may be 0)",
                )
        return self
