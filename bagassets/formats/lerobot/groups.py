"""Groups of episodes that share a file: which ones do depends on the episodes near them only.

A file ends after an episode whose name says so by its hash, so that one more episode touches the file it enters, or
splits that in two, wherever it stands in the order; all others hold the same episodes as before. What comes out too long
between two such ends, as one in a hundred does, is cut further where hashes are smallest: only there may an episode change
a second file.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from blake3 import blake3


@dataclass(frozen=True)
class Unit:
    """An episode as far as groups are concerned.

    Attributes:
        name: its recording and its number in it.
        frames: number of frames.
        size: bytes.
        header: what all of a file must have in common.
    """

    name: str
    frames: int
    size: int
    header: str = ""


@dataclass(frozen=True)
class Limits:
    """How large files become.

    Attributes:
        usual_frames, usual_size: what they have on average, whichever comes first.
        most_frames, most_size: what they have at most, unless one episode alone has more bytes.
    """

    usual_frames: int
    usual_size: int
    most_frames: int
    most_size: int


def grouped(units: Sequence[Unit], limits: Limits) -> list[range]:
    """Return the indices of the episodes of each file, in order."""
    ends = [number + 1 for number, unit in enumerate(units[:-1]) if _ends(units, number, limits)]
    runs = [range(*pair) for pair in zip([0, *ends], [*ends, len(units)], strict=True)] if units else []
    return [piece for run in runs for piece in _pieces(units, run, limits)]


def _chance(unit: Unit) -> int:
    return int.from_bytes(blake3(unit.name.encode()).digest(8), "big")


def _ends(units: Sequence[Unit], number: int, limits: Limits) -> bool:
    unit = units[number]
    share = max(unit.frames / limits.usual_frames, unit.size / limits.usual_size)
    return unit.header != units[number + 1].header or _chance(unit) < share * 2**64


def _pieces(units: Sequence[Unit], run: range, limits: Limits) -> list[range]:
    frames, size = (sum(getattr(units[number], what) for number in run) for what in ("frames", "size"))
    if len(run) == 1 or (frames <= limits.most_frames and size <= limits.most_size):
        return [run]
    cut = min(run[:-1], key=lambda number: _chance(units[number])) + 1
    return [
        *_pieces(units, range(run.start, cut), limits),
        *_pieces(units, range(cut, run.stop), limits),
    ]
