"""The pack: small messages of a recording, kept in its inventory so that other assets need not open it again."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from bagassets.base.columns import column
from bagassets.recipe.model import Limits
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.merge_topics import merge_topics
from bagassets.recordings.model import RawMessage
from bagassets.recordings.recording import Recording
from bagassets.recordings.topic import TopicSource
from bagassets.store.artifact import ArtifactWriter

PACK_FILE = "messages.parquet"

_BATCH = 4096  # messages in memory at a time
_KEPT_BYTES = 4 << 20

PACK_SCHEMA = pa.schema({"topic": pa.string(), "log_time_ns": pa.int64(), "data": pa.binary()})


def write_pack(out: ArtifactWriter, messages: Sequence[RawMessage]) -> None:
    """Write messages, which must be in order of log time, as the pack of an artifact."""
    arrays = [
        column([message.topic for message in messages], pa.string()),
        column([message.log_time_ns for message in messages], pa.int64()),
        column([message.data for message in messages], pa.binary()),
    ]
    out.write_table(PACK_FILE, pa.Table.from_arrays(arrays, schema=PACK_SCHEMA))


class Pack:
    """The pack in a file of an inventory artifact; a small one is read only once, though several assets ask for it.

    Args:
        path: `messages.parquet`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._kept: list[pa.RecordBatch] = []

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield its messages (see `PACK_SCHEMA`), a batch at a time."""
        if self._kept:
            yield from self._kept
            return
        # Not by `pyarrow.compute`: to import it takes longer than to read the packs of many a recording.
        file = pq.ParquetFile(self.path)
        for batch in file.iter_batches(_BATCH, use_threads=False):
            if batch.num_rows == file.metadata.num_rows and batch.nbytes <= _KEPT_BYTES:
                self._kept = [batch]
            yield batch


class PackedRecording(Recording):
    """The packed topics of a recording, read from an inventory artifact.

    Args:
        inventory: of the artifact.
        pack: of the same artifact.
        limits: bounds on definitions and messages; by default those of an empty recipe.
    """

    def __init__(self, inventory: Inventory, pack: Pack, limits: Limits | None = None) -> None:
        self._pack = pack
        sources = [
            TopicSource(
                topic.name, topic.msgtype, topic.count, topic.definition, topic.serialization, topic.problem
            )
            for topic in inventory.topics.values()
            if topic.packed
        ]
        topics = merge_topics(pack.path, sources, (), limits or Limits())
        super().__init__(pack.path, inventory.format, topics)

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        for batch in self._pack.batches():
            times_ns, payloads = batch.column("log_time_ns").to_pylist(), batch.column("data")
            for row, topic in enumerate(batch.column("topic").to_pylist()):
                if topic in topics:
                    yield RawMessage(topic, self.topics[topic].msgtype, times_ns[row], payloads[row].as_py())
