"""Running known actions again, to check that they make the same bytes.

The store is not changed: new artifacts are made in a scratch folder and compared there.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from bagassets.base.errors import BagAssetsError
from bagassets.engine.execute import run_again
from bagassets.engine.graph import Graph, Node
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.recordings.digest import recording_stat, stored_digest
from bagassets.recordings.discover import discover
from bagassets.store.store import Outcome, Store


@dataclass(frozen=True, order=True)
class KnownAction:
    """A current action of a recording, and its artifact.

    Attributes:
        key: partition key of the recording.
        step: name of the step.
        channel: the channel, if the step has one.
        action: digest of the action.
        artifact: digest of the artifact that it made.
    """

    key: str
    step: str
    channel: str
    action: str
    artifact: str

    def __str__(self) -> str:
        channel = f" {self.channel}" if self.channel else ""
        return f"{self.step}{channel} of {self.key}"


@dataclass(frozen=True)
class Rebuilt:
    """The result of running an action again.

    Attributes:
        action: digest of the action.
        artifact: digest of the new artifact; None if the action failed.
        differing: files that differ from the stored artifact.
        error: why the action failed.
    """

    action: str
    artifact: str | None
    differing: tuple[str, ...] = ()
    error: str | None = None


def known_actions(assets: RecordingAssets) -> Iterator[KnownAction]:
    """Yield the actions that the store knows, of all recordings whose digest is on record."""
    for key, recording in discover(assets.recipe.bags).recordings.items():
        digest = stored_digest(recording, assets.index)
        if digest is None:
            continue
        for node in Graph(assets, recording, digest, recording_stat(recording)).nodes():
            outcome = node.outcome
            if outcome is not None:
                step, artifact = node.known_action.step, outcome.artifact.digest
                yield KnownAction(key, step, node.channel, outcome.action_digest, artifact)


def rebuild(
    assets: RecordingAssets, key: str, actions: Collection[str], scratch: Path, *, threads: int
) -> list[Rebuilt]:
    """Run actions of one recording again and compare the new artifacts with the stored ones.

    Args:
        assets: the assets of a recording under the recipe; the store, which knows the actions, is not changed.
        key: partition key of the recording.
        actions: digests of the actions.
        scratch: empty folder for the new artifacts.
        threads: number of threads that encode images.

    Raises:
        BagAssetsError: the recording is gone.
    """
    recipe = assets.recipe
    recording = discover(recipe.bags).recordings.get(key)
    if recording is None:
        raise BagAssetsError(f"{key}: no such recording below {recipe.bags.root}; it was removed meanwhile.")
    graph = Graph.of(assets, recording)
    known = {
        node.outcome.action_digest: node
        for node in graph.nodes()
        if node.outcome is not None and node.outcome.action_digest in actions
    }
    # In an empty store nothing was made before, so everything runs again.
    results = run_again(graph, list(known.values()), Store(scratch), threads=threads)
    rebuilt = {action: _compare(node, results[node.name]) for action, node in known.items()}
    gone = "it is not among the actions of this recording any more"
    return [rebuilt.get(action) or Rebuilt(action, None, error=gone) for action in sorted(actions)]


def _compare(node: Node, result: Outcome | BagAssetsError) -> Rebuilt:
    action = node.known_action.digest
    if isinstance(result, BagAssetsError):
        return Rebuilt(action, None, error=str(result))
    now, before = result.artifact, node.artifact
    if before is None or before.digest == now.digest:
        return Rebuilt(action, now.digest)
    old = {entry.path: entry.digest for entry in before.entries()}
    new = {entry.path: entry.digest for entry in now.entries()}
    names = sorted(name for name in old.keys() | new.keys() if old.get(name) != new.get(name))
    return Rebuilt(action, now.digest, tuple(names) or ("the summary",))
