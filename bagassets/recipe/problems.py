"""Explaining pydantic's errors, which are about models, unions and tags, to somebody who writes YAML."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, get_args

from pydantic import BaseModel

from bagassets.base.errors import PluginError
from bagassets.base.json_types import Json, JsonMapping, JsonObject
from bagassets.recipe.format_settings import asked_formats, section_model
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_base import FieldValueError, Transform
from bagassets.recipe.schema import (
    closest,
    describe,
    enter,
    member_of,
    plain,
    suggestion,
    tag_field,
    variants,
)

Problem = tuple[tuple[str | int, ...], str]
"""A location in the recipe (field names, keys, indices), and what is wrong there, without full stop."""

_BOUNDS = {
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must not be smaller than {ge:g}",
    "less_than": "must be smaller than {lt:g}",
    "less_than_equal": "must not be greater than {le:g}",
}
_KINDS: Mapping[type, str] = {dict: "a mapping", list: "a list", str: "text"}
_NO_RIG = "; `bagassets init` found none: describe one, or have it look into other recordings with --bags and --force"


def explain_all(errors: Iterable[Mapping[str, Any]], data: Json) -> list[Problem]:
    """Return the problems behind entries of `ValidationError.errors()`; of a union, those of the member that a value fits."""
    return [explain(error, data) for error in errors if not _fits_another_member(error, data)]


def _fits_another_member(error: Mapping[str, Any], data: Json) -> bool:
    at, annotation = _locate(error["loc"][:-1])
    kind = _KINDS.get(type(value_at(data, at)), "-")
    if not error["type"].endswith(("_type", "literal_error")) or not member_of(annotation, error["loc"][-1]):
        return False
    return any(describe(member).startswith(kind) for member in get_args(plain(annotation)))


def explain(error: Mapping[str, Any], data: Json) -> Problem:
    """Return the problem behind one entry of `ValidationError.errors()`.

    Args:
        error: the entry.
        data: the whole recipe as plain data.
    """
    location, kind = error["loc"], error["type"]
    if kind == "missing" and isinstance(location[-1], int):
        location, kind = location[:-1], "too_short"  # pydantic blames the absent entry of a vector
    if location and member_of(_locate(location[:-1])[1], location[-1]) is not None:
        location = location[:-1]
    at, annotation = _locate(location)
    context, value = error.get("ctx", {}), value_at(data, at)
    if kind == "extra_forbidden" and _model(location) is Transform and "file" in value_at(data, at[:-1]):
        return at[:-1], (
            "only a camera's extrinsics can come from a file; give the `translation` and `rotation` of this sensor, or "
            "name a `urdf` of the rig"
        )
    if kind == "extra_forbidden":
        return at, _unknown_field(str(at[-1]), _model(location), value_at(data, at[:-1]))
    if kind == "missing":
        required = ": ".join(filter(None, ["this field is required", _purpose(location)]))
        return at, required if at else "the recipe is empty"
    if kind in {"union_tag_not_found", "union_tag_invalid"}:
        return _tag(at, annotation, value)
    if kind == "value_error":
        cause = context.get("error")
        if isinstance(cause, FieldValueError):
            return (*at, *cause.at), str(cause)
        return at, f"{cause}; found {_show(value)}" if not isinstance(value, dict) else str(cause)
    if kind in _BOUNDS:
        return at, f"{_BOUNDS[kind].format(**context)}; found {_show(value)}"
    if kind in {"too_short", "too_long"} and value in ([], {}):
        return at, "must have at least one entry"
    if kind == "too_short" and "min_length" in context:
        return at, f"must have at least {context['min_length']} entries; found {_show(value)}"
    if kind == "finite_number":
        return at, f"must be a finite number; found {_show(value)}"
    if value is None and kind != "literal_error":
        wanted = _purpose(location) or describe(annotation)
        return at, f"needs a value: {wanted}{_NO_RIG if at == ('rigs',) else ''}"
    if kind == "literal_error" and member_of(annotation, "") is None:
        allowed = [str(option) for option in get_args(plain(annotation))]
        return at, f"must be {_either(allowed)}; found {_show(value)}{suggestion(value, allowed)}"
    return at, f"expected {describe(annotation)}; found {_show(value)}{_quoting(annotation, value)}"


def undecided(data: JsonMapping) -> Iterator[Problem]:
    """Yield the fields without value that nothing else in the recipe can answer: so `bagassets init` asks for them.

    Args:
        data: the whole recipe as plain data, which need not be valid.
    """
    rigs = data.get("rigs")
    for number, rig in enumerate(rigs if isinstance(rigs, list) else ()):
        if not isinstance(rig, dict):
            continue
        if rig.get("ego_pose") is None:
            at = ("rigs", number, "ego_pose")
            why = "needs a value" if "ego_pose" in rig else _who_asks_for_poses(data)
            if why:
                yield at, f"{why}: {_purpose(at)}"
        channels = rig.get("channels")
        for name, channel in channels.items() if isinstance(channels, dict) else ():
            if not isinstance(channel, dict):
                continue
            if channel.get("velocities", "") is None:
                yield (
                    ("rigs", number, "channels", name, "velocities"),
                    "needs a value: relative or over_ground; or remove the field to keep velocities as recorded",
                )
            if not (rig.get("urdf") or channel.get("frame")) and channel.get("extrinsics", "") is None:
                yield (
                    ("rigs", number, "channels", name, "extrinsics"),
                    "needs a value: transform `ego <- sensor`; or name a `urdf` of the rig, or remove the field if TF has it",
                )


def _who_asks_for_poses(data: JsonMapping) -> str:
    """Return the beginning of a sentence that says for which formats each rig needs poses; "" if for none."""
    asking = []
    for name, section in asked_formats(data).items():
        with suppress(PluginError):
            model = section_model(name)
            if model is not None and model.asks_for_poses(section):
                unless = model.without_poses and f" (unless it has {model.without_poses})"
                asking.append(f"{name}{unless}")
    return f"this field is required by {' and '.join(asking)}" if asking else ""


def open_questions(problems: Iterable[Problem], data: JsonMapping) -> dict[int, list[Problem]]:
    """Return number of a rig -> its problems, if all problems only await an answer and some rig has none.

    A rig without poses is one, and so are extrinsics without value. With any other problem, or without a rig that
    could be built, the result is empty.

    Args:
        problems: all problems of the recipe.
        data: the recipe as plain data.
    """
    questions: dict[int, list[Problem]] = {}
    unanswered = {at for at, _ in undecided(data)}
    for at, sentence in problems:
        if at not in unanswered:
            return {}
        questions.setdefault(int(at[1]), []).append((at, sentence))
    return questions if len(questions) < len(data["rigs"]) else {}


def with_stand_ins(data: JsonMapping, rigs: Collection[int]) -> JsonObject:
    """Return the recipe as plain data in which rigs without poses have some, so that the rest can be read."""
    stand_in = {"source": "odometry", "topic": "to be decided"}
    return {
        **data,
        "rigs": [
            {**rig, "ego_pose": stand_in} if number in rigs and rig.get("ego_pose") is None else rig
            for number, rig in enumerate(data["rigs"])
        ],
    }


def _locate(location: tuple[str | int, ...]) -> tuple[tuple[str | int, ...], object]:
    """Return a location without pydantic's union tags and key markers, and the type there."""
    at: list[str | int] = []
    annotation: object = Recipe
    for part in location:
        if (member := member_of(annotation, part)) is not None:
            annotation = member
        elif variants(annotation) and part in variants(annotation):
            annotation = enter(annotation, part)
        elif part != "[key]":
            annotation = enter(annotation, part)
            at.append(part)
        if len(at) == 2 and at[0] == "formats":
            annotation = section_model(str(at[1]))
    return tuple(at), annotation


