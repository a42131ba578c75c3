"""Running known actions again, to see whether they make the same bytes.

The store stays as it is: what is made again goes to a scratch folder and is compared there.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

from bagassets.bags.digest import DigestIndex, recording_digest, recording_stat, stored_digest
from bagassets.bags.discover import discover
from bagassets.engine.recording_build import RecordingBuild
from bagassets.errors import BagAssetsError
from bagassets.recipe.model import Recipe
from bagassets.store.action import Action
from bagassets.store.artifact import Artifact
from bagassets.store.store import Outcome, Store

__all__ = ["KnownAction", "Rebuilt", "known_actions", "rebuild"]


@dataclass(frozen=True, order=True)
class KnownAction:
    """An action that the recordings of a recipe have now, and what it made.

    Attributes:
        key: partition key of the recording.
        step: name of the step.
        channel: the channel, if the step has one.
        action: digest of the action.
        artifact: digest of what it made.
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
    """What came of running an action again.

    Attributes:
        action: digest of the action.
        artifact: digest of what it made now; None if it failed.
        differing: files that are not as they were.
        error: why it failed.
    """

    action: str
    artifact: str | None
    differing: tuple[str, ...] = ()
    error: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON."""
        return {
            "action": self.action,
            "artifact": self.artifact,
            "differing": list(self.differing),
            "error": self.error,
        }


def known_actions(recipe: Recipe, store: Store) -> Iterator[KnownAction]:
    """Yield the actions of all recordings whose digest is on record and that the store knows."""
    index = DigestIndex(recipe.state)
    for key, found in discover(recipe.bags).found.items():
        digest = stored_digest(found, index)
        if digest is None:
            continue
        noting = _NotingStore(store.root)
        build = RecordingBuild(recipe, noting, found, digest, recording_stat(found), dry=True)
        try:
            for _ in build.build():
                pass
        except BagAssetsError:
            pass  # something is stale or failed; the others are known all the same
        for outcome, action in noting.noted.values():
            channel = str(action.params.get("channel", ""))
            yield KnownAction(key, action.step, channel, action.digest, outcome.artifact.digest)


def rebuild(
    recipe: Recipe, store: Store, key: str, actions: Collection[str], scratch: Path, *, workers: int
) -> list[Rebuilt]:
    """Run actions of one recording again and compare what they make with what they made.

    Args:
        recipe: the recipe.
        store: the store that knows the actions; it is not changed.
        key: partition key of the recording.
        actions: their digests.
        scratch: empty folder for what is made.
        workers: threads that encode images.

    Raises:
        BagAssetsError: the recording is not there any more.
    """
    found = discover(recipe.bags).found.get(key)
    if found is None:
        raise BagAssetsError(f"{key}: no such recording below {recipe.bags.root}; it was removed meanwhile.")
    stat = recording_stat(found)
    digest = recording_digest(found, DigestIndex(recipe.state)).digest
    forgetful = _ForgetfulStore(store.root, frozenset(actions), scratch)
    error = "it is not among the actions of this recording any more"
    try:
        for _ in RecordingBuild(recipe, forgetful, found, digest, stat, workers=workers).build():
            pass
    except BagAssetsError as err:
        error = str(err)
    return [
        forgetful.again.get(action) or Rebuilt(action, None, error=forgetful.failures.get(action, error))
        for action in sorted(actions)
    ]


class _NotingStore(Store):
    """A store that notes what it was asked for and knew."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.noted: dict[str, tuple[Outcome, Action]] = {}

    def lookup(self, action: Action) -> Outcome | None:
        known = super().lookup(action)
        if known is not None:
            self.noted[action.digest] = (known, action)
        return known


class _ForgetfulStore(Store):
    """A store that does not know some actions, and compares what they make with what they made before."""

    def __init__(self, root: Path, forgotten: frozenset[str], scratch: Path) -> None:
        super().__init__(root)
        self.again: dict[str, Rebuilt] = {}
        self.failures: dict[str, str] = {}
        self._forgotten = forgotten
        self._scratch = scratch

    def use(self, action: Action) -> Outcome | None:
        return self.lookup(action)

    def lookup(self, action: Action) -> Outcome | None:
        if action.digest in self._forgotten and action.digest not in self.again:
            return None
        known = super().lookup(action)
        if known is None:
            raise BagAssetsError(
                f"step {action.step}: action {action.digest[:16]} is not known, because what it reads came out different."
            )
        return known

    def make_temporary_folder(self) -> Path:
        folder = self._scratch / uuid4().hex
        folder.mkdir(parents=True)
        return folder

    def adopt(self, folder: Path, digest: str) -> Artifact:
        return Artifact(digest, folder)

    def record(self, action: Action, artifact: Artifact, seconds: float) -> None:  # noqa: ARG002  (as declared)
        before = super().lookup(action)
        differing = () if before is None else _differing(before.artifact, artifact)
        self.again[action.digest] = Rebuilt(action.digest, artifact.digest, differing)

    def record_failure(self, action: Action, error: str, subject: Path | None = None) -> None:  # noqa: ARG002  (as declared)
        self.failures[action.digest] = error


def _differing(before: Artifact, now: Artifact) -> tuple[str, ...]:
    if before.digest == now.digest:
        return ()
    old = {entry.path: entry.digest for entry in before.entries()}
    new = {entry.path: entry.digest for entry in now.entries()}
    names = sorted(name for name in old.keys() | new.keys() if old.get(name) != new.get(name))
    return tuple(names) or ("the summary",)
