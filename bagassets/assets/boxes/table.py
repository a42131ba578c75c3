"""The internal form of annotations: one row per box, global frame, stored as Parquet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

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
        numbers = np.concatenate([self.centers_m, self.rotations, self.sizes_m], axis=1)
        order = sorted(range(len(self)), key=lambda i: (self.stamps_ns[i], self.tracks[i], self.sources[i]))
        columns: list[object] = [
            self.stamps_ns[order],
            [self.tracks[i] for i in order],
            [self.categories[i] for i in order],
            [list(self.attributes[i]) for i in order],
            *(numbers[order, column] for column in range(10)),
            self.scores[order],
            [self.sources[i] for i in order],
            self.message_stamps_ns[order],
        ]
        return pa.table(
            [pa.array(column, type=field.type) for column, field in zip(columns, SCHEMA, strict=True)],
            schema=SCHEMA,
        )

    @classmethod
    def from_arrow(cls, table: pa.Table) -> "BoxTable":
        """Return the content of an `annotations.parquet`."""

        def numbers(*names: str) -> Floats:
            return np.stack([table.column(name).to_numpy() for name in names], axis=1)

        return cls(
            stamps_ns=table.column("stamp_ns").to_numpy(),
            tracks=table.column("track_id").to_pylist(),
            categories=table.column("category").to_pylist(),
            attributes=table.column("attributes").to_pylist(),
            centers_m=numbers("x", "y", "z"),
            rotations=numbers("qw", "qx", "qy", "qz"),
            sizes_m=numbers("width", "length", "height"),
            scores=table.column("score").to_numpy(),
            sources=table.column("source").to_pylist(),
            messages_ns=table.column("message_ns").to_numpy(),
        )
