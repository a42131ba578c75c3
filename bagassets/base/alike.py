"""Saying once what holds for many recordings: sentences that are the same, or differ in their numbers only."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

_FEWEST = 4
_MOST_NAMED = 3
_SPACES = re.compile(r"(\s+)")
# A number or a time (ISO 8601), in what may surround it: brackets, a unit, a full stop.
_NUMBER = re.compile(r"(\W*?)(\d{4}-\d\d-\d\dT[\d:.]+Z|-?\d+(?:\.\d+)?)(\D*)")
_HERE = "\0"
# A sentence may begin with the recording, also in a column, or behind its path.
_PRONOUN = re.compile(r"(?:^|(?<=  )|(?<=…: ))its?\b")
_OF_EACH = {"it": "each", "its": "their"}


def names_text(names: Sequence[str], most: int = _MOST_NAMED) -> str:
    """Return names, of many only the first few: `a, b, c and 4 more`."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def recordings_text(names: Sequence[str]) -> str:
    """Return how many recordings there are and the first few names; of a single one, its name."""
    return names[0] if len(names) == 1 else f"{len(names)} recordings ({names_text(names)})"


@dataclass(frozen=True)
class Told:
    """What is said of some recordings.

    Attributes:
        kind: what they have in common besides, such as the check that found it.
        names: the recordings.
        text: the sentence; of several, it has the range of numbers that differ, and `…` for the name of each recording,
            and it is about each of them.
    """

    kind: tuple[str, ...]
    names: tuple[str, ...]
    text: str

    @property
    def title(self) -> str:
        """The recordings, of many only the first few by name."""
        return recordings_text(self.names)


def told_once(found: Iterable[tuple[tuple[str, ...], str, str]], fewest: int = _FEWEST) -> list[Told]:
    """Return each sentence with the recordings that it is about, in the order in which they are met first.

    Args:
        found: kind, name of the recording and sentence; only what is of one kind is grouped.
        fewest: fewer are listed one by one.
    """
    split: dict[tuple[str, str], tuple[list[str], tuple[str, ...]]] = {}
    alike: dict[tuple[tuple[str, ...], tuple[str, ...]], list[tuple[str, list[str]]]] = {}
    for kind, name, text in found:
        own = name if name and name in text else ""
        if (own, text) not in split:  # it may be that of thousands of recordings
            words = _SPACES.split(text)
            split[own, text] = words, tuple(_pattern(word, own) for word in words)
        words, pattern = split[own, text]
        alike.setdefault((kind, pattern), []).append((name, words))
    told = []
    for (kind, _), same in alike.items():
        if len(same) < fewest:
            told += [Told(kind, (name,), "".join(words)) for name, words in same]
        else:
            names = tuple(name for name, _ in same)
            different = {id(words): words for _, words in same}.values()
            columns = zip(*different, strict=True)
            text = "".join(_summed_up(column, names[0]) for column in columns)
            told.append(Told(kind, names, _PRONOUN.sub(lambda found: _OF_EACH[found[0]], text)))
    return told


def _pattern(word: str, name: str) -> str:
    """Return what a word has in common with those of other recordings at its place."""
    word = _without(name, word, _HERE) if name and name in word else word
    number = _NUMBER.fullmatch(word)
    return word if number is None else f"{number[1]}{_HERE}{number[3]}"


def _summed_up(words: Sequence[str], name: str) -> str:
    """Return one text for words of the same pattern, the first of which is about a recording of that name."""
    first = words[0]
    if all(word == first for word in words):
        return first
    numbers = [found for word in words if (found := _NUMBER.fullmatch(word)) is not None]
    if len(numbers) < len(words):
        return _without(name, first, "…")
    values = sorted(
        (number[2] for number in numbers), key=lambda text: (0.0 if "T" in text else float(text), text)
    )
    return f"{numbers[0][1]}{values[0]} to {values[-1]}{numbers[0][3]}"


def _without(name: str, word: str, stand_in: str) -> str:
    """Return a word with the name of its recording replaced, where it ends a path or names what follows: it may be `a`."""
    whole = re.escape(name)
    return re.sub(rf"(?<=/){whole}(?![\w-]|\.\w)|^{whole}(?=:)", stand_in, word)


def without_path(key: str, text: str) -> str:
    """Return a sentence about a recording without the path that it begins with, for where the key stands before it."""
    path, colon, rest = text.partition(": ")
    return rest if colon and path.startswith("/") and path.replace("/", "__").endswith(f"__{key}") else text
