"""The topics of a recording, from its connections, of which several may carry one topic."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from bagassets.base.errors import SizeLimitError
from bagassets.recipe.model import Limits
from bagassets.recordings.schema_topic import SchemaTopic
from bagassets.recordings.topic import UNKNOWN, Topic, TopicSource, one_name


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
