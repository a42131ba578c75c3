"""The packets of a Velodyne become lidar files, one per complete revolution."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.lidar_sweeps import NO_STAMP, LidarUse, LidarWriter
from bagassets.assets.revolutions import Revolution, RevolutionCutter
from bagassets.base.errors import DecodeError
from bagassets.decode.fields import stamp_and_frame
from bagassets.decode.packets import PAYLOADS, VELODYNE_PACKET_SIZE, packets_in
from bagassets.decode.velodyne import POSITION_PACKET_SIZE, PacketFilter, Packets, RevolutionDecoder
from bagassets.geometry.kernels.returns import PACKET
from bagassets.geometry.tf_tree import normalise_frame
from bagassets.recordings.model import Message, RawMessage
from bagassets.recordings.topic import Topic

# Messages are held until there are so many, or of so many bytes.
_MOST_HELD = 256
_MOST_HELD_BYTES = 1_000_000


@dataclass(frozen=True, kw_only=True)
class PacketUse(LidarUse):
    """Everything besides its messages that shapes the files of a lidar with packet messages.

    Attributes:
        model: model of the lidar; None to take it from the packets.
        cut_angle_deg: azimuth at which revolutions begin; None to take it from the packets.
    """

    model: str | None
    cut_angle_deg: float | None


class PacketSweeps:
    """One file per complete revolution of a Velodyne; messages are counted by packets.

    Incomplete revolutions, mostly the first and the last one, are lost: training code expects
    complete ones, and the stamp of an incomplete one would be wrong.

    Messages are held for a while, since there are a thousand a second of some lidars: what is to be done with one takes
    less time than a few calls of functions.

    Args:
        use: everything that shapes the files.
        writer: writes the revolutions.
        topic: the topic of the messages.
        decode: decodes a message whose packets cannot be had more cheaply.
        fail: called with the text of an error, and how many packets and how many more messages it cost.

    Attributes:
        frame_id: frame of the first message; empty if it has none.
    """

    def __init__(
        self,
        use: PacketUse,
        writer: LidarWriter,
        topic: Topic,
        decode: Callable[[RawMessage], Message],
        fail: Callable[[str, int, int], None],
    ) -> None:
        self.frame_id = ""
        self._writer = writer
        self._topic = topic
        self._decode = decode
        self._fail = fail
        self._filter = PacketFilter(use.model)
        self._decoder = RevolutionDecoder(use.model)
        self._cutter = RevolutionCutter(use.cut_angle_deg)
        self._by_log_time = use.settings.clock == "log"
        self._held: list[bytes] = []
        self._held_bytes = 0
        self._log_times_ns: list[int] = []
        self._failed: set[int] = set()  # numbers of messages among those that are held

    def add(self, raw: RawMessage) -> None:
        """Take a message."""
        data = raw.data
        self._held.append(data if isinstance(data, bytes) else bytes(data))
        self._held_bytes += len(data)
        self._log_times_ns.append(raw.log_time_ns)
        if len(self._held) >= _MOST_HELD or self._held_bytes >= _MOST_HELD_BYTES:
            self._take_held()

    def finish(self) -> None:
        """Write what is held, and the revolution since the last cut."""
        self._take_held()
        for revolution in self._cutter.flush():
            self._write(revolution)

    def _take_held(self) -> None:
        messages, self._held, self._held_bytes = self._held, [], 0
        log_times_ns, self._log_times_ns = np.array(self._log_times_ns, dtype=np.int64), []
        self._failed.clear()
        alike = self._topic.packets(messages, PAYLOADS)
        if alike is not None and alike.payloads.shape[1] == VELODYNE_PACKET_SIZE:
            # With log times: what a message brings had arrived by then.
            host_ns = log_times_ns if self._by_log_time else alike.stamps_ns
            if host_ns.all():
                self.frame_id = self.frame_id or normalise_frame(alike.frame_id)
                self._writer.files.counts.read += len(messages)
                numbers = np.arange(len(messages))
                self._push(host_ns, alike.payloads.view(PACKET)[:, 0], log_times_ns, numbers)
                return
        self._take_each(messages, log_times_ns)

    def _take_each(self, messages: Sequence[bytes], log_times_ns: NDArray[np.int64]) -> None:
        found: list[tuple[int, int]] = []  # times of arrival, and numbers of messages
        payloads: list[bytes] = []
        counts = self._writer.files.counts
        for number, (data, log_time_ns) in enumerate(zip(messages, log_times_ns.tolist(), strict=True)):
            try:
                packets = self._packets(data, log_time_ns)
            except DecodeError as err:
                counts.read += 1
                self._refuse(str(err), number)
                continue
            counts.read += len(packets)
            shift = log_time_ns - packets[-1][0] if self._by_log_time and packets else 0
            for stamp_ns, payload in packets:
                if len(payload) == POSITION_PACKET_SIZE:
                    self._writer.files.lose("position packet")
                elif stamp_ns + shift == 0:
                    self._refuse(NO_STAMP, number)
                elif len(payload) != VELODYNE_PACKET_SIZE:
                    self._refuse(f"it holds no data packet of {VELODYNE_PACKET_SIZE} bytes", number)
                else:
                    found.append((stamp_ns + shift, number))
                    payloads.append(payload)
        host_ns, numbers = np.array(found, dtype=np.int64).reshape(-1, 2).T
        self._push(host_ns, np.frombuffer(b"".join(payloads), dtype=PACKET), log_times_ns[numbers], numbers)

    def _packets(self, data: bytes, log_time_ns: int) -> list[tuple[int, bytes]]:
        """Return stamp and bytes of each packet in a message.

        Raises:
            DecodeError: the message holds no packets.
        """
        skimmed = self._topic.packet(data, PAYLOADS)
        if skimmed is not None:
            self.frame_id = self.frame_id or normalise_frame(skimmed.frame_id)
            return [(skimmed.stamp_ns, skimmed.payload)]
        message = self._decode(RawMessage(self._topic.name, self._topic.msgtype, log_time_ns, data))
        header_ns, frame_id = stamp_and_frame(message.header) if hasattr(message, "header") else (0, "")
        packets = [(own_ns or header_ns, payload) for own_ns, payload in packets_in(message)]
        self.frame_id = self.frame_id or frame_id
        return packets

    def _push(
        self,
        host_ns: NDArray[np.int64],
        data: NDArray[np.void],
        log_times_ns: NDArray[np.int64],
        numbers: NDArray[np.int64],
    ) -> None:
        """Take packets.

        Args:
            host_ns: (N,) when the host received them.
            data: (N,) `PACKET`.
            log_times_ns: (N,) log times of their messages.
            numbers: (N,) numbers of their messages.
        """
        refused = self._filter.refusals(data)
        for index, reason in refused.items():
            self._refuse(reason, int(numbers[index]))
        if refused:
            kept = np.delete(np.arange(len(data)), list(refused))
            host_ns, data, log_times_ns = host_ns[kept], data[kept], log_times_ns[kept]
        for revolution in self._cutter.push(Packets(host_ns, data), log_times_ns):
            self._write(revolution)

    def _refuse(self, reason: str, number: int) -> None:
        """Count a packet, or a whole message, that cannot be used."""
        self._fail(reason, 1, 0 if number in self._failed else 1)
        self._failed.add(number)

    def _write(self, revolution: Revolution) -> None:
        parts = len(revolution.packets)
        if not revolution.complete:
            self._writer.files.lose("incomplete revolution", parts)
            return
        packet_times, end = revolution.times_ns()
        try:
            decoded = self._decoder.decode(revolution.packets, packet_times)
        except DecodeError as err:
            self._fail(str(err), parts, 1)
            return
        self._writer.files.points.read += len(decoded.points)
        span = (int(packet_times[0]), end)
        self._writer.write(decoded.points, decoded.times_ns, span, revolution.log_time_ns, parts=parts)
