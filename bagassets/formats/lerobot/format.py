"""The LeRobot format, version 3.0.

Layout::

    v3.0/meta/info.json, stats.json, tasks.parquet, episodes/chunk-000/file-000.parquet, bagassets.json
    v3.0/data/chunk-000/file-000.parquet …
    v3.0/videos/observation.images.NAME/chunk-000/file-000.mp4 …
    v3.0/dataset.lock.json

The folder `v3.0` is the root of the dataset, and is swapped as a whole.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from bagassets.formats.format import Facts, Format, Kept
from bagassets.formats.lerobot.join import Join
from bagassets.formats.lerobot.metadata import VERSION
from bagassets.formats.lerobot.recording_part import LEROBOT_EPISODES
from bagassets.formats.lerobot.settings import LeRobot
from bagassets.recipe.format_settings import section_at
from bagassets.recipe.load import where_in
from bagassets.recipe.model import Recipe
from bagassets.store.canonical import canonical_json

_MOST_REASONS = 3


def misfits(facts: Mapping[str, Facts]) -> dict[str, str]:
    """Return the recordings whose features differ from those of most -> how, as a sentence.

    Args:
        facts: recording -> facts of its part.
    """
    kinds = {key: canonical_json(one["features"]) for key, one in sorted(facts.items()) if one["episodes"]}
    if len(set(kinds.values())) < 2:
        return {}
    usual = Counter(kinds.values()).most_common(1)[0][0]
    example = next(key for key, kind in kinds.items() if kind == usual)
    return {
        key: _difference(facts[key]["features"], example, facts[example]["features"])
        for key, kind in kinds.items()
        if kind != usual
    }


def _difference(features: Facts, example: str, usual: Facts) -> str:
    name = next(name for name in usual if features.get(name) != usual[name])
    own, other = features[name], usual[name]
    what = "shape" if own["shape"] != other["shape"] else "names"
    return (
        f"{name} has the {what} {_list(own[what])} from its first frame on, but {_list(other[what])} in most recordings, such as "
        f"{example}; a LeRobot dataset has one. Give its rig a dataset of its own, or correct the recipe."
    )


def _list(values: list[object]) -> str:
    return ", ".join(map(str, values))


def why_empty(facts: Sequence[Facts], recipe: Recipe, recipe_file: Path) -> str:
    """Return why no recording has an episode, as the end of a sentence."""
    whys = [one.get("why_none") or next((left["why"] for left in one["left_out"]), "") for one in facts]
    said = "; ".join(list(dict.fromkeys(filter(None, whys)))[:_MOST_REASONS])
    del recipe
    return f"{said} ({where_in(recipe_file, section_at(LEROBOT.name))})" if said else ""


LEROBOT = Format(
    name="lerobot",
    version=1,
    description=(
        "The LeRobot dataset, version 3.0: episodes of robots with their videos, joined from those of recordings without encoding "
        "anything again, swapped in atomically."
    ),
    kinds=frozenset({"video", "parquet", "json"}),
    settings=LeRobot,
    part=LEROBOT_EPISODES.name,
    assets=(LEROBOT_EPISODES,),
    join=lambda members, settings, shares, out: Join(members, settings, shares, out, Kept()).run(),
    rejoin=lambda members, settings, shares, out, kept: Join(members, settings, shares, out, kept).run(),
    misfits=misfits,
    links=lambda _: iter(()),
    counts=lambda facts: {"episodes": facts["episodes"]},
    duration_s=lambda facts: float(facts["duration_s"]),
    folder=lambda _: VERSION,
    why_empty=why_empty,
    fills_split=lambda facts: bool(facts["episodes"]),
)
