"""A plain sequential conversion: the same code without a store, digests, Dagster and pictures.

What others call a converter: one process reads one recording after the other and writes the dataset. Files go to a
scratch folder beside the dataset and are linked into it; nothing is hashed, looked up or recorded. (Tokens of
nuScenes rows are hashes of names; they stay, as a dataset needs tokens.) Run as a file by other benchmarks::

    BENCH_RECIPE=recipe.yaml python benchmarks/plain.py RECORDINGS OUTPUT
"""

import itertools
import os
import sys
import tempfile
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

# Those that are run as files find the package beside them.
sys.path.insert(0, str(Path(__file__).parents[1]))

from bagassets.recipe import load_recipe
from bagassets.store.action import Action
from bagassets.store.artifact import Artifact
from bagassets.store.store import Outcome, Store

__all__ = ["Scratch", "Unhashed", "convert_plainly", "plain_command"]

_numbers = itertools.count(1)


class Unhashed:
    """Stands for a hasher; its digests are running numbers, so what was named by content has a name all the same."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self._number = next(_numbers)

    def update(self, _data: Any) -> None:
        """Take data and do nothing with it."""

    def digest(self, length: int = 32) -> bytes:
        """Return the number as so many bytes."""
        return self._number.to_bytes(32, "big")[-length:]

    def hexdigest(self) -> str:
        """Return the number as 64 hex digits."""
        return self.digest().hex()


class Scratch(Store):
    """A folder in the place of a store: nothing is known there, and nothing is recorded."""

    def lookup(self, action: Action) -> Outcome | None:
        """Return None."""

    def use(self, action: Action) -> Outcome | None:
        """Return None."""

    def lock(self, action: Action) -> AbstractContextManager[None]:  # noqa: ARG002  (as in Store)
        """Lock nothing."""
        return nullcontext()

    def record(self, action: Action, artifact: Artifact, seconds: float) -> None:
        """Do nothing."""

    def record_failure(self, action: Action, error: str, subject: Path | None = None) -> None:
        """Do nothing."""

    def failure(self, action_digest: str, subject: Path | None = None) -> str | None:
        """Return None."""


def plain_command(bags: Path, out: Path) -> list[str]:
    """Return a command that converts all recordings in `bags`; the variable BENCH_RECIPE names the recipe."""
    return [sys.executable, str(Path(__file__).absolute()), str(bags), str(out)]


def convert_plainly(recipe_file: Path, bags: Path, out: Path) -> None:
    """Convert recordings one after the other. No hasher of this process sees content from then on."""
    import bagassets.assets.topic_log
    import bagassets.formats.groups
    import bagassets.formats.json_files
    import bagassets.store.artifact
    from bagassets.engine.execute import Skipped, execute
    from bagassets.engine.graph import Graph
    from bagassets.formats.assembly import assemble
    from bagassets.formats.catalogue import recording_assets
    from bagassets.formats.format import Part
    from bagassets.formats.nuscenes.format import NUSCENES
    from bagassets.formats.nuscenes.settings import NuScenes
    from bagassets.recordings.digest import recording_stat
    from bagassets.recordings.discover import discover

    bagassets.assets.topic_log.blake3 = Unhashed  # type: ignore[assignment,attr-defined]
    bagassets.formats.groups.blake3 = Unhashed  # type: ignore[assignment,attr-defined]
    bagassets.formats.json_files.digest_bytes = lambda _data: Unhashed().hexdigest()  # type: ignore[assignment,attr-defined]
    bagassets.store.artifact.digest_bytes = lambda _data: Unhashed().hexdigest()  # type: ignore[assignment,attr-defined]
    recipe = load_recipe(recipe_file)
    assets, parts = recording_assets(recipe), []
    wanted = frozenset(assets.names) - {"preview"}
    with tempfile.TemporaryDirectory(dir=out.parent) as folder:
        assets.store = store = Scratch(Path(folder))
        recordings = discover(recipe.bags.model_copy(update={"root": bags})).recordings
        for key, recording in recordings.items():
            graph = Graph(assets, recording, key, recording_stat(recording), wanted=wanted)
            made = {result.asset: result for result in execute(graph) if not isinstance(result, Skipped)}
            parts.append(Part(key, key, made["nuscenes_tables"].artifact.digest))
        assemble(NUSCENES, parts, recipe.settings(NuScenes) or NuScenes(), store, out, splits=recipe.splits)


if __name__ == "__main__":
    convert_plainly(Path(os.environ["BENCH_RECIPE"]), Path(sys.argv[1]), Path(sys.argv[2]))
