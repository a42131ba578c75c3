"""Changes of a recipe, generated from its model: a field that is new is changed without anybody thinking of it."""

import types
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError

from bagassets.recipe.model import Recipe
from bagassets.recipe.model_base import ChannelName

OTHER = "_other"
# What some field of text may hold: words, a topic, a network address, two frames, dates.
TEXTS = (
    "other",
    "OTHER",
    "/other",
    "10.1.1.20",
    "10.1.1.20:3000",
    "base_link:lane",
    "2020-01-01",
    "2030-01-01",
)
NUMBERS = (0.25, 0.75, 1.5, 5.0, 40.0, 700.0, 20_000.0, 2_000_000.0)


@dataclass(frozen=True)
class Change:
    """A recipe that differs from another one in one place.

    Attributes:
        field: the field that was changed, as `Class.field`; for a list or mapping the one that holds it.
        name: what was done, for people.
        recipe: the changed recipe.
    """

    field: str
    name: str
    recipe: Recipe


def changes(recipe: Recipe, sections: Collection[str] | None = None) -> Iterator[Change]:
    """Yield the recipe with one field changed: other values, None, reordered, renamed, added, left out.

    Args:
        recipe: the recipe.
        sections: fields of the recipe in which, or in whose parts, something is changed; default: all.
    """
    before = recipe.model_dump(mode="python")
    seen = {repr(before)}
    for field, data in _of_model(Recipe, before, sections):
        text = repr(data)
        if text in seen:
            continue
        seen.add(text)
        try:
            # A section that is left out is None, but cannot be said to be.
            changed = Recipe.model_validate(
                {name: value for name, value in data.items() if value is not None}
            )
        except ValidationError:
            continue  # fields that only go together
        yield Change(field, f"{field}: {_difference(before, data)}", changed)


def all_fields(model: type[BaseModel] = Recipe) -> set[str]:
    """Return every field of a model and of those below it that can be changed in itself, as `Class.field`.

    One that is always the same kind of model is changed by the fields of that.
    """
    names: set[str] = set()
    todo, seen = [model], set()
    while todo:
        owner = todo.pop()
        if owner in seen:
            continue
        seen.add(owner)
        for name, info in owner.model_fields.items():
            if not _is_tag(info.annotation) and not _is_model(info.annotation):
                names.add(f"{owner.__name__}.{name}")
            todo += _models_in(info.annotation)
    return names


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if _is_model(annotation):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _is_tag(annotation: Any) -> bool:
    """Tell whether a field only says of which kind its model is."""
    return get_origin(annotation) is Literal and len(get_args(annotation)) == 1


def _difference(before: Any, after: Any) -> str:
    """Return where two trees of data differ, and how."""
    if isinstance(before, dict) and isinstance(after, dict) and list(before) == list(after):
        for name in before:
            if repr(before[name]) != repr(after[name]):
                return f"{name}.{_difference(before[name], after[name])}"
    if isinstance(before, tuple | list) and isinstance(after, tuple | list) and len(before) == len(after):
        differing = [
            at for at, pair in enumerate(zip(before, after, strict=True)) if repr(pair[0]) != repr(pair[1])
        ]
        if len(differing) == 1:
            return f"{differing[0]}.{_difference(before[differing[0]], after[differing[0]])}"
    if isinstance(before, dict) and isinstance(after, dict):
        return f"{list(before)} -> {list(after)}"
    return f"{str(before)[:60]} -> {str(after)[:60]}"


def _of_model(
    model: type[BaseModel], data: dict[str, Any], only: Collection[str] | None = None
) -> Iterator[tuple[str, dict[str, Any]]]:
    for name, info in model.model_fields.items():
        if _is_tag(info.annotation) or (only is not None and name not in only):
            continue
        annotation = Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation
        if info.default is None and _is_model(info.annotation):  # a section of a format
            annotation |= None
        for field, value in _others(annotation, data[name]):
            yield field or f"{model.__name__}.{name}", {**data, name: value}


def _others(annotation: Any, value: Any) -> Iterator[tuple[str | None, Any]]:
    """Yield other values of a type, each with the field below that differs; None where the value itself does."""
    bare = _bare(annotation)
    origin = get_origin(bare)
    if origin in (Union, types.UnionType):
        yield from _of_union(bare, value)
    elif _is_model(bare):
        yield from _of_model(bare, value)
    elif origin is tuple and get_args(bare)[-1] is Ellipsis:
        yield from _of_list(get_args(bare)[0], value)
    elif origin is tuple:
        yield None, value[::-1]
        for at, (part, item) in enumerate(zip(get_args(bare), value, strict=True)):
            for field, other in _others(part, item):
                yield field, (*value[:at], other, *value[at + 1 :])
    elif origin is dict:
        yield from _of_mapping(*get_args(bare), value)
    else:
        for other in _scalars(annotation, value):
            yield None, other


def _of_union(bare: Any, value: Any) -> Iterator[tuple[str | None, Any]]:
    members = list(_members(bare))
    if value is not None and type(None) in members:
        yield None, None
    for member in members:
        if member is type(None):
            continue
        if value is not None and _is_of(member, value):
            yield from _others(member, value)
            continue
        for example in _examples(member):
            common = {}
            if isinstance(example, dict) and isinstance(value, dict):
                fields = _bare(member).model_fields
                common = {
                    name: v
                    for name, v in value.items()
                    if name in fields and not _is_tag(fields[name].annotation)
                }
            yield None, {**example, **common} if isinstance(example, dict) else example


