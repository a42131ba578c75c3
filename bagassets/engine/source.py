"""Where the messages of a step come from: the inventory's pack, or the recording itself."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bagassets.base.errors import BagAssetsError
from bagassets.engine.reading import followed
from bagassets.recipe.model import Limits
from bagassets.recordings.digest import RecordingStat, assert_unchanged
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.model import OnRead, RecordingFiles
from bagassets.recordings.open import open_recording
from bagassets.recordings.pack import PackedRecording
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import Artifact

__all__ = ["MessageSource"]


@dataclass(frozen=True)
class MessageSource:
    """Opens just the topics that a step declared, from the cheapest place that has them.

    Attributes:
        files: those of the recording.
        stat: sizes and times of its files when its digest was taken.
        message_definitions: folders of `.msg` files.
        limits: limits on the memory that reading may take.
        on_read: called with how far reading has come; see `open_recording`.
        what: what the whole recording is read for, for those who wait.
    """

    files: RecordingFiles
    stat: RecordingStat
    message_definitions: Sequence[Path]
    limits: Limits
    on_read: OnRead | None = None
    what: str = "images and clouds"

    def verify_unchanged(self) -> None:
        """Check that the recording is still the one that was digested.

        Raises:
            ChangedWhileReadError: it has changed; what was read from it must not be recorded.
        """
        assert_unchanged(self.files, self.stat)

    @contextmanager
    def whole(self, inventory: Inventory | None = None) -> Iterator[Recording]:
        """Open the whole recording, and check before and after that it did not change.

        Args:
            inventory: has the definitions for topics that lack one in the recording; None to look for them.
        """
        self.verify_unchanged()
        on_read = followed(self.files, self.what, self.on_read)
        try:
            with open_recording(self.files, self.message_definitions, self.limits, on_read) as recording:
                if inventory is not None:
                    for name, topic in recording.topics.items():
                        if name in inventory.topics:
                            topic.assume(inventory.topics[name].definition)
                yield recording
        except BagAssetsError:
            self.verify_unchanged()  # if it changed, that is the cause to report
            raise
        self.verify_unchanged()

    @contextmanager
    def topics(self, names: Sequence[str], inventory: Inventory, packed: Artifact) -> Iterator[Recording]:
        """Open only `names`, from the pack in the inventory artifact if it has them all."""
        if inventory.unpacked(names):
            with self.whole(inventory) as recording:
                yield recording.restrict(names)
        else:
            with PackedRecording(
                packed.read_json("inventory.json"), packed.path("messages.parquet"), self.limits
            ) as recording:
                yield recording.restrict(names)
