"""The internal form of annotations: one row per box, global frame, stored as Parquet."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from bagassets.base.columns import column, numbers
from bagassets.geometry.se3 import Floats

SCHEMA = pa.schema(
    [
        ("stamp_ns", pa.int64()),
        ("track_id", pa.string()),
        ("category", pa.string()),
        ("attributes", pa.list_(pa.string())),
        *(
            (name, pa.float64())
            for name in ("x", "y", "z", "qw", "qx", "qy", "qz", "width", "length", "height")
        ),
        ("score", pa.float64()),
        ("source", pa.string()),
        ("message_ns", pa.int64()),
    ]
)


@dataclass(frozen=True, eq=False)
class BoxTable:
    """Boxes as columns, each of length N.

    Attributes:
        stamps_ns: (N,) int64.
        tracks: track ids; the same object over time within one source. Empty: the box has no identity.
        categories: after the recipe's mapping.
        attributes: after the recipe's mapping.
        centers_m: (N, 3) box centres in the global frame.
        rotations: (N, 4) `global <- box` unit quaternions w, x, y, z; x of a box points forward.
        sizes_m: (N, 3) width, length, height.
        scores: (N,) confidence.
        sources: topic or file of each box.
        messages_ns: (N,) stamp of the message, or labelled frame, of each box; boxes of one source with the same
            stamp belong together. None if it is the stamp of the box.
    """

    stamps_ns: NDArray[np.int64]
    tracks: Sequence[str]
    categories: Sequence[str]
    attributes: Sequence[Sequence[str]]
    centers_m: Floats
    rotations: Floats
    sizes_m: Floats
    scores: Floats
    sources: Sequence[str]
    messages_ns: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def message_stamps_ns(self) -> NDArray[np.int64]:
        """Stamp of each box's message."""
        return self.stamps_ns if self.messages_ns is None else self.messages_ns

    @property
    def without_track(self) -> int:
        """Number of boxes without identity."""
        return sum(not track for track in self.tracks)

    @property
    def track_count(self) -> int:
        """Number of tracks."""
        return len({name for name in zip(self.sources, self.tracks, strict=True) if name[1]})

    def to_arrow(self) -> pa.Table:
        """Return the rows sorted by stamp, track and source; boxes without identity keep their order."""
        values = np.concatenate([self.centers_m, self.rotations, self.sizes_m], axis=1)
        order = sorted(range(len(self)), key=lambda i: (self.stamps_ns[i], self.tracks[i], self.sources[i]))
        columns: list[Sequence[Any] | NDArray[Any]] = [
            self.stamps_ns[order],
            [self.tracks[i] for i in order],
            [self.categories[i] for i in order],
            [list(self.attributes[i]) for i in order],
            *values[order].T,
            self.scores[order],
            [self.sources[i] for i in order],
            self.message_stamps_ns[order],
        ]
        return pa.Table.from_arrays(
            [column(one, field.type) for one, field in zip(columns, SCHEMA, strict=True)], schema=SCHEMA
        )

    @classmethod
    def from_arrow(cls, table: pa.Table) -> "BoxTable":
        """Return the content of an `annotations.parquet`."""

        def together(*names: str) -> Floats:
            return np.stack([numbers(table.column(name)) for name in names], axis=1)

        return cls(
            stamps_ns=numbers(table.column("stamp_ns")),
            tracks=table.column("track_id").to_pylist(),
            categories=table.column("category").to_pylist(),
            attributes=table.column("attributes").to_pylist(),
            centers_m=together("x", "y", "z"),
            rotations=together("qw", "qx", "qy", "qz"),
            sizes_m=together("width", "length", "height"),
            scores=numbers(table.column("score")),
            sources=table.column("source").to_pylist(),
            messages_ns=numbers(table.column("message_ns")),
        )
