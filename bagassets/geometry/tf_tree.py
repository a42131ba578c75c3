"""Trees of coordinate frames: edges over time, and the transform between any two frames.

An edge is named by its child, as in TF: each frame has one parent. Trees from several sources
(`/tf_static`, a URDF, `/tf`) are laid over each other, the first source that knows a frame wins.
"""

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bagassets.base.alike import names_text
from bagassets.base.errors import CalibrationError
from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply, rotate
from bagassets.geometry.trajectory import Trajectory

# Edges that stay within this of their first value are fixed joints: publishers repeat them
# bit for bit or with the noise of single precision.
FIXED_M = 1e-6
FIXED_RAD = 1e-6

# An edge with a period this many times that of the fastest one on its way is a slow one, such as the
# correction that a localisation publishes once a second; it pauses only after so many of its periods.
SLOW_RATIO = 2
PAUSE_PERIODS = 3

MOST_FRAMES_NAMED = 20


def normalise_frame(frame_id: str) -> str:
    """Return a frame id without the leading slash that tf had and tf2 does not allow."""
    return str(frame_id).strip().lstrip("/")


@dataclass(frozen=True, eq=False)
class Edge:
    """`parent_SE3_child` over time.

    Attributes:
        parent: frame nearer to the root.
        child: frame that the edge belongs to.
        source: where it is from: tf_static, urdf or tf.
        stamps_ns: (N,) int64, strictly increasing; N >= 1.
        translations_m: (N, 3).
        rotations: (N, 4) unit quaternions w, x, y, z.
        repeated: further samples that were left out because they repeat a stamp.
        disputed: some of those have another value, and the edge is a fixed one without them.
        topics: those that it is on, sorted; empty if it is from a file.
    """

    parent: str
    child: str
    source: str
    stamps_ns: NDArray[np.int64]
    translations_m: Floats
    rotations: Floats
    repeated: int = 0
    disputed: bool = False
    topics: tuple[str, ...] = ()

    @classmethod
    def fixed(cls, parent: str, child: str, source: str, parent_SE3_child: SE3) -> "Edge":
        """Return an edge that holds always."""
        return cls(
            parent,
            child,
            source,
            np.zeros(1, dtype=np.int64),
            np.array([parent_SE3_child.translation]),
            np.array([parent_SE3_child.rotation]),
        )

    @property
    def moves(self) -> bool:
        """Return whether the edge ever differs from its first value."""
        apart_m = np.abs(self.translations_m - self.translations_m[0]).max()
        same = np.abs(self.rotations - self.rotations[0]).max(axis=1)
        opposite = np.abs(self.rotations + self.rotations[0]).max(axis=1)
        return bool(apart_m > FIXED_M or np.minimum(same, opposite).max() > FIXED_RAD / 2)

    @property
    def period_ns(self) -> int:
        """Median time between samples; 0 for fewer than two."""
        periods = np.sort(np.diff(self.stamps_ns))
        return int(periods[len(periods) // 2]) if len(periods) else 0

    @property
    def first(self) -> SE3:
        """`parent_SE3_child` at the first stamp."""
        return SE3.create(self.rotations[0], self.translations_m[0])

    def at(
        self, stamps_ns: NDArray[np.int64], max_gap_ns: int, extrapolate_ns: int, fastest_ns: int
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return `parent_SE3_child` at (M,) stamps; see `TfTree.at`.

        Args:
            stamps_ns: the stamps.
            max_gap_ns: longest gap to interpolate.
            extrapolate_ns: how far to extrapolate beyond the ends.
            fastest_ns: period of the fastest edge that this one is combined with.
        """
        stamps, positions, rotations = self.stamps_ns, self.translations_m, self.rotations
        if not self.moves:
            return Trajectory(stamps[:1], positions[:1], rotations[:1], 0, 0, fixed=True).at(stamps_ns)
        period_ns = self.period_ns
        if period_ns <= SLOW_RATIO * fastest_ns:
            return Trajectory(stamps, positions, rotations, max_gap_ns, extrapolate_ns).at(stamps_ns)
        hold_ns = max(extrapolate_ns, period_ns)
        held = np.clip(stamps_ns, stamps[0], stamps[-1])
        pause_ns = max(max_gap_ns, PAUSE_PERIODS * period_ns)
        t, q, known = Trajectory(stamps, positions, rotations, pause_ns, 0).at(held)
        return t, q, known & (np.abs(stamps_ns - held) <= hold_ns)


class TransformLog:
    """Collects the transforms of one source as they are read, in compact form."""

    def __init__(self, source: str) -> None:
        self.source = source
        self._samples: dict[tuple[str, str], tuple[array[int], array[float], set[str]]] = {}

    def add(self, parent: str, child: str, stamp_ns: int, parent_SE3_child: SE3, topic: str = "") -> None:
        """Add one sample of one edge, which was on a topic."""
        stamps, numbers, topics = self._samples.setdefault((parent, child), (array("q"), array("d"), set()))
        topics.add(topic)
        stamps.append(stamp_ns)
        numbers.extend(parent_SE3_child.translation)
        numbers.extend(parent_SE3_child.rotation)

    def edges(self) -> list[Edge]:
        """Return the edges; of samples with the same stamp the first one counts, as in tf2."""
        edges = []
        for (parent, child), (stamps, numbers, topics) in self._samples.items():
            stamps_ns, first = np.unique(np.array(stamps, dtype=np.int64), return_index=True)
            table = np.array(numbers).reshape(-1, 7)
            # Of all samples, whatever their stamps, only to see whether it moves.
            every = Edge(parent, child, self.source, stamps_ns, table[:, :3], table[:, 3:])
            kept = replace(every, translations_m=table[first, :3], rotations=table[first, 3:])
            repeated = len(stamps) - len(stamps_ns)
            disputed = repeated > 0 and every.moves and not kept.moves
            named = tuple(sorted(topics))
            edges.append(replace(kept, repeated=repeated, disputed=disputed, topics=named))
        return edges


class TfTree:
    """Frames and the edges between them.

    Args:
        *layers: edges of each source, the most trusted first. A frame takes its parent from the
            first layer that has one, unless that would close a cycle.
    """

    def __init__(self, *layers: Iterable[Edge]) -> None:
        self._above: dict[str, list[Edge]] = {}
        frames: set[str] = set()
        for layer in layers:
            new: dict[str, list[Edge]] = {}
            for edge in layer:
                frames.update((edge.parent, edge.child))
                if edge.child not in self._above and edge.child not in self._ancestors(edge.parent):
                    new.setdefault(edge.child, []).append(edge)
            self._above.update(new)
        self.frames = tuple(sorted(frames))

    def chain(self, dst: str, src: str) -> tuple[list[Edge], list[Edge]]:
        """Return the edges from `src` and from `dst` up to the first frame above both.

        Raises:
            CalibrationError: a frame is unknown, the two are not connected, a frame on the way has two
                parents or is above itself, or a fixed edge has several values at one time.
        """
        nothing = f"no transform from {src} to {dst}"
        for frame in (src, dst):
            if frame not in self.frames:
                raise CalibrationError(
                    f"{nothing}: {frame} is not a frame known here ({self._describe_frames()})"
                )
        from_src, trouble_src = self._way_up(src)
        from_dst, trouble_dst = self._way_up(dst)
        above_dst = [dst, *(edge.parent for edge in from_dst)]
        above_src = [src, *(edge.parent for edge in from_src)]
        for height, frame in enumerate(above_src):
            if frame in above_dst:
                up, down = from_src[:height], from_dst[: above_dst.index(frame)]
                for edge in (*up, *down):
                    if edge.disputed:
                        raise CalibrationError(
                            f"{nothing}: {edge.parent} -> {edge.child} ({edge.source}) has several values at one time; "
                            f"{_remedy([edge])}"
                        )
                return up, down
        trouble = (
            trouble_src
            or trouble_dst
            or f"they are in two trees with the roots {above_src[-1]} and {above_dst[-1]} ({self._describe_frames()})"
        )
        raise CalibrationError(f"{nothing}: {trouble}")

    def fixed(self, dst: str, src: str) -> tuple[SE3, tuple[str, ...]]:
        """Return `dst_SE3_src`, which must not change over the recording, and its sources.

        Raises:
            CalibrationError: there is no such transform, or it moves.
        """
        up, down = self.chain(dst, src)
        for edge in (*up, *down):
            if edge.moves:
                raise CalibrationError(
                    f"no fixed transform from {src} to {dst}: {edge.parent} -> {edge.child} "
                    f"({edge.source}) moves during the recording"
                )
        common_SE3_src, common_SE3_dst = _compose(up), _compose(down)
        sources = tuple(sorted({edge.source for edge in (*up, *down)}))
        return common_SE3_dst.inverse() @ common_SE3_src, sources

    def at(
        self, dst: str, src: str, stamps_ns: NDArray[np.int64], max_gap_ns: int, extrapolate_ns: int
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return `dst_SE3_src` at (M,) stamps, each moving edge interpolated by itself.

        The limits apply to the fastest edges on the way. A slower edge, by several times, may pause
        for three of its own periods, and holds its first and last value for one period.

        Returns:
            translations (M, 3) in metres, rotations (M, 4), and a mask (M,) that is False where
            a moving edge has no value: in a gap longer than `max_gap_ns`, or more than
            `extrapolate_ns` before its first or after its last sample.

        Raises:
            CalibrationError: the frames are not connected.
        """
        up, down = self.chain(dst, src)
        number = len(stamps_ns)
        fastest_ns = min((edge.period_ns for edge in (*up, *down) if edge.moves), default=0)
        translations, rotations = np.zeros((number, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (number, 1))
        valid = np.ones(number, dtype=np.bool_)
        for edge, inverted in [*((edge, False) for edge in up), *((edge, True) for edge in reversed(down))]:
            t, q, known = edge.at(stamps_ns, max_gap_ns, extrapolate_ns, fastest_ns)
            if inverted:
                q = q * np.array([1.0, -1.0, -1.0, -1.0])
                t = -rotate(q, t)
            translations = rotate(q, translations) + t
            rotations = quaternion_multiply(q, rotations)
            valid &= known
        return translations, rotations, valid

    def _way_up(self, frame: str) -> tuple[list[Edge], str | None]:
        """Edges from a frame towards its root, nearest first, and why they end before it, or None.

        A problem far above two frames does not affect the transform between them. They end where they reach a circle, in
        which there are two ways from one frame to another.
        """
        way: list[Edge] = []
        passed = [frame]
        while above := self._above.get(passed[-1]):
            if len(above) > 1:
                parents = " and ".join(f"{edge.parent} ({edge.source})" for edge in above)
                return way, f"frame {passed[-1]} has more than one parent, {parents}; {_remedy(above)}"
            if above[0].parent in passed:
                begin = passed.index(above[0].parent)
                circle = [*passed[begin:], above[0].parent]
                return way[:begin], f"the transforms go round in a circle, {' <- '.join(circle)}"
            way.append(above[0])
            passed.append(above[0].parent)
        return way, None

    def _ancestors(self, frame: str) -> set[str]:
        """Frames at and above a frame, among the edges added so far."""
        reached: set[str] = set()
        todo = [frame]
        while todo:
            current = todo.pop()
            if current not in reached:
                reached.add(current)
                todo.extend(edge.parent for edge in self._above.get(current, ()))
        return reached

    def _describe_frames(self) -> str:
        if not self.frames:
            return "no frames are known at all"
        return f"known frames: {names_text(self.frames, MOST_FRAMES_NAMED)}"


def _remedy(edges: Iterable[Edge]) -> str:
    """What to do about edges that contradict each other, or themselves."""
    topics = sorted({topic for edge in edges for topic in edge.topics})
    if len(topics) < 2:
        return "correct what publishes it"
    return f"two nodes publish it, so name only one of {' and '.join(topics)} in the recipe"


def _compose(way_up: list[Edge]) -> SE3:
    """`top_SE3_bottom` of a way up whose edges do not move."""
    top_SE3_bottom = SE3()
    for edge in way_up:
        top_SE3_bottom = edge.first @ top_SE3_bottom
    return top_SE3_bottom
