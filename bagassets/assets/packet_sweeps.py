"""The packets of a Velodyne or Hesai become lidar files, one per complete revolution."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.asset import Inputs, by_digest, omitted
from bagassets.assets.lidar_metadata import described
from bagassets.assets.lidar_sweeps import NO_STAMP, LidarUse, LidarWriter
from bagassets.assets.revolutions import Revolution, RevolutionCutter
from bagassets.base.errors import DecodeError, RecipeError
from bagassets.decode.fields import stamp_and_frame
from bagassets.decode.hesai import MODEL_NAMES, HesaiLidar, HesaiModel, HesaiPackets, packet_and_model
from bagassets.decode.packets import PAYLOADS, VELODYNE_PACKET_SIZE, PacketPoints, Packets, packets_in
from bagassets.decode.velodyne import POSITION_PACKET_SIZE, PacketFilter, RevolutionDecoder
from bagassets.geometry.kernels.returns import PACKET
from bagassets.geometry.tf_tree import normalise_frame
from bagassets.recordings.model import Message, RawMessage
from bagassets.recordings.topic import Topic

_UNKNOWN = f"it holds no data packet of a Velodyne ({VELODYNE_PACKET_SIZE} bytes), nor of a Hesai that is known ({MODEL_NAMES})"
# Messages are held until there are so many, or of so many bytes.
_MOST_HELD = 256
_MOST_HELD_BYTES = 1_000_000


@dataclass(frozen=True, kw_only=True)
class PacketUse(LidarUse):
    """Everything besides its messages that shapes the files of a lidar with packet messages.

    Attributes:
        model: model of a Velodyne; None to take it from the packets.
        cut_angle_deg: azimuth at which revolutions begin; None to take it from the packets.
        metadata_topic: topic with the correction file of a Hesai; None if it is in a file, or the lidar needs none.
        metadata: content of that file; None if there is none.
    """

    model: str | None
    cut_angle_deg: float | None
    metadata_topic: str | None = omitted()
    metadata: bytes | None = by_digest(None)


@dataclass(frozen=True, eq=False)
class _Lidar:
    """How the packets of a lidar are read.

    Attributes:
        packet: layout of its data packets.
        packet_in: returns the data packet in a payload, or None.
        refusals: returns index -> reason of those of (N,) packets that cannot be used.
        packets: returns packets with their times of arrival.
        decode: returns points of packets whose times are known.
    """

    packet: np.dtype[np.void]
    packet_in: Callable[[bytes], bytes | None]
    refusals: Callable[[NDArray[np.void]], Mapping[int, str]]
    packets: Callable[[NDArray[np.int64], NDArray[np.void]], Packets]
    decode: Callable[[Packets, NDArray[np.int64]], PacketPoints]


def _velodyne_packet(payload: bytes) -> bytes | None:
    return payload if len(payload) == VELODYNE_PACKET_SIZE else None


def _velodyne(use: PacketUse) -> _Lidar:
    """Return how to read the packets of a Velodyne.

    Raises:
        RecipeError: there is no such model, or the recipe names metadata.
    """
    if use.metadata is not None:
        raise RecipeError(
            f"{use.channel}: metadata can be set for packets of Ouster and Hesai only, but {use.settings.topic} carries those of "
            "a Velodyne; remove it from the recipe."
        )
    refusals, decode = PacketFilter(use.model).refusals, RevolutionDecoder(use.model).decode
    return _Lidar(PACKET, _velodyne_packet, refusals, Packets, decode)


def _hesai(use: PacketUse, inputs: Inputs, model: HesaiModel) -> _Lidar:
    """Return how to read the packets of a model.

    Raises:
        RecipeError: it has no correction file, or not one that fits.
    """
    what = f"{use.channel}: the packets in {use.settings.topic} are of a Hesai {model.name}"
    advice = "name the correction file of the lidar (CSV) in `metadata` of the channel."
    if use.metadata is None and use.metadata_topic is None:
        raise RecipeError(f"{what}, and do not say where its channels point; {advice}")
    try:
        lidar = described(partial(HesaiLidar.parse, model), use.metadata_topic, use.metadata, inputs)
    except DecodeError as err:
        where = use.metadata_topic or "the file in `metadata`"
        raise RecipeError(
            f"{what}, but {where} does not say where its channels point: {err}; {advice}"
        ) from err
    packets = partial(HesaiPackets.of, by_log_time=use.settings.clock == "log")
    return _Lidar(model.packet, model.packet_in, lidar.refusals, packets, lidar.decode)


class PacketSweeps:
    """One file per complete revolution of a Velodyne or Hesai; messages are counted by packets.

    Incomplete revolutions, mostly the first and the last one, are lost: training code expects
    complete ones, and the stamp of an incomplete one would be wrong.

    Messages are held for a while, since there are a thousand a second of some lidars: what is to be done with one takes
    less time than a few calls of functions.

    Args:
        use: everything that shapes the files.
        writer: writes the revolutions.
        topic: the topic of the messages.
        inputs: where the correction file of a Hesai is.
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
        inputs: Inputs,
        decode: Callable[[RawMessage], Message],
        fail: Callable[[str, int, int], None],
    ) -> None:
        self.frame_id = ""
        self._use = use
        self._inputs = inputs
        self._writer = writer
        self._topic = topic
        self._decode = decode
        self._fail = fail
        self._lidar = None if use.model is None else _velodyne(use)
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
        if self._lidar is not None:
            for revolution in self._cutter.flush():
                self._write(self._lidar, revolution)

    def _take_held(self) -> None:
        messages, self._held, self._held_bytes = self._held, [], 0
        log_times_ns, self._log_times_ns = np.array(self._log_times_ns, dtype=np.int64), []
        self._failed.clear()
        alike = self._topic.packets(messages, PAYLOADS)
        size = 0 if alike is None else alike.payloads.shape[1]
        lidar = self._lidar or (self._find(alike.payloads[0].tobytes()) if alike else None)
        if alike is not None and lidar is not None and lidar.packet == PACKET and size == PACKET.itemsize:
            # With log times: what a message brings had arrived by then.
            host_ns = log_times_ns if self._by_log_time else alike.stamps_ns
            if host_ns.all():
                self.frame_id = self.frame_id or normalise_frame(alike.frame_id)
                self._writer.files.counts.read += len(messages)
                numbers = np.arange(len(messages))
                self._push(lidar, host_ns, alike.payloads.view(PACKET)[:, 0], log_times_ns, numbers)
                return
        self._take_each(messages, log_times_ns)

    def _take_each(self, messages: Sequence[bytes], log_times_ns: NDArray[np.int64]) -> None:
        found: list[tuple[int, int]] = []  # times of arrival, and numbers of messages
        data_packets: list[bytes] = []
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
                elif (lidar := self._lidar or self._find(payload)) is None:
                    self._refuse(_UNKNOWN, number)
                elif (packet := lidar.packet_in(payload)) is None:
                    self._refuse(f"it holds no data packet of {lidar.packet.itemsize} bytes", number)
                else:
                    found.append((stamp_ns + shift, number))
                    data_packets.append(packet)
        if self._lidar is not None:
            host_ns, numbers = np.array(found, dtype=np.int64).reshape(-1, 2).T
            taken = np.frombuffer(b"".join(data_packets), dtype=self._lidar.packet)
            self._push(self._lidar, host_ns, taken, log_times_ns[numbers], numbers)

    def _find(self, payload: bytes) -> _Lidar | None:
        """Find out from a first data packet which lidar it is; None if that is none.

        Raises:
            RecipeError: it is a Hesai without a correction file that fits, or a Velodyne with one.
        """
        found = packet_and_model(payload)
        if found is not None:
            self._lidar = _hesai(self._use, self._inputs, found[1])
        elif len(payload) == VELODYNE_PACKET_SIZE:
            self._lidar = _velodyne(self._use)
        return self._lidar

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
        lidar: _Lidar,
        host_ns: NDArray[np.int64],
        data: NDArray[np.void],
        log_times_ns: NDArray[np.int64],
        numbers: NDArray[np.int64],
    ) -> None:
        """Take packets.

        Args:
            lidar: which sent them.
            host_ns: (N,) when the host received them.
            data: (N,) of its layout.
            log_times_ns: (N,) log times of their messages.
            numbers: (N,) numbers of their messages.
        """
        refused = lidar.refusals(data)
        for index, reason in refused.items():
            self._refuse(reason, int(numbers[index]))
        if refused:
            kept = np.delete(np.arange(len(data)), list(refused))
            host_ns, data, log_times_ns = host_ns[kept], data[kept], log_times_ns[kept]
        for revolution in self._cutter.push(lidar.packets(host_ns, data), log_times_ns):
            self._write(lidar, revolution)

    def _refuse(self, reason: str, number: int) -> None:
        """Count a packet, or a whole message, that cannot be used."""
        self._fail(reason, 1, 0 if number in self._failed else 1)
        self._failed.add(number)

    def _write(self, lidar: _Lidar, revolution: Revolution) -> None:
        parts = len(revolution.packets)
        if not revolution.complete:
            self._writer.files.lose("incomplete revolution", parts)
            return
        packet_times, end = revolution.times_ns()
        try:
            decoded = lidar.decode(revolution.packets, packet_times)
        except DecodeError as err:
            self._fail(str(err), parts, 1)
            return
        self._writer.files.points.read += len(decoded.points)
        span = (int(packet_times[0]) + decoded.begin_ns, end + decoded.begin_ns)
        self._writer.write(decoded.points, decoded.times_ns, span, revolution.log_time_ns, parts=parts)
