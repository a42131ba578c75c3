"""The few errors that this package raises.

Every message is one or two sentences that a user can act on: it names the file, topic or
field, and says what was expected and what to do. Only the command line turns an error into
an exit status; nothing in the library exits or prints.
"""

from typing import ClassVar

from bagassets.base.escaping import visible


def kind_and_text(err: BaseException) -> str:
    """Return the type of an error that was not raised for users, and the first line of its text, if there is any."""
    lines = str(err).strip().splitlines()
    return f"{type(err).__name__}: {lines[0]}" if lines else type(err).__name__


class BagAssetsError(Exception):
    """Base of all errors raised on purpose; its message is meant for users.

    It is shown in terminals, the web UI and logs, and may quote names from recordings: line breaks and control
    characters in them are escaped.

    Args:
        sentences: the message, one line per sentence.

    Attributes:
        transient: True if the action is not to blame and may succeed when run again, so the error is not
            recorded.
    """

    transient: ClassVar[bool] = False

    def __init__(self, *sentences: str) -> None:
        super().__init__(*map(visible, sentences))

    def __str__(self) -> str:
        """Return the message."""
        return "\n".join(self.args)


class RecipeError(BagAssetsError):
    """A recipe is missing, malformed, or asks for something impossible."""


class SelectionError(BagAssetsError):
    """A user named a recording or asset that does not exist."""


class PluginError(BagAssetsError):
    """A plug-in clashes with another, cannot be loaded, or is not of the announced kind."""


class RecordingError(BagAssetsError):
    """A recording cannot be opened or read."""


class SizeLimitError(RecordingError):
    """A recording asks for more memory than the recipe's `limits` allow."""


class ChangedWhileReadError(RecordingError):
    """A recording changed or vanished between the start and the end of a step that read it."""

    transient = True


class ScratchError(RecordingError):
    """A recording cannot be read for lack of temporary disk space."""

    transient = True


class DiskError(RecordingError):
    """A recording cannot be read since its disk, or the way to it, fails; that says nothing of the recording."""

    transient = True


class DecodeError(BagAssetsError):
    """One message cannot be decoded; steps count it as lost, up to the recipe's limit."""


class UnsetError(DecodeError):
    """A message whose sender did not know yet what to put into it, as most nodes do not when they start."""


class LossLimitError(BagAssetsError):
    """More messages were lost than the recipe allows, or counts do not add up."""


class CalibrationError(BagAssetsError):
    """Intrinsics or extrinsics that a configured channel needs are missing or implausible."""


class PoseError(BagAssetsError):
    """The configured pose source yields no usable trajectory."""


class StoreError(BagAssetsError):
    """The artifact store lacks something, has damaged bytes, or cannot be written."""

    transient = True


class MemoryShortageError(BagAssetsError):
    """A step ran out of memory; with fewer others running, or on another machine, it may succeed."""

    transient = True


class UnexpectedError(BagAssetsError):
    """A step failed unexpectedly: through a bug of ours, or a new kind of damage."""

    transient = True  # a fix may leave the step's version unchanged


class DatasetError(BagAssetsError):
    """A dataset cannot be assembled from its artifacts."""


class RunEndedError(BagAssetsError):
    """A run was given up while its worker was at work; that worker must record nothing more."""

    transient = True
