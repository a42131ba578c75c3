"""Rows that exist once per dataset: category, attribute, visibility, sensor, map."""

from collections.abc import Iterable, Sequence

from bagassets.formats.nuscenes.tokens import (
    VISIBILITY_LEVELS,
    attribute_token,
    category_token,
    map_token,
    sensor_token,
    visibility_token,
)
from bagassets.json_types import JsonObject
from bagassets.recipe.model import NamedText

__all__ = ["MAP_FILE", "attribute_rows", "category_rows", "map_rows", "sensor_rows", "visibility_rows"]

MAP_FILE = "maps/blank.png"


def category_rows(named: Sequence[NamedText], met: Iterable[str]) -> list[JsonObject]:
    """Return the categories of the recipe, in its order, then others met in recordings, by name."""
    return [{"token": category_token(name), **row} for name, row in _named(named, met)]


def attribute_rows(named: Sequence[NamedText], met: Iterable[str]) -> list[JsonObject]:
    """Return the attributes of the recipe, in its order, then others met in recordings, by name."""
    return [{"token": attribute_token(name), **row} for name, row in _named(named, met)]


def visibility_rows() -> list[JsonObject]:
    """Return the four levels of visibility."""
    return [
        {
            "token": visibility_token(level),
            "level": level,
            "description": f"{level.removeprefix('v')} % of the object can be seen",
        }
        for level in VISIBILITY_LEVELS
    ]


def sensor_rows(sensors: Iterable[tuple[str, str]]) -> list[JsonObject]:
    """Return a row for each pair of channel and modality."""
    return [
        {"token": sensor_token(channel, modality), "channel": channel, "modality": modality}
        for channel, modality in sorted(set(sensors))
    ]


def map_rows(log_tokens: Iterable[str]) -> list[JsonObject]:
    """Return the one map; it holds for all logs, as the devkit asks for."""
    return [
        {
            "token": map_token(MAP_FILE),
            "log_tokens": sorted(log_tokens),
            "category": "semantic_prior",
            "filename": MAP_FILE,
        }
    ]


def _named(named: Sequence[NamedText], met: Iterable[str]) -> list[tuple[str, JsonObject]]:
    texts = {entry.name: entry.description for entry in named}
    names = [*texts, *sorted(set(met) - texts.keys())]
    return [(name, {"name": name, "description": texts.get(name, "")}) for name in names]
