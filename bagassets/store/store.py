"""The store on disk: artifacts, and the records of actions that made them.

Layout::

    artifacts/<2 hex>/<digest>/manifest.json, files/…
    actions/<2 hex>/<digest>.json           the artifact that an action produced
    actions/<2 hex>/<digest>.failed.json    the error it ended with
    tmp/                                    artifacts that are being made
    underway/<digest>.lock                  the lease of the process that makes it, by another name
    store.id                                by which machines know whether they see the same store (`identity`)

Everything appears by an atomic rename or link, so processes and machines may share a store.
"""

import errno
import json
import os
import re
import socket
import time
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from bagassets.base import files
from bagassets.base.errors import StoreError
from bagassets.base.files import create_atomically, write_atomically
from bagassets.base.json_types import Json, JsonObject
from bagassets.store.action import Action
from bagassets.store.artifact import MANIFEST, Artifact, ArtifactWriter, writing
from bagassets.store.lease import action_lock

# Errors of a file system where a folder of that name exists and is not empty.
_TAKEN = {errno.ENOTEMPTY, errno.EEXIST}
_ATTEMPTS = 5
# Stands for the path of the recording in recorded errors: actions depend on its content, not on its name.
_SUBJECT = "<recording>"


@dataclass(frozen=True)
class Outcome:
    """The outcome of an action.

    Attributes:
        artifact: the artifact that it produced.
        action_digest: digest of the action.
        cached: True if the store had it already.
        seconds: time that the action took when it ran.
    """

    artifact: Artifact
    action_digest: str
    cached: bool
    seconds: float


class Pending:
    """A running action: write into `out`, then `commit` or `discard`."""

    def __init__(self, store: "Store", action: Action) -> None:
        self.action = action
        self._store = store
        self._folder = store.make_temporary_folder()
        self._started = time.perf_counter()
        self.out = ArtifactWriter(self._folder)

    def commit(self, summary: JsonObject) -> Outcome:
        """Put the artifact in place and record the action."""
        seconds = time.perf_counter() - self._started
        try:
            digest = self.out.finish(summary)
            artifact = self._store.adopt(self._folder, digest)
        except BaseException:
            self.discard()
            raise
        self._store.record(self.action, artifact, seconds)
        return Outcome(artifact, self.action.digest, cached=False, seconds=seconds)

    def discard(self) -> None:
        """Remove what was written."""
        files.remove_all(self._folder)


