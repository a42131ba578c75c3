"""The topics of a recording, from its connections, of which several may carry one topic.

Those whose messages are not ROS, but protobuf or JSON, are decoded by the schema recorded with them.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from bagassets.base.errors import DecodeError, SizeLimitError
from bagassets.recipe.model import Limits
from bagassets.recordings.heads import first_head_of
from bagassets.recordings.layouts import Choice
from bagassets.recordings.model import Message
from bagassets.recordings.schemas import Schema, schema_of
from bagassets.recordings.topic import UNKNOWN, RefusedBytes, Topic, TopicSource, one_name


class SchemaTopic(Topic):
    """A topic with a schema. It has none of ROS's layouts, so nothing is read of a message without decoding it."""

    @cached_property
    def _layouts(self) -> Choice | str:
        return "its messages are not those of ROS"

    @cached_property
    def _schema(self) -> Schema | str:
        if len(self._own.text) > self._limits.definition_bytes:
            return f"the schema of {self.msgtype} is larger than limits.definition_bytes in the recipe allows"
        return schema_of(self.msgtype, self.serialization, self._own, self._limits.message_elements)

    def _definition_problem(self) -> str | None:
        return self._schema if isinstance(self._schema, str) else None

    def decode(self, data: bytes | memoryview) -> Message:
        """Return a message as an object with the fields of its schema; see `Topic.decode`."""
        if isinstance(data, RefusedBytes):
            raise DecodeError(data.reason)
        if self._refused or isinstance(self._schema, str):
            raise DecodeError(self._refused or str(self._schema))
        return self._schema.decode(bytes(data))

    def header(self, data: bytes | memoryview) -> tuple[int, str] | None:
        """Return stamp and frame id of a message that has them; see `first_head_of`."""
        try:
            return first_head_of(self.decode(data))
        except DecodeError:
            return None

    @property
    def layout_digest(self) -> str:
        """Digest of the schema; empty without one."""
        return "" if isinstance(self._schema, str) else self._schema.digest


def topic_of(source: TopicSource, message_definitions: Sequence[Path], limits: Limits) -> Topic:
    """Return a topic, which decodes messages as they are serialized."""
    kind = Topic if source.serialization in {"ros1", "cdr"} else SchemaTopic
    return kind(source, message_definitions, limits)


def merge_topics(
    path: Path, sources: Iterable[TopicSource], message_definitions: Sequence[Path], limits: Limits
) -> dict[str, Topic]:
    """Return the topics of a recording, sorted by name.

    Args:
        path: the recording, for error messages.
        sources: its connections; several may carry one topic. Its type is that of most messages, the others are lost.
            A topic with two layouts of its type cannot be decoded.
        message_definitions: as for `Topic`.
        limits: as for `Topic`.

    Raises:
        SizeLimitError: there are more than the limits allow.
    """
    groups: dict[str, list[TopicSource]] = {}
    for source in sources:
        groups.setdefault(source.topic, []).append(source)
    if len(groups) > limits.topics:
        raise SizeLimitError(
            f"{path}: it has {len(groups)} topics; if you trust the recording, raise limits.topics in the recipe."
        )
    # Topics of one type may be recorded with different definitions: each is decoded with its own.
    return {
        name: topic_of(_merged(group, limits), message_definitions, limits)
        for name, group in sorted(groups.items())
    }


def _merged(group: Sequence[TopicSource], limits: Limits) -> TopicSource:
    counts: Counter[str] = Counter()
    for source in group:
        counts[one_name(source.msgtype)] += source.count
    # Of equals the first that is more than a bare value, which a sensor's topic has by mistake.
    most = max(counts, key=lambda one: (one != UNKNOWN, counts[one], not one.startswith("std_msgs/")))
    merged, *others = (source for source in group if one_name(source.msgtype) == most)
    for other in others:
        merged = _joined(merged, replace(other, msgtype=merged.msgtype), limits)
    return replace(merged, count=counts.total(), is_latched=any(source.is_latched for source in group))


def latched_topics(sources: Iterable[TopicSource]) -> list[str]:
    """Return, sorted, the topics whose messages hold until the next one; `tf_static` does, whatever its publisher says."""
    return sorted(
        {one.topic for one in sources if one.is_latched or one.topic.rpartition("/")[2] == "tf_static"}
    )


def _joined(one: TopicSource, other: TopicSource, limits: Limits) -> TopicSource:
    problem = one.problem or other.problem
    if one.serialization != other.serialization:
        problem = f"its messages are encoded in two ways, {one.serialization} and {other.serialization}"
    elif _contradict(one, other, limits):
        problem = f"its messages were recorded with two different definitions of {other.msgtype}"
    definition = one.definition if one.definition.text else other.definition
    return replace(one, problem=problem, definition=definition)


def _contradict(one: TopicSource, other: TopicSource, limits: Limits) -> bool:
    """Tell whether the same bytes would decode differently; comments make no difference."""
    if one.definition == other.definition or not one.definition.text or not other.definition.text:
        return False
    topics = [topic_of(replace(source, problem=None), (), limits) for source in (one, other)]
    return len({topic.problem or topic.layout_digest for topic in topics}) > 1
