"""Recipe section `signals` of a rig: series of numbers from the fields of messages."""

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from bagassets.recipe.model_base import Clock, FieldValueError, Model, TopicName, matching, not_empty

STAMP = "stamp_ns"
"""The column of a signal's table that is no element."""

FACTORS = {
    ("deg", "rad"): 0.017453292519943295,  # π / 180
    ("rad", "deg"): 57.29577951308232,
    ("mm", "m"): 1e-3,
    ("m", "mm"): 1e3,
}
"""Recorded unit, unit of the signal -> what recorded values are multiplied by."""

_NAME = "must consist of letters, digits and '_', and not start with a digit, as in arm_state"
SignalName = Annotated[str, matching(r"[A-Za-z_][A-Za-z0-9_]*", _NAME)]
_PART = r"[A-Za-z_]\w*(\[\d{1,6}\])*"
_PATH = "must be the path of a field, as in `position`, `pose.position` or `axes[2]`"
_FieldPath = Annotated[str, matching(rf"{_PART}(\.{_PART})*", _PATH)]
_ElementName = Annotated[str, AfterValidator(not_empty)]


class Signal(Model):
    """A series of numbers: a field of the messages of a topic, or several, as columns of a table."""

    topic: TopicName = Field(description="Topic with the messages.")
    field: _FieldPath | Annotated[tuple[_FieldPath, ...], Field(min_length=1)] = Field(
        description="Path of the field in its messages, or a list of paths: a number, an array, or a message that holds numbers "
        "only, such as `position`, `pose.position`, `axes[2]`.",
    )
    names: tuple[_ElementName, ...] = Field(
        (),
        description="Elements in order. If the messages name them (`name`, `names`, `joint_names`), as JointState does, these are "
        "picked, whatever their order there; else the elements are called so. Default: all, as the first message has them.",
    )
    unit: str | None = Field(None, description="Unit of the values, kept with the series; any text.")
    recorded_unit: str | None = Field(
        None,
        description="Unit in the messages, if it is another one: `deg` for `unit: rad`, `mm` for `m`, or the reverse.",
    )
    clock: Clock | None = Field(
        None,
        description="Time of the values: the stamps of the messages, or when they were logged, which those without a header need; default: "
        "that of the rig.",
    )

    @property
    def fields(self) -> tuple[str, ...]:
        """The paths of its fields."""
        return (self.field,) if isinstance(self.field, str) else self.field

    @property
    def factor(self) -> float:
        """What recorded values are multiplied by."""
        if self.recorded_unit is None or self.recorded_unit == self.unit:
            return 1.0
        return FACTORS[self.recorded_unit, self.unit or ""]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for field, values in (("field", self.fields), ("names", self.names)):
            for number, one in enumerate(values):
                if one in values[:number]:
                    raise FieldValueError((field, number), f"{one} is listed twice")
                if one == STAMP:
                    raise FieldValueError((field, number), f"{STAMP} is the column of the stamps")
        if self.recorded_unit not in {None, self.unit} and (self.recorded_unit, self.unit) not in FACTORS:
            known = ", ".join(f"{recorded} to {unit}" for recorded, unit in FACTORS)
            raise FieldValueError(
                ("recorded_unit",),
                f"{self.recorded_unit} cannot be converted to {self.unit or 'no unit'}; possible are {known}",
            )
        return self
