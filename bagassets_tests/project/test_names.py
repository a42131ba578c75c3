"""The name of an asset or a format, as a string, stands in its own module or folder and in the catalogue, and nowhere else."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import bagassets
from bagassets.formats.catalogue import OUR_ASSETS, OURS

pytestmark = pytest.mark.once

ROOT = Path(bagassets.__file__).parent

# Words that mean something else: place -> why. Whoever adds a line has to say what else the word means there.
WORDS = {
    ("assets/boxes/files/find.py", "nuscenes"): "a format of label files",
    ("assets/quality/topic_rules.py", "annotations"): "what a topic of the recipe is for",
    ("cli/convert.py", "sweeps"): "what is counted",
    ("engine/differences.py", "calibration"): "the prefix of an input: a calibration file",
    ("formats/lerobot/groups.py", "frames"): "what is counted",
    ("formats/lerobot/join.py", "frames"): "what is counted",
    ("formats/lerobot/recording_part.py", "frames"): "what is counted",
    ("formats/lerobot/settings.py", "signals"): "a field of the recipe",
    ("formats/nuscenes/annotation_rows.py", "annotations"): "what is counted",
    ("formats/nuscenes/dataset_rows.py", "sweeps"): "a folder of nuScenes",
    ("formats/nuscenes/tokens.py", "sweeps"): "a folder of nuScenes",
    ("formats/nuscenes/format.py", "calibration"): "a part of a sample that `dataset diff` compares",
    ("formats/nuscenes/format.py", "sweeps"): "a folder of nuScenes",
    ("formats/nuscenes/tables.py", "annotations"): "what is counted",
    ("formats/nuscenes/tables.py", "sweeps"): "what is counted",
    ("formats/reader/dataset.py", "annotations"): "a folder of vision datasets",
    ("formats/reader/vision.py", "frames"): "a key of vision sequences",
    ("formats/vision/format.py", "annotations"): "a folder of vision datasets",
    ("formats/vision/recording_part.py", "frames"): "a key of vision sequences",
    ("propose/scan.py", "frames"): "coordinate frames",
    ("propose/sensors.py", "track"): "a word in the names of topics",
    ("recipe/consistency.py", "annotations"): "a field of the recipe",
    ("recipe/consistency.py", "preview"): "a field of the recipe",
    ("recipe/model_annotations.py", "nuscenes"): "a format of label files",
    ("recordings/describe.py", "frames"): "coordinate frames",
    ("sample/oddities.py", "annotations"): "a topic",
    ("sample/recipe.py", "nuscenes"): "a folder",
}
# Where a name of ours is meant, and stays for a reason.
NAMED = {}


def homes() -> dict[str, set[str]]:
    """Name of an asset or format -> the module or folder in which it may stand."""
    found: dict[str, set[str]] = {}
    for kind in OURS:
        module = f"formats/{kind.name}/"
        for name in (kind.name, kind.asset, *(asset.name for asset in kind.assets)):
            found.setdefault(name, set()).add(module)
        found[kind.name].add("recipe/format_settings.py")  # which lists the formats
    for asset in OUR_ASSETS:
        for one in (asset, *asset.along):
            found.setdefault(one.name, {f"assets/{one.name}.py"})
    return found


def strings(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.fixture(scope="module")
def places() -> set[tuple[str, str]]:
    """Where else names stand: module and name."""
    allowed = homes()
    return {
        (place, text)
        for path in ROOT.rglob("*.py")
        for place in [path.relative_to(ROOT).as_posix()]
        for text in strings(path)
        if text in allowed and not any(place.startswith(home) for home in allowed[text])
    }


def test_names_stand_in_their_own_modules(places):
    assert places - WORDS.keys() - NAMED.keys() == set()


def test_every_exception_is_one(places):
    assert (WORDS.keys() | NAMED.keys()) - places == set()