def _members(bare: Any) -> Iterator[Any]:
    """Yield the members of a union, and those of unions among them."""
    for member in get_args(bare):
        if get_origin(_bare(member)) in (Union, types.UnionType):
            yield from _members(_bare(member))
        else:
            yield member


def _is_of(member: Any, value: Any) -> bool:
    bare = _bare(member)
    if _is_model(bare) and isinstance(value, dict):
        tags = {
            name: get_args(info.annotation)[0]
            for name, info in bare.model_fields.items()
            if _is_tag(info.annotation)
        }
        if not tags:  # which of two models it is shows by what it has
            return value.keys() == bare.model_fields.keys()
        return all(value.get(name) == tag for name, tag in tags.items())
    return _holds(member, value)


def _of_list(part: Any, value: tuple[Any, ...]) -> Iterator[tuple[str | None, Any]]:
    if len(value) > 1:
        yield None, value[::-1]
    if value:
        yield None, value[1:]
        yield None, value[:-1]
    # One more: like one that is there, but for the first of its fields, which often is its name.
    more = [other for _, other in _others(part, value[0])][:3] if value else list(_examples(part))
    for other in more:
        yield None, (*value, other)
        if value:
            yield None, (other, *value)
    for at, item in enumerate(value):
        for field, other in _others(part, item):
            yield field, (*value[:at], other, *value[at + 1 :])


def _of_mapping(key: Any, part: Any, value: dict[str, Any]) -> Iterator[tuple[str | None, Any]]:
    if len(value) > 1:
        yield None, dict(reversed(value.items()))
    for name in value:
        yield None, {other: item for other, item in value.items() if other != name}
    for name, item in value.items():
        for other in _scalars(key, name):
            if other in value:
                continue
            yield None, {other if old == name else old: kept for old, kept in value.items()}
            yield None, {**value, other: item}
            yield None, {other: item, **value}
    if not value:
        for name in _examples(key):
            for example in _examples(part):
                yield None, {name: example}
    for name, item in value.items():
        for field, other in _others(part, item):
            yield field, {**value, name: other}


def _scalars(annotation: Any, value: Any) -> list[Any]:
    """Return other values of a plain type."""
    bare = _bare(annotation)
    if get_origin(bare) is Literal:
        return [option for option in get_args(bare) if option != value]
    if bare is bool:
        return [not value]
    if bare is Any:
        return [{**value, "more": True}]
    if bare is Path:
        return [value.parent / "other" / value.name, value.with_name(f"{value.stem}{OTHER}{value.suffix}")]
    if bare is str:
        near = [f"{value}{OTHER}", f"{value}{OTHER.upper()}"]
        if annotation == ChannelName:
            near += ["CAM_BACK", "LIDAR_TOP"]
            return [text for text in near if text != value and _holds(annotation, text)]
        return [text for text in (*near, *TEXTS) if text != value and _holds(annotation, text)][:1]
    if bare in (int, float):
        near = [value * 2, value / 2, value + 1, value - 1, *NUMBERS]
        fit = [bare(number) for number in near]
        return [number for number in fit if number != value and _holds(annotation, number)][:1]
    if bare is Any:
        return [{**value, "output": f"{value.get('output', '')}{OTHER}"}]
    raise TypeError(f"{annotation} is a type for which no other values are known here: add it")


def _examples(annotation: Any) -> Iterator[Any]:
    """Yield values of a type, from nothing."""
    bare = _bare(annotation)
    origin = get_origin(bare)
    if _is_model(bare):
        yield from _models(bare)
    elif origin in (Union, types.UnionType):
        for member in get_args(bare):
            yield from [None] if member is type(None) else _examples(member)
    elif origin is tuple and get_args(bare)[-1] is Ellipsis:
        for example in _examples(get_args(bare)[0]):
            yield (example,)
    elif origin is tuple:
        yield tuple(float(at + 1) for at in range(len(get_args(bare))))
    elif origin is dict:
        key, part = get_args(bare)
        yield {next(_examples(key)): next(_examples(part))}
    elif bare is Path:
        yield Path("/other")
    elif annotation == ChannelName:
        yield from ("CAM_BACK", "LIDAR_TOP")
    elif bare is str:
        yield from [text for text in TEXTS if _holds(annotation, text)][:2]
    elif bare is bool:
        yield from (True, False)
    elif bare in (int, float):
        yield from [bare(number) for number in NUMBERS if _holds(annotation, bare(number))][:1]
    elif origin is Literal:
        yield from get_args(bare)
    elif bare is Any:  # what only a package knows the fields of
        yield {"output": "elsewhere"}
    else:
        raise TypeError(f"{annotation} is a type for which no values are known here: add it")


def _models(model: type[BaseModel]) -> Iterator[dict[str, Any]]:
    """Yield the model with what it must have; if that is nothing, with each of its fields."""
    data: dict[str, Any] = {}
    for name, info in model.model_fields.items():
        annotation = Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation
        if info.is_required():
            data[name] = next(_examples(annotation))
        elif _is_tag(info.annotation):
            data[name] = info.default
    for candidate in (data, *({**data, name: example} for name, info in model.model_fields.items()
                              if name not in data for example in _examples(info.annotation))):  # fmt: skip
        try:
            yield model.model_validate(candidate).model_dump(mode="python")
        except ValidationError:
            continue
        return


def _bare(annotation: Any) -> Any:
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return annotation


@cache
def _adapter(annotation: Any) -> TypeAdapter[Any]:
    return TypeAdapter(annotation)


def _holds(annotation: Any, value: Any) -> bool:
    try:
        return bool(_adapter(annotation).validate_python(value, strict=True) == value)
    except ValidationError:
        return False
