"""Collecting boxes: category mapping, checks, and an account of every box that was not kept."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any

import numpy as np

from bagassets.annotations.frames import BoxFrames
from bagassets.annotations.table import BoxTable
from bagassets.decode.model import BoxReading
from bagassets.errors import DecodeError

__all__ = ["UNKNOWN_FRAME", "BoxCollector", "BoxCounts", "SourceRules"]

NO_POSE = "no ego pose at its time"
UNKNOWN_FRAME = "its frame is not known"


@dataclass(frozen=True)
class SourceRules:
    """What the recipe says about the boxes of one source.

    Attributes:
        frame: frame of all its boxes; None: each says its own.
        categories: recorded class -> category; others pass through by name.
        attributes: category -> attributes given to each of its boxes.
        refuse: a box that cannot be used is an error, not a count.
    """

    frame: str | None = None
    categories: Mapping[str, str] = field(default_factory=dict)
    attributes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    refuse: bool = False


@dataclass
class BoxCounts:
    """Where the boxes of one source went: read = written + sum of lost."""

    read: int = 0
    written: int = 0
    lost: dict[str, int] = field(default_factory=dict)

    def lose(self, reason: str) -> None:
        """Count one box that was lost, under a reason in words."""
        self.lost[reason] = self.lost.get(reason, 0) + 1

    def as_json(self) -> dict[str, Any]:
        """Return the counts as JSON."""
        return {"read": self.read, "written": self.written, "lost": dict(self.lost)}


class BoxCollector:
    """Takes boxes one by one and gives them back as one table in the global frame.

    Attributes:
        frames: frames that boxes may be given in.
        counts: source -> account of its boxes.
        unknown_frames: source -> frames of boxes that could not be placed.
    """

    def __init__(self, frames: BoxFrames, rules: Mapping[str, SourceRules]) -> None:
        self.counts = {source: BoxCounts() for source in rules}
        self.unknown_frames: dict[str, set[str]] = {source: set() for source in rules}
        self.frames = frames
        self._rules = rules
        self._boxes: list[BoxReading] = []
        self._seen: set[tuple[str, int, str]] = set()

    def add(self, box: BoxReading) -> None:
        """Take one box; `box.source` says which rules apply.

        Raises:
            DecodeError: the box cannot be used and its source refuses such boxes.
        """
        self.counts[box.source].read += 1
        rules = self._rules[box.source]
        if rules.frame is not None:
            box = replace(box, frame_id=rules.frame)
        reason = self._objection(box)
        if reason is not None:
            self._lose(box.source, reason)
            return
        number = self.counts[box.source].read
        # Without a track every box is an object of its own.
        track = box.track_id or f"untracked-{box.stamp_ns}-{number}"
        key = (box.source, box.stamp_ns, track)
        if key in self._seen:
            self._lose(box.source, "second box of one track at one time")
            return
        self._seen.add(key)
        category = rules.categories.get(box.category, box.category)
        attributes = tuple(dict.fromkeys((*box.attributes, *rules.attributes.get(category, ()))))
        self._boxes.append(replace(box, track_id=track, category=category, attributes=attributes))

    def lose_undecoded(self, source: str, reason: str) -> None:
        """Count a box that could not even be decoded.

        Raises:
            DecodeError: its source refuses such boxes.
        """
        self.counts[source].read += 1
        self._lose(source, reason)

    def finish(self) -> BoxTable:
        """Place all boxes; those without an ego pose at their time are counted as lost."""
        centers, rotations, valid = self.frames.place(self._boxes)
        kept = []
        for box, has_pose in zip(self._boxes, valid.tolist(), strict=True):
            counts = self.counts[box.source]
            if has_pose:
                counts.written += 1
                kept.append(box)
            else:
                counts.lose(NO_POSE)
        return BoxTable(
            stamps_ns=np.array([box.stamp_ns for box in kept], dtype=np.int64),
            tracks=[box.track_id for box in kept],
            categories=[box.category for box in kept],
            attributes=[box.attributes for box in kept],
            centers_m=centers[valid],
            rotations=rotations[valid],
            sizes_m=np.array([box.size_m for box in kept], dtype=np.float64).reshape(-1, 3),
            scores=np.array([box.score for box in kept], dtype=np.float64),
            sources=[box.source for box in kept],
        )

    def _lose(self, source: str, reason: str) -> None:
        if self._rules[source].refuse:
            raise DecodeError(
                f"{source}: a box cannot be used ({reason}) and the recipe refuses such boxes; "
                "mend the labels, or say `bad_boxes: count` for this source."
            )
        self.counts[source].lose(reason)

    def _objection(self, box: BoxReading) -> str | None:
        """Return why a box cannot be used, or None."""
        if box.stamp_ns <= 0:
            return "its stamp is zero"
        if not all(isfinite(value) for value in (*box.size_m, box.score)):
            return "its size or score is not finite"
        if min(box.size_m) <= 0:
            return "its size is not positive"
        if not self.frames.knows(box.frame_id):
            self.unknown_frames[box.source].add(box.frame_id)
            return UNKNOWN_FRAME
        return None
