"""Collecting boxes: mapping categories, checking boxes, and counting those that are not kept."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.boxes.frames import BoxFrames
from bagassets.assets.boxes.table import BoxTable
from bagassets.base.errors import DecodeError
from bagassets.decode.model import BoxReading
from bagassets.recipe.model_annotations import AnnotationFiles, AnnotationTopic

NO_POSE = "no ego pose at its time"
UNKNOWN_FRAME = "its frame is not known"
OUTSIDE = "its time is outside the recording"
UNMAPPED = "its class is not in `categories`"
SECOND = "second box of one track at one time"

_LATEST_NS = 1 << 63
# Labels at the very ends of a recording still serve interpolation.
SPAN_MARGIN_NS = 1_000_000_000


class Place(NamedTuple):
    """Where a box was read.

    Attributes:
        label: for the counts: file and line, or time, independent of the recording's path.
        full: for errors: path and line.
    """

    label: str = ""
    full: str = ""


NOWHERE = Place()
Source = AnnotationTopic | AnnotationFiles
"""The entry of a source in the recipe, whose rules hold for its boxes."""


@dataclass
class BoxCounts:
    """Counts of one source's boxes: read = written + sum of lost.

    Attributes:
        read: number of boxes read.
        written: number of boxes in the table.
        lost: reason -> number of boxes.
        first: reason -> place of the first such box.
        kept: anomaly -> number of boxes that were kept in spite of it.
    """

    read: int = 0
    written: int = 0
    lost: dict[str, int] = field(default_factory=dict)
    first: dict[str, str] = field(default_factory=dict)
    kept: dict[str, int] = field(default_factory=dict)

    def lose(self, reason: str, place: Place) -> None:
        """Count one lost box by its reason."""
        self.lost[reason] = self.lost.get(reason, 0) + 1
        if place.label:
            self.first.setdefault(reason, place.label)


class BoxCollector:
    """Collects boxes one by one, and returns them as one table in the global frame.

    Args:
        frames: see below.
        sources: topic, or path in the recipe -> its entry there.

    Attributes:
        frames: frames in which boxes may be given.
        counts: source -> counts of its boxes.
        unknown_frames: source -> frames of boxes that could not be transformed.
    """

    def __init__(self, frames: BoxFrames, sources: Mapping[str, Source]) -> None:
        self.counts = {source: BoxCounts() for source in sources}
        self.unknown_frames: dict[str, set[str]] = {source: set() for source in sources}
        self.frames = frames
        self._sources = sources
        self._spans_ns: dict[str, tuple[int, int] | None] = {}
        self._boxes: list[tuple[BoxReading, Place, int | None]] = []  # with place and message, as added
        self._seen: set[tuple[str, int, str]] = set()

    def limit(self, source: str, span_ns: tuple[int, int] | None) -> None:
        """Have boxes of a source that follow lie between a first and a last time: those of the recording, or of a part of it."""
        self._spans_ns[source] = span_ns

    def add(self, box: BoxReading, place: Place = NOWHERE, message: int | None = None) -> None:
        """Add one box; `box.source` determines which rules apply.

        Args:
            box: the box.
            place: where it was read.
            message: number of its message; None if boxes with equal stamps belong together.

        Raises:
            DecodeError: the box cannot be used, and its source refuses such boxes.
        """
        counts, rules = self.counts[box.source], self._sources[box.source]
        counts.read += 1
        if rules.frame is not None:
            box = replace(box, frame_id=rules.frame)
        reason = self._objection(box)
        if reason is not None:
            self._lose(box.source, reason, place)
            return
        if not self._accepts(box, rules, place):
            return
        key = (box.source, box.stamp_ns, box.track_id)
        if box.track_id and key in self._seen:
            self._lose(box.source, SECOND, place)
            return
        self._seen.add(key)
        category = rules.categories.get(box.category, box.category)
        recorded = (rules.attribute_names.get(name, name) for name in box.attributes)
        attributes = dict.fromkeys((*filter(None, recorded), *rules.attributes.get(category, ())))
        box = replace(box, category=category, attributes=tuple(attributes))
        self._boxes.append((box, place, message))

    def lose_undecoded(self, source: str, reason: str, place: Place = NOWHERE) -> None:
        """Count a box that could not be decoded.

        Raises:
            DecodeError: its source refuses such boxes.
        """
        self.counts[source].read += 1
        self._lose(source, reason, place)

    def finish(self) -> BoxTable:
        """Transform all boxes to the global frame; those without an ego pose at their time are counted as lost."""
        centers, rotations, valid = self.frames.place([box for box, _, _ in self._boxes])
        kept, numbers = [], []
        for (box, place, message), has_pose in zip(self._boxes, valid.tolist(), strict=True):
            counts = self.counts[box.source]
            if has_pose:
                counts.written += 1
                kept.append(box)
                numbers.append(message)
            else:
                counts.lose(NO_POSE, place)
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
            messages_ns=_message_stamps(kept, numbers),
        )

    def _lose(self, source: str, reason: str, place: Place, *, refuse: bool | None = None) -> None:
        refuses = self._sources[source].bad_boxes == "refuse"
        if refuses if refuse is None else refuse:
            raise DecodeError(
                f"{place.full or source}: a box cannot be used ({reason}) and the recipe refuses such boxes; "
                "fix the labels, or set `count` instead of `refuse` for this source."
            )
        self.counts[source].lose(reason, place)

    def _accepts(self, box: BoxReading, rules: Source, place: Place) -> bool:
        """Return whether the rules accept a valid box; count it if it is kept in spite of an anomaly."""
        outside = "keep" if isinstance(rules, AnnotationTopic) else rules.outside
        start_ns, end_ns = self._spans_ns.get(box.source) or (box.stamp_ns, box.stamp_ns)
        is_within = start_ns - SPAN_MARGIN_NS <= box.stamp_ns <= end_ns + SPAN_MARGIN_NS
        categories = rules.categories  # without any, all classes count
        is_mapped = not categories or box.category in {*categories, *categories.values()}
        rulings = ((not is_within, outside, OUTSIDE), (not is_mapped, rules.unmapped, UNMAPPED))
        for applies, ruling, reason in rulings:
            if applies and ruling != "keep":
                self._lose(box.source, reason, place, refuse=ruling == "refuse")
                return False
        kept = self.counts[box.source].kept
        for applies, _, reason in rulings:
            if applies:
                kept[reason] = kept.get(reason, 0) + 1
        return True

    def _objection(self, box: BoxReading) -> str | None:
        """Return why a box cannot be used, or None."""
        if box.stamp_ns <= 0:
            return "its stamp is zero"
        if box.stamp_ns >= _LATEST_NS:
            return "its stamp is centuries away"
        if not all(isfinite(value) for value in (*box.size_m, box.score)):
            return "its size or score is not finite"
        if min(box.size_m) <= 0:
            return "its size is not positive"
        if not self.frames.knows(box.frame_id):
            self.unknown_frames[box.source].add(box.frame_id)
            return UNKNOWN_FRAME
        return None


def _message_stamps(boxes: Sequence[BoxReading], messages: Sequence[int | None]) -> NDArray[np.int64]:
    """Return the stamp of each box's message: the (lower) median of its boxes' stamps."""
    together: dict[tuple[str, int], list[int]] = {}
    for box, message in zip(boxes, messages, strict=True):
        if message is not None:
            together.setdefault((box.source, message), []).append(box.stamp_ns)
    stamps = {key: sorted(own)[(len(own) - 1) // 2] for key, own in together.items()}
    return np.array(
        [
            box.stamp_ns if message is None else stamps[box.source, message]
            for box, message in zip(boxes, messages, strict=True)
        ],
        dtype=np.int64,
    )
