"""The checks of a finished nuScenes dataset."""

from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet

from bagassets.formats.format import DatasetCheck
from bagassets.formats.nuscenes import dataset_rules
from bagassets.formats.nuscenes.dataset_rows import DatasetRows, read_dataset
from bagassets.formats.nuscenes.devkit_rules import devkit_ready
from bagassets.quality.finding import Finding
from bagassets.recipe.model import NuScenes

__all__ = ["CHECKS", "check"]

_RULES: Mapping[DatasetCheck, Callable[[DatasetRows], Finding]] = {
    DatasetCheck(
        "dataset_references_intact",
        "references_intact",
        "Over all recordings, every token leads somewhere and chains are closed.",
    ): dataset_rules.references_intact,
    DatasetCheck(
        "dataset_tokens_unique",
        "tokens_unique",
        "Over all recordings, no token and no file name exists twice.",
    ): dataset_rules.tokens_unique,
    DatasetCheck(
        "dataset_files_match",
        "files_match",
        "The files below the dataroot are those that the tables name.",
    ): dataset_rules.files_match,
    DatasetCheck(
        "devkit_ready",
        "devkit_ready",
        "The dataset has what nuscenes-devkit and its users ask for: formats, units, maps, splits, layouts of files, all "
        "channels in every sample.",
    ): devkit_ready,
}
CHECKS = tuple(_RULES)


def check(settings: NuScenes, names: AbstractSet[str]) -> dict[str, Finding]:
    """Return check -> what it finds in the dataset on disk, of those that are named.

    Raises:
        DatasetError: a table is missing or cannot be read.
    """
    rows = read_dataset(settings.output, settings.version)
    return {one.name: rule(rows) for one, rule in _RULES.items() if one.name in names}
