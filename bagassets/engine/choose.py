"""Choosing recordings and assets by what a user types."""

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path

from bagassets.base.errors import SelectionError
from bagassets.recordings.model import RecordingFiles


def choose_recordings(recordings: Mapping[str, RecordingFiles], wanted: Sequence[str]) -> frozenset[str]:
    """Return the partition keys of the recordings that a user asks for.

    Args:
        recordings: partition key -> recording.
        wanted: partition keys, globs of them, paths below the bag root, or paths of files; those of a part stand for its
            series.

    Raises:
        SelectionError: one of them matches no recording.
    """
    chosen: set[str] = set()
    for text in wanted:
        keys = {text} & recordings.keys() or _by_path(recordings, text) or _by_glob(recordings, text)
        if not keys:
            near = get_close_matches(text, recordings, n=3)
            hint = (
                f"did you mean {' or '.join(near)}?" if near else "`bagassets status` lists all recordings."
            )
            raise SelectionError(f"{text}: no such recording; {hint}")
        chosen |= keys
    return frozenset(chosen)


def choose_assets(known: Collection[str], wanted: Sequence[str]) -> frozenset[str] | None:
    """Return the assets that a user asks for, or None if none is named.

    Args:
        known: names of all assets.
        wanted: names, or comma-separated lists of names.

    Raises:
        SelectionError: one of them does not exist.
    """
    names = split_names(wanted)
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"the assets are {', '.join(known)}."
            raise SelectionError(f"{name}: no such asset; {hint}")
    return frozenset(names) or None


def split_names(wanted: Iterable[str]) -> list[str]:
    """Return the names in comma-separated lists of names."""
    return [name.strip() for text in wanted for name in text.split(",") if name.strip()]


def _by_path(recordings: Mapping[str, RecordingFiles], text: str) -> set[str]:
    path = Path(os.path.abspath(text))  # noqa: PTH100  (without `..`, but with the links through which recordings are found)
    return {
        key
        for key, recording in recordings.items()
        if any(text in {one.relative, one.key} or path == one.path for one in (recording, *recording.parts))
    }


def _by_glob(recordings: Mapping[str, RecordingFiles], text: str) -> set[str]:
    if not any(character in text for character in "*?["):
        return set()
    named = {key: (key, *(part.key for part in recording.parts)) for key, recording in recordings.items()}
    return {key for key, names in named.items() if any(fnmatchcase(name, text) for name in names)}