def _model(location: tuple[str | int, ...]) -> type[BaseModel] | None:
    """Return the model that holds the last part of a location."""
    owner = plain(_locate(location[:-1])[1])
    return owner if isinstance(owner, type) and issubclass(owner, BaseModel) else None


def _purpose(location: tuple[str | int, ...]) -> str:
    model = _model(location)
    field = None if model is None else model.model_fields.get(str(location[-1]))
    text = "" if field is None or field.description is None else field.description.removesuffix(".")
    return text[:1].lower() + text[1:] if text[1:2].islower() else text


def _unknown_field(name: str, model: type[BaseModel] | None, present: Json) -> str:
    known = [] if model is None else list(model.model_fields)
    free = [field for field in known if not isinstance(present, dict) or field not in present]
    near = closest(name, free)
    if near:
        return f"no such field here; did you mean {near}? `bagassets docs recipe` lists all fields"
    return f"no such field here; the fields are {', '.join(known)}. `bagassets docs recipe` explains them"


def _tag(at: tuple[str | int, ...], annotation: object, value: Json) -> Problem:
    tag, allowed = tag_field(annotation), list(variants(annotation))
    if not isinstance(value, dict) or tag not in value:
        return (*at, tag), f"this field is required; it is {_either(allowed)}"
    given = value[tag]
    return (*at, tag), f"must be {_either(allowed)}; found {_show(given)}{suggestion(given, allowed)}"


def _quoting(annotation: object, value: Json) -> str:
    if plain(annotation) is str and isinstance(value, bool | int | float):
        return "; put it in quotes if it is meant as text"
    if plain(annotation) in {int, float} and isinstance(value, str):
        try:
            float(value)
        except ValueError:
            return ""
        return "; write it without quotes"
    return ""


def _either(options: list[str]) -> str:
    return options[0] if len(options) == 1 else f"{', '.join(options[:-1])} or {options[-1]}"


def _show(value: Json) -> str:
    match value:
        case None:
            return "no value"
        case bool():
            return "true" if value else "false"
        case int() | float():
            return f"the number {value!r}"
        case str():
            return repr(value) if len(value) <= 60 else repr(value[:57] + "...")
        case list():
            return f"a list of {len(value)}" if value else "an empty list"
        case _:
            return "a mapping"


def value_at(data: Json, location: tuple[str | int, ...]) -> Json:
    """Return what stands at a location in plain data; None if nothing does."""
    for part in location:
        if isinstance(data, list):
            data = data[part] if isinstance(part, int) and part < len(data) else None
        else:
            data = data.get(part) if isinstance(data, dict) else None
    return data
