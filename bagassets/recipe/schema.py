"""The structure of the recipe model, and descriptions of its types for error messages and the recipe reference."""

import types
from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Literal, TypeGuard, Union, get_args, get_origin

from pydantic import BaseModel, Tag
from pydantic.fields import FieldInfo

from bagassets.base.json_types import Json
from bagassets.recipe.model_base import ChannelName, Quaternion, Slug, Transform, Vector3


def plain(annotation: object) -> object:
    """Return the type without `Annotated` and without `| None`."""
    while True:
        if get_origin(annotation) is Annotated:
            annotation = get_args(annotation)[0]
        elif _is_union(annotation) and type(None) in get_args(annotation):
            rest = [member for member in get_args(annotation) if member is not type(None)]
            if len(rest) != 1:
                return Union[tuple(rest)]  # noqa: UP007  built from a list
            annotation = rest[0]
        else:
            return annotation


def variants(annotation: object) -> dict[str, type[BaseModel]]:
    """Return tag -> model for a union with a tag field, or with tags that no recipe holds; {} for other types."""
    annotation = plain(annotation)
    if not _is_union(annotation):
        return {}
    tags = [_own_tag(member) for member in get_args(annotation)]
    if all(tags):
        return dict(zip(tags, _models_of(annotation), strict=True))
    tag = tag_field(annotation)
    models = _models_of(annotation) if tag else []
    return {get_args(model.model_fields[tag].annotation)[0]: model for model in models}


def tag_field(annotation: object) -> str:
    """Return the tag field of a union; "" for other types."""
    annotation = plain(annotation)
    if not _is_union(annotation):
        return ""
    models = _models_of(annotation)
    if len(models) < len(get_args(annotation)):
        return ""
    for name in models[0].model_fields:
        if all(is_tag(model.model_fields.get(name)) for model in models):
            return str(name)
    return ""


def enter(annotation: object, part: str | int) -> object:
    """Return the type at one part of a pydantic error location (field, key, index or tag), or None if there is none."""
    annotation = plain(annotation)
    if _is_model(annotation):
        field = annotation.model_fields.get(str(part))
        return None if field is None else field.annotation
    tagged = variants(annotation)
    if tagged:
        return tagged.get(str(part))
    arguments = get_args(annotation)
    if get_origin(annotation) is dict:
        return arguments[1]
    if get_origin(annotation) is tuple and isinstance(part, int):
        return arguments[0] if arguments[-1] is ... else arguments[min(part, len(arguments) - 1)]
    return None


def member_of(annotation: object, label: str | int) -> object:
    """Return the member of a union without tags that pydantic's label in an error location means; None for other types."""
    annotation = plain(annotation)
    if not _is_union(annotation) or variants(annotation):
        return None
    members = [plain(member) for member in get_args(annotation)]
    names = [getattr(get_origin(member) or member, "__name__", "") for member in members]
    # A type with a check has a label of its own; so has no more than one of them.
    return next(
        (one for one, name in zip(members, names, strict=True) if name == str(label).partition("[")[0]),
        members[0],
    )


def describe(annotation: object) -> str:
    """Describe a value of this type: `a number`, `a list of texts`."""
    for one in (annotation, plain(annotation)):
        for known, words in _NAMED:
            if one == known:
                return words
    annotation = plain(annotation)
    if get_origin(annotation) is Literal:
        return " or ".join(f"`{value}`" for value in get_args(annotation))
    if _is_model(annotation):
        keyed_by = getattr(annotation, "keyed_by", "")
        return f"a mapping with `{keyed_by}`" if keyed_by else "a mapping"
    if _is_union(annotation):
        members = variants(annotation).values() or get_args(annotation)
        return " or ".join(dict.fromkeys(describe(member) for member in members))
    if get_origin(annotation) is dict:
        return "a mapping"
    if get_origin(annotation) is tuple:
        arguments = get_args(annotation)
        if arguments[-1] is ...:
            return f"a list, each entry {describe(arguments[0])}"
        return f"a list of {len(arguments)}, each {describe(arguments[0])}"
    return "a value"


def limits(field: FieldInfo) -> str:
    """Return the bounds of a number, as in `> 0, <= 100`; "" without."""
    signs = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
    bounds = [
        f"{sign} {getattr(entry, name):g}"
        for entry in field.metadata
        for name, sign in signs
        if getattr(entry, name, None) is not None
    ]
    return ", ".join(bounds)


def models_in(annotation: object) -> Iterator[type[BaseModel]]:
    """Yield the models directly in a type, not those nested in them."""
    annotation = plain(annotation)
    if _is_model(annotation):
        yield annotation
        return
    for argument in get_args(annotation):
        yield from models_in(argument)


def closest(word: object, known: Iterable[str]) -> str:
    """Return the entry of `known` that `word` is probably a misspelling of; "" if none is close."""
    by_lower = {entry.lower(): entry for entry in known}
    near = get_close_matches(str(word).lower(), by_lower, n=1, cutoff=0.6)
    return by_lower[near[0]] if near else ""


def suggestion(value: Json, allowed: list[str]) -> str:
    """Return the end of a sentence about a wrong value; "" if it is no misspelling of an allowed one."""
    near = closest(value, allowed) if isinstance(value, str) else ""
    return f"; did you mean {near}?" if near else ""


_NAMED: tuple[tuple[object, str], ...] = (
    (Vector3, "a list of 3 numbers"),
    (Quaternion, "a list of 4 numbers"),
    (Slug, "a name"),
    (ChannelName, "a channel"),
    (str, "text"),
    (int, "a whole number"),
    (float, "a number"),
    (bool, "true or false"),
    (Path, "a path"),
    (Transform, "a transform"),
)


def _is_union(annotation: object) -> bool:
    return get_origin(annotation) in {Union, types.UnionType}


def _models_of(union: object) -> list[type[BaseModel]]:
    return [member for member in map(plain, get_args(union)) if _is_model(member)]


def _own_tag(member: object) -> str:
    """Return the `Tag` of a member of a union; "" if it has none."""
    metadata = get_args(member)[1:] if get_origin(member) is Annotated else ()
    return next((entry.tag for entry in metadata if isinstance(entry, Tag)), "")


def _is_model(annotation: object) -> TypeGuard[type[BaseModel]]:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def is_tag(field: FieldInfo | None) -> bool:
    """Tell whether a field can have one value only, and so tells models of a union apart."""
    return (
        field is not None and get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1
    )
