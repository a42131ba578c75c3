"""The packets of an Ouster become lidar files, one per complete revolution.

A packet belongs to the turn in which its first column was measured. A lidar may report only a part of each turn; then the cut
is in the middle of the rest, unless the recipe names an angle, so that a revolution is one sweep.

The messages have no stamps, only log times. Differences between times come from the lidar; the offset between its clock and
the host's is the median over the packets of a revolution, each of which arrives once its last column was measured. By
`clock: header`, the times are those of the lidar itself, which must have been synchronized with the host.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.asset import Inputs, by_digest
from bagassets.assets.lidar_metadata import described
from bagassets.assets.lidar_sweeps import LidarUse, LidarWriter
from bagassets.assets.revolutions import MOST_MISSING_DEG
from bagassets.base.errors import DecodeError, RecipeError
from bagassets.decode.ouster import OusterLidar, packet_in
from bagassets.recordings.model import Message, RawMessage

# Packets of the last turn that come after the first of the next: networks change their order.
_LATE = 1 / 8
# How much longer than by its median column a revolution may be; while a lidar speeds up, its columns differ.
_MOST_STRETCHED = 1.5
# PTP has the time of atomic clocks (TAI), which is ahead of UTC by so much; drivers take it off.
_TAI_NS = 37_000_000_000
_MOST_APART_NS = 1_000_000_000


@dataclass(frozen=True, kw_only=True)
class OusterUse(LidarUse):
    """Everything besides its messages that shapes the files of an Ouster whose packets were recorded.

    Attributes:
        cut_angle_deg: azimuth at which revolutions begin, clockwise from the first column; None for the lidar's own.
        metadata_topic: topic with the metadata; None if it is in a file.
        metadata: content of that file.
    """

    cut_angle_deg: float | None
    metadata_topic: str | None
    metadata: bytes | None = by_digest(None)


class OusterSweeps:
    """One file per complete revolution of an Ouster; incomplete ones are lost.

    Args:
        use: everything that shapes the files.
        lidar: what its metadata says.
        writer: writes the revolutions.
        decode: decodes a message.
        fail: called with the text of an error, and how many packets and how many messages it cost.
    """

    def __init__(
        self,
        use: OusterUse,
        lidar: OusterLidar,
        writer: LidarWriter,
        decode: Callable[[RawMessage], Message],
        fail: Callable[[str, int, int], None],
    ) -> None:
        self._lidar = lidar
        self._writer = writer
        self._decode = decode
        self._fail = fail
        self._by_log_time = use.settings.clock == "log"
        first, last = lidar.window
        blind = (first - last - 1) % lidar.columns
        middle = (last + 1 + blind // 2) % lidar.columns if blind else 0
        at = middle if use.cut_angle_deg is None else round(use.cut_angle_deg / 360 * lidar.columns)
        self._cut = at // lidar.columns_per_packet * lidar.columns_per_packet % lidar.columns
        # Whether the lidar reports each column after the cut.
        since_first = (np.arange(lidar.columns) + self._cut - first) % lidar.columns
        self._reported = since_first < lidar.columns - blind
        self._frame: int | None = None
        # By turn and first column: packets and their log times.
        self._turns: dict[int, dict[int, tuple[bytes, int]]] = {}
        self._latest = 0

    def add(self, raw: RawMessage) -> None:
        """Take a message."""
        self._writer.files.counts.read += 1
        try:
            packet = self._lidar.read(packet_in(self._decode(raw)))
        except DecodeError as err:
            self._fail(str(err), 1, 1)
            return
        number = int(packet["columns"]["number"][0])
        position = self._turn_of(packet) * self._lidar.columns + number - self._cut
        if position < self._latest - self._lidar.columns:  # the lidar was started again
            self.finish()
        self._latest = max(self._latest, position) if self._turns else position
        turn = self._turns.setdefault(position // self._lidar.columns, {})
        if number in turn:
            self._writer.files.lose("recorded twice")
        else:
            turn[number] = (packet.tobytes(), raw.log_time_ns)
        self._write_until(self._latest / self._lidar.columns - _LATE)

    def finish(self) -> None:
        """Write the last revolutions."""
        self._write_until(np.inf)

    def _turn_of(self, packet: NDArray[np.void]) -> int:
        """Return the number of its turn, counted on where the lidar begins again."""
        frame, frames = self._lidar.frame_of(packet), self._lidar.frames
        if self._frame is None:
            self._frame = frame
        self._frame += (frame - self._frame + frames // 2) % frames - frames // 2
        return self._frame

    def _write_until(self, turns: float) -> None:
        """Write the revolutions that have ended by then."""
        for turn in sorted(turn for turn in self._turns if turn + 1 <= turns):
            packets = list(self._turns.pop(turn).values())
            try:
                self._write(packets)
            except DecodeError as err:
                self._fail(str(err), len(packets), len(packets))

    def _write(self, packets: Sequence[tuple[bytes, int]]) -> None:
        parts = len(packets)
        structured = np.frombuffer(b"".join(data for data, _ in packets), self._lidar.packet)
        columns = self._lidar.decode(structured)
        after_cut = (columns.numbers - self._cut) % self._lidar.columns
        if not len(after_cut) or self._missing_deg(after_cut) > MOST_MISSING_DEG:
            self._writer.files.lose("incomplete revolution", parts)
            return
        steps_ns, steps = np.diff(columns.times_ns), np.diff(after_cut)
        if not ((steps_ns > 0) & (steps > 0)).all():
            raise DecodeError("the times of its columns do not follow their order")
        column_ns = int(np.sort(steps_ns // steps)[len(steps) // 2]) if len(steps) else 0
        expected = np.flatnonzero(self._reported)
        begin, end = int(columns.times_ns[0]), int(columns.times_ns[-1])
        if end - begin > _MOST_STRETCHED * int(steps.sum()) * column_ns:
            raise DecodeError("the lidar's clock was set in the middle of its revolution")
        # Columns are valid beyond the window where that was set after the metadata was saved.
        begin -= max(0, int(after_cut[0] - expected[0])) * column_ns
        end += max(1, int(expected[-1] + 1 - after_cut[-1])) * column_ns
        log_times_ns = np.array([log_time_ns for _, log_time_ns in packets])
        arrived_ns = structured["columns"]["time_ns"].max(axis=1).astype(np.int64)
        shift_ns = self._shift_ns(int(np.sort(log_times_ns - arrived_ns)[(parts - 1) // 2]))
        counts = self._writer.files.points
        counts.read += len(columns.points) + columns.without_return
        counts.lose("no measurement", columns.without_return)
        times_ns = columns.times_ns[columns.of_points] + shift_ns
        span_ns = (begin + shift_ns, end + shift_ns)
        self._writer.write(columns.points, times_ns, span_ns, int(log_times_ns[-1]), parts=parts)

    def _missing_deg(self, after_cut: NDArray[np.int64]) -> float:
        """Return the widest part of what the lidar reports that is missing, in degrees."""
        missing = self._reported.copy()
        missing[after_cut] = False
        edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(np.int8)))
        widest = int((edges[1::2] - edges[::2]).max(initial=0))
        return widest * 360.0 / self._lidar.columns

    def _shift_ns(self, offset_ns: int) -> int:
        """Return what is added to the lidar's times, of which the log's are ahead by `offset_ns`.

        Raises:
            DecodeError: the lidar's times are to be used, but are not of this clock.
        """
        if self._by_log_time:
            return offset_ns
        for shift_ns in (0, -_TAI_NS):
            if abs(offset_ns - shift_ns) <= _MOST_APART_NS:
                return shift_ns
        raise DecodeError(
            "its packets have no header, and the times of the lidar are not those of the host; set clock: log in the recipe"
        )


def lidar_of(use: OusterUse, inputs: Inputs) -> OusterLidar:
    """Return what the metadata of a lidar says, from its topic or file.

    Raises:
        RecipeError: there is none, or it cannot be used.
    """
    where = use.metadata_topic or "the file in `metadata`"
    try:
        return described(OusterLidar.parse, use.metadata_topic, use.metadata, inputs)
    except DecodeError as err:
        raise RecipeError(
            f"{use.channel}: {where} does not say what the packets in {use.settings.topic} hold: {err}; name a file with the "
            "metadata of the lidar in `metadata` of the channel."
        ) from err
