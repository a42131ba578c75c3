"""What commands end with; `docs/operations.md` has the table for users."""

from enum import IntEnum


class ExitStatus(IntEnum):
    """How a command ended if not with 0."""

    FAILED = 1
    """An error that the user can fix, or a recording or dataset that failed."""
    UNDECIDED = 2
    """Something is to be decided first; for wrong usage, click ends with the same."""
    FOUND = 3
    """A check has findings: damage, a difference, something to do."""
    CRASHED = 70
    """A defect of this program."""
    INTERRUPTED = 130
