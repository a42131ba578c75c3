"""One pass over a recording that fills every stale channel at once.

Passes are what costs: reading topic after topic from a compressed recording would
decompress each chunk once per topic.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from bagassets.bags.model import RawMessage, Recording
from bagassets.errors import BagAssetsError
from bagassets.steps.channel import ChannelExtractor
from bagassets.store.store import Outcome, Pending, Store

__all__ = ["ChannelJob", "run_pass"]


@dataclass(frozen=True)
class ChannelJob:
    """A channel to extract: where it goes, and how its extractor is made."""

    channel: str
    pending: Pending
    make_extractor: Callable[[Pending], ChannelExtractor]


def run_pass(
    recording: Recording,
    jobs: Sequence[ChannelJob],
    store: Store,
    verify_unchanged: Callable[[], None],
    on_message: Callable[[RawMessage], None] | None = None,
) -> tuple[dict[str, Outcome], dict[str, BagAssetsError]]:
    """Read the topics of all `jobs` once and finish each job.

    A job that fails does not stop the others: its error is recorded under its action and
    returned by channel. `verify_unchanged` is called after the last message and before
    anything is recorded.

    Returns:
        channel -> outcome, and channel -> error.

    Raises:
        RecordingError: the recording is damaged or changed while it was read; nothing is recorded.
    """
    errors: dict[str, BagAssetsError] = {}
    extractors: dict[str, ChannelExtractor] = {}
    try:
        for job in jobs:
            try:
                extractors[job.channel] = job.make_extractor(job.pending)
            except BagAssetsError as err:
                errors[job.channel] = err
        _feed(recording, extractors, errors, on_message)
        summaries = {}
        for channel, extractor in extractors.items():
            try:
                summary = extractor.finish()
            except BagAssetsError as err:
                errors.setdefault(channel, err)
            else:
                if channel not in errors:
                    summaries[channel] = summary
        verify_unchanged()
    except BaseException:
        for job in jobs:
            job.pending.discard()
        raise
    outcomes = {}
    for job in jobs:
        if job.channel in errors:
            job.pending.discard()
            store.record_failure(job.pending.action, str(errors[job.channel]))
        else:
            outcomes[job.channel] = job.pending.commit(summaries[job.channel])
    return outcomes, errors


def _feed(
    recording: Recording,
    extractors: Mapping[str, ChannelExtractor],
    errors: dict[str, BagAssetsError],
    on_message: Callable[[RawMessage], None] | None,
) -> None:
    listeners: dict[str, list[tuple[str, ChannelExtractor]]] = {}
    for channel, extractor in extractors.items():
        for topic in extractor.topics:
            listeners.setdefault(topic, []).append((channel, extractor))
    if not listeners:
        return
    for message in recording.messages(sorted(listeners)):
        for channel, extractor in listeners[message.topic]:
            if channel in errors:
                continue
            try:
                extractor.add(message)
            except BagAssetsError as err:
                errors[channel] = err
        if on_message is not None:
            on_message(message)
