"""The few errors that this package raises.

Every message is one or two sentences a user can act on: it names the file, topic or
field, says what was expected, and what to do. Only the command line turns an error into
an exit status; nothing in the library exits or prints.
"""

from typing import ClassVar

from bagassets.escaping import visible

__all__ = [
    "BagAssetsError",
    "CalibrationError",
    "ChangedWhileReadError",
    "DatasetError",
    "DecodeError",
    "LossLimitError",
    "MemoryShortageError",
    "PluginError",
    "PoseError",
    "RecipeError",
    "RecordingError",
    "SizeLimitError",
    "StoreError",
    "UnexpectedError",
]


class BagAssetsError(Exception):
    """Base of all errors raised on purpose; its text is meant for users.

    It is shown by terminals, the web UI and logs, and quotes what somebody recorded: names that hold line
    breaks or control characters are spelled out.

    Args:
        sentences: the text, a line for each.

    Attributes:
        transient: the error says nothing about what was asked for, which may succeed when tried again;
            it is not put on record.
    """

    transient: ClassVar[bool] = False

    def __init__(self, *sentences: str) -> None:
        super().__init__(*map(visible, sentences))

    def __str__(self) -> str:
        """Return the text."""
        return "\n".join(self.args)


class RecipeError(BagAssetsError):
    """A recipe is missing, malformed, or asks for something that cannot be."""


class PluginError(BagAssetsError):
    """A decoder plug-in clashes with another, cannot be loaded, or is not what it says."""


class RecordingError(BagAssetsError):
    """A recording cannot be opened or read."""


class SizeLimitError(RecordingError):
    """A recording asks for more memory than the recipe's `limits` allow."""


class ChangedWhileReadError(RecordingError):
    """A recording changed or vanished between the start and the end of a step that read it."""

    transient = True


class DecodeError(BagAssetsError):
    """One message cannot be decoded; steps count it as lost, up to the recipe's limit."""


class LossLimitError(BagAssetsError):
    """More messages were lost than the recipe allows, or counts do not add up."""


class CalibrationError(BagAssetsError):
    """Intrinsics or extrinsics that a configured channel needs are missing or implausible."""


class PoseError(BagAssetsError):
    """The configured pose source yields no usable trajectory."""


class StoreError(BagAssetsError):
    """The artifact store misses something, holds damaged bytes, or cannot be written."""

    transient = True


class MemoryShortageError(BagAssetsError):
    """A step ran out of memory; with fewer beside it, or on another machine, it may succeed."""

    transient = True


class UnexpectedError(BagAssetsError):
    """A step met what nobody thought of: a defect of ours, or damage of a new kind."""

    transient = True  # the code that mends it may leave the step's version alone


class DatasetError(BagAssetsError):
    """A dataset cannot be assembled from the artifacts at hand."""