class Store:
    """An artifact store in a folder; cheap to construct, safe for several processes."""

    def __init__(self, root: Path) -> None:
        self.root = root

    # --- artifacts -------------------------------------------------------------------

    def artifact(self, digest: str) -> Artifact:
        """Return an artifact by its digest.

        Raises:
            StoreError: it is not in the store.
        """
        artifact = Artifact(digest, self.artifact_folder(digest))
        if not os.path.isfile(f"{artifact.folder}/{MANIFEST}"):  # noqa: PTH113  (a third of the time)
            raise StoreError(
                f"artifact {digest[:16]} is not in the store {self.root}; materialize the asset that makes it again."
            )
        return artifact

    def has(self, digest: str) -> bool:
        """Return whether an artifact is in the store (by its manifest; `verify` checks the bytes)."""
        return (self.artifact_folder(digest) / MANIFEST).is_file()

    def make_temporary_folder(self) -> Path:
        """Create an empty folder on the store's file system."""
        folder = self.root / "tmp" / f"{socket.gethostname()}-{os.getpid()}-{uuid4().hex}"
        try:
            files.make_folder(folder, new=True)
        except OSError as err:
            raise StoreError(f"{folder}: the store cannot be written ({err.strerror}).") from err
        return folder

    def adopt(self, folder: Path, digest: str) -> Artifact:
        """Move a finished temporary folder to its place; the first one wins."""
        target = self.artifact_folder(digest)
        with writing(target, "the artifact cannot be put in place"):
            self._move_in(folder, target, digest)
        return Artifact(digest, target)

    def _move_in(self, folder: Path, target: Path, digest: str) -> None:
        for _ in range(_ATTEMPTS):
            files.make_folder(target.parent)
            try:
                files.move(folder, target)
            except OSError as err:
                if err.errno not in _TAKEN:
                    raise
                if self.is_complete(digest):
                    # If the garbage collector removes it now, the next attempt moves in.
                    with suppress(FileNotFoundError):
                        # Seen by the collector, but not by those who ask whether the artifact is as it was.
                        files.mark(target)
                        files.remove_all(folder)
                        return
                else:
                    self.remove(digest)  # it is damaged
            else:
                return
        raise FileExistsError(errno.EEXIST, "other processes keep writing a damaged one", str(target))

    def remove(self, digest: str) -> None:
        """Remove an artifact at once, such as a damaged one; the actions that made it will run again."""
        retired = self.make_temporary_folder() / digest
        with suppress(FileNotFoundError):
            files.move(self.artifact_folder(digest), retired)
        files.remove_all(retired.parent)

    # --- actions ---------------------------------------------------------------------

    def lookup(self, action: Action) -> Outcome | None:
        """Return the outcome of an action if it is recorded and its artifact exists.

        Raises:
            StoreError: the store cannot be read.
        """
        path = self._action_file(action.digest)
        try:
            record = json.loads(path.read_bytes())
            digest, seconds = record["artifact"], record["seconds"]
        except FileNotFoundError:
            return None
        except (ValueError, KeyError):
            files.remove(path)  # torn by a power loss
            return None
        except OSError as err:
            raise StoreError(
                f"{path}: the store cannot be read ({err.strerror}); check the disk, and state in the recipe."
            ) from err
        if not self.has(digest):
            return None
        return Outcome(
            Artifact(digest, self.artifact_folder(digest)), action.digest, cached=True, seconds=seconds
        )

    def use(self, action: Action) -> Outcome | None:
        """Return the outcome of an action, as `lookup` does, and mark it as used.

        The garbage collector spares what was marked during a running build, or in the last days.
        """
        known = self.lookup(action)
        if known is None:
            return None
        try:
            files.mark(self._action_file(action.digest))
        except FileNotFoundError:
            return None  # it is garbage that is being removed right now
        except OSError:
            pass  # nothing is collected from a read-only store
        return known

    def is_complete(self, digest: str) -> bool:
        """Return whether every file of an artifact exists with its size; the bytes are not read."""
        artifact = Artifact(digest, self.artifact_folder(digest))
        try:
            return all(artifact.path(entry.path).stat().st_size == entry.size for entry in artifact.entries())
        except (StoreError, OSError, KeyError, TypeError):
            return False

    def action(self, digest: str) -> JsonObject | None:
        """Return a recorded action, whether it succeeded or failed, as JSON; None if there is no record."""
        files = (self._action_file(digest), self._failure_file(digest))
        actions = (_recorded(file, "action") for file in files)
        return next((action for action in actions if action is not None), None)

    def seconds(self, action_digest: str) -> float:
        """Return the time that a recorded action took; 0 if there is no record."""
        return float(_recorded(self._action_file(action_digest), "seconds") or 0.0)

    def forget(self, action_digest: str) -> None:
        """Remove the records of an action, so that it runs again."""
        for path in (self._action_file(action_digest), self._failure_file(action_digest)):
            files.remove(path)

    def begin(self, action: Action) -> Pending:
        """Start an action; the caller commits or discards it."""
        return Pending(self, action)

    def lock(self, action: Action) -> AbstractContextManager[None]:
        """Keep other processes from running the same action; see `action_lock`."""
        return action_lock(self.root, action.digest)

    def record(self, action: Action, artifact: Artifact, seconds: float) -> None:
        """Record that `action` produced `artifact`; the first writer wins.

        Raises:
            StoreError: the record cannot be written, or the action is recorded with another artifact, so the step is not
                deterministic.
        """
        path = self._action_file(action.digest)
        content = {"action": action.as_json(), "artifact": artifact.digest, "seconds": round(seconds, 3),
                   "host": socket.gethostname()}  # fmt: skip
        with writing(path):
            created = create_atomically(path, _json(content))
        files.remove(self._failure_file(action.digest))
        if not created:
            recorded = _recorded(path, "artifact")
            if recorded == artifact.digest:
                return
            if recorded is not None and self.has(recorded):
                raise StoreError(
                    f"step {action.step} is not deterministic: action {action.digest[:16]} made artifact "
                    f"{recorded[:16]} before and {artifact.digest[:16]} now; please report this."
                )
            files.remove(path)  # its artifact is gone, or a power loss tore it
            self.record(action, artifact, seconds)

    def failure(self, action_digest: str, subject: Path | None = None) -> str | None:
        """Return the recorded error of an action, with the path of `subject` filled in; see `record_failure`."""
        text = _recorded(self._failure_file(action_digest), "error")
        return text if text is None or subject is None else str(text).replace(_SUBJECT, str(subject))

    def record_failure(self, action: Action, error: str, subject: Path | None = None) -> None:
        """Record that `action` failed; the newest error is kept. If that is not possible, the action will run again.

        Args:
            action: the action that failed.
            error: the error message.
            subject: the recording. Its path is not recorded: the same content may have another name later.
        """
        if subject is not None:
            # Not where the path is only the beginning of another: a.bag and a.bag.json, drive and drive-2.
            whole = re.escape(str(subject)) + r"(?![\w-]|\.\w)"
            error = re.sub(whole, _SUBJECT, error)
        path = self._failure_file(action.digest)
        content = {"action": action.as_json(), "error": error}
        with suppress(OSError):
            write_atomically(path, _json(content), folders=True)

    # --- places ----------------------------------------------------------------------

    def artifact_folder(self, digest: str) -> Path:
        """Return the folder of an artifact, whether it exists or not."""
        # One text is parsed faster than several are joined, and a plan asks for many places.
        return Path(f"{self.root}/artifacts/{digest[:2]}/{digest}")

    def _action_file(self, digest: str) -> Path:
        return Path(f"{self.root}/actions/{digest[:2]}/{digest}.json")

    def _failure_file(self, digest: str) -> Path:
        return Path(f"{self.root}/actions/{digest[:2]}/{digest}.failed.json")


def _recorded(path: Path, field: str) -> Json:
    """Return a field of a record; None if there is no such record, or it cannot be read."""
    try:
        return json.loads(path.read_bytes())[field]
    except (OSError, ValueError, KeyError):
        return None


def _json(record: JsonObject) -> bytes:
    return json.dumps(record, sort_keys=True).encode()
