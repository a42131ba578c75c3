"""The reference of all recipe fields as Markdown, rendered from the model itself."""

import json
from collections.abc import Iterator
from typing import get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined, to_jsonable_python

from bagassets.recipe.model import Recipe
from bagassets.recipe.schema import describe, is_tag, limits, models_in, plain, tag_field, variants

_INTRODUCTION = """\
# The recipe

<!-- Generated from bagassets/recipe/model.py by `bagassets docs recipe`; do not edit. -->

A recipe is one YAML file with everything that shapes a dataset. `bagassets init` proposes one for the recordings that it
finds; most recipes need only the fields without default. A complete small one:

```yaml
{example}```

Rules for all fields:

- Paths are relative to the recipe's folder. `~` and environment variables are not expanded, so that a recipe
  means the same for everybody.
- Globs are matched against the path of a recording below `bags.root`, with `/` between folders; `*` and `?`
  stay within a folder, `**` crosses folders. The path of a ROS 2 bag is that of its folder.
- Frames have no leading slash here, even if recordings write one.
- Transforms are `parent <- child`: they map coordinates in the child (sensor) frame to the parent (ego) frame. Lengths are
  in metres, quaternions are w, x, y, z.
- Unknown fields, fields given twice and values of the wrong type are errors, reported with their line.
- Changing a field makes only those assets stale that read it: a change of `scenes` extracts no image again.
"""

EXAMPLE = """\
name: courtyard
bags:
  root: /data/recordings
  include: ["2024/**"]
rigs:
  - name: van
    ego_frame: base_link
    ego_pose: {source: odometry, topic: /odom}
    channels:
      CAM_FRONT: {modality: camera, topic: /camera_front/image_raw}
      LIDAR_TOP: {modality: lidar, topic: /velodyne_points}
      RADAR_FRONT: {modality: radar, topic: /radar_front/points}
scenes: {length_s: 20, keyframe_hz: 2}
nuscenes: {output: dataset/nuscenes, version: v1.0-courtyard}
"""
"""An example; a test loads it."""


def render_reference() -> str:
    """Return the reference of every field of the recipe as Markdown."""
    parts = [_INTRODUCTION.format(example=EXAMPLE)]
    for model, paths in _sections():
        prose = " ".join((model.__doc__ or "").split())
        parts.append(f"\n## {_title(model, paths)}\n\n{prose}\n\n{_table(model)}")
    return "".join(parts)


def _sections() -> Iterator[tuple[type[BaseModel], list[str]]]:
    """Yield each model once, outer ones first, with the paths of all its fields in the recipe."""
    paths: dict[type[BaseModel], list[str]] = {Recipe: [""]}
    queue: list[type[BaseModel]] = [Recipe]
    for model in queue:
        for name, field in model.model_fields.items():
            for inner in models_in(field.annotation):
                if inner not in paths:
                    paths[inner] = []
                    queue.append(inner)
                prefix = paths[model][0]
                path = f"{prefix}.{name}" if prefix else name
                path += _suffix(field.annotation)
                if path not in paths[inner]:
                    paths[inner].append(path)
    for model in queue:
        yield model, paths[model]


def _suffix(annotation: object) -> str:
    origin, arguments = get_origin(plain(annotation)), get_args(plain(annotation))
    if origin is dict:
        return ".NAME"
    return "[]" if origin is tuple and arguments[-1] is ... else ""


def _title(model: type[BaseModel], paths: list[str]) -> str:
    if paths == [""]:
        return "Top level"
    keyed_by = getattr(model, "keyed_by", "")
    tags = [f"`{keyed_by}`"] if keyed_by else []
    tags += [
        f"`{name}: {get_args(field.annotation)[0]}`"
        for name, field in model.model_fields.items()
        if is_tag(field)
    ]
    return ", ".join(f"`{path}`" for path in paths) + (f" with {tags[0]}" if tags else "")


def _table(model: type[BaseModel]) -> str:
    rows = ["| field | value | default | meaning |", "|---|---|---|---|"]
    for name, field in model.model_fields.items():
        meaning = _cell(field.description or "Selects this kind.")
        rows.append(f"| `{name}` | {_value(field)} | {_default(field)} | {meaning} |")
    return "\n".join(rows) + "\n"


def _value(field: FieldInfo) -> str:
    annotation = plain(field.annotation)
    if get_origin(annotation) is dict:
        inner = get_args(annotation)[1]
        words = f"a mapping of names to {_options(inner) or describe(inner)}"
    else:
        words = _options(annotation) or describe(annotation)
    bounds = limits(field)
    return _cell(f"{words}, {bounds}" if bounds else words)


def _options(annotation: object) -> str:
    """Return the alternatives of a tagged union, as in `modality: camera` or …; "" for other types."""
    field = tag_field(annotation)
    options = [f"`{field}: {tag}`" for tag in variants(annotation)] if field else []
    return f"a mapping with {' or '.join(options)}" if options else ""


def _default(field: FieldInfo) -> str:
    if is_tag(field):
        return "required"  # the tag of a union: it has a default in Python only
    value = field.get_default(call_default_factory=True, validated_data={})
    if value is PydanticUndefined:
        return "required"
    if value is None or value == "":
        return ""
    if isinstance(value, BaseModel):
        return "see below"
    return f"`{_cell(json.dumps(to_jsonable_python(value), ensure_ascii=False).strip(chr(34)))}`"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
