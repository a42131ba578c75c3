"""The pack: small messages of a recording, kept in its inventory so that other assets need not open it again."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from bagassets.base.columns import column
from bagassets.base.json_types import JsonMapping
from bagassets.recipe.model import Limits
from bagassets.recordings.merge_topics import merge_topics
from bagassets.recordings.model import Definition, RawMessage, Serialization
from bagassets.recordings.recording import Recording
from bagassets.recordings.topic import TopicSource
from bagassets.store.artifact import ArtifactWriter

PACK_FILE = "messages.parquet"

_BATCH = 4096  # messages in memory at a time

PACK_SCHEMA = pa.schema({"topic": pa.string(), "log_time_ns": pa.int64(), "data": pa.binary()})


def write_pack(out: ArtifactWriter, messages: Sequence[RawMessage]) -> None:
    """Write messages, which must be in order of log time, as the pack of an artifact."""
    arrays = [
        column([message.topic for message in messages], pa.string()),
        column([message.log_time_ns for message in messages], pa.int64()),
        column([message.data for message in messages], pa.binary()),
    ]
    out.write_table(PACK_FILE, pa.Table.from_arrays(arrays, schema=PACK_SCHEMA))


class PackedRecording(Recording):
    """The packed topics of a recording, read from an inventory artifact.

    Args:
        inventory: content of `inventory.json`.
        parquet: `messages.parquet` of the same artifact.
        limits: bounds on definitions and messages; by default those of an empty recipe.
    """

    def __init__(self, inventory: JsonMapping, parquet: Path, limits: Limits | None = None) -> None:
        self._parquet = parquet
        sources = []
        for topic in inventory["topics"]:
            if not topic["packed"]:
                continue
            definition = Definition(**topic["definition"])
            serialization: Serialization = topic["serialization"]
            sources.append(
                TopicSource(
                    topic["name"], topic["type"], topic["count"], definition, serialization, topic["problem"]
                )
            )
        super().__init__(parquet, inventory["format"], merge_topics(parquet, sources, (), limits or Limits()))

    def _read(self, topics: Collection[str]) -> Iterator[RawMessage]:
        # Not by `pyarrow.compute`: to import it takes longer than to read the packs of many a recording.
        for batch in pq.ParquetFile(self._parquet).iter_batches(_BATCH, use_threads=False):
            times_ns, payloads = batch.column("log_time_ns").to_pylist(), batch.column("data")
            for row, topic in enumerate(batch.column("topic").to_pylist()):
                if topic in topics:
                    yield RawMessage(topic, self.topics[topic].msgtype, times_ns[row], payloads[row].as_py())

    def close(self) -> None:
        """Do nothing: the file is open during reads only."""
