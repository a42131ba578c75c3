"""One pass over a recording that fills every stale channel at once.

Passes are what costs: reading topic after topic from a compressed recording would
decompress each chunk once per topic.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

from bagassets.bags.model import Recording
from bagassets.engine.process import encoders
from bagassets.engine.unexpected import in_words
from bagassets.errors import BagAssetsError, StoreError
from bagassets.steps.channel import ChannelExtractor
from bagassets.store.action import Action
from bagassets.store.artifact import ArtifactWriter
from bagassets.store.store import Outcome, Store

__all__ = ["ChannelJob", "run_pass"]


@dataclass(frozen=True)
class ChannelJob:
    """A channel to extract.

    Attributes:
        channel: its name.
        action: what is to be done.
        topics: what it reads.
        make_extractor: makes the extractor that writes into an artifact, with threads or without.
    """

    channel: str
    action: Action
    topics: tuple[str, ...]
    make_extractor: Callable[[Recording, ArtifactWriter, Executor | None], ChannelExtractor]


def run_pass(
    recording: Recording,
    jobs: Sequence[ChannelJob],
    store: Store,
    verify_unchanged: Callable[[], None],
    *,
    threads: int = 1,
) -> tuple[dict[str, Outcome], dict[str, BagAssetsError]]:
    """Read the topics of all `jobs` once and finish each job.

    A job that fails does not stop the others: its error is recorded under its action and
    returned by channel. `verify_unchanged` is called after the last message and before
    anything is recorded. All channels share `threads` threads.

    Returns:
        channel -> outcome, and channel -> error.

    Raises:
        RecordingError: the recording is damaged or changed while it was read; nothing is recorded.
    """
    errors: dict[str, BagAssetsError] = {}
    extractors: dict[str, ChannelExtractor] = {}
    summaries: dict[str, dict[str, Any]] = {}
    pending = {job.channel: store.begin(job.action) for job in jobs}
    try:
        with encoders(threads) as pool:
            for job in jobs:
                try:
                    extractors[job.channel] = job.make_extractor(recording, pending[job.channel].out, pool)
                except Exception as err:  # noqa: BLE001  (whatever it is, it costs one channel)
                    errors[job.channel] = in_words(err, recording.path, job.channel)
            _feed(recording, extractors, errors)
            for channel, extractor in extractors.items():
                if channel in errors:
                    continue
                try:
                    summaries[channel] = extractor.finish()
                except Exception as err:  # noqa: BLE001  (as above)
                    errors[channel] = in_words(err, recording.path, channel)
        verify_unchanged()
    except BaseException:
        for unfinished in pending.values():
            unfinished.discard()
        raise
    outcomes = {}
    for channel, running in pending.items():
        if channel in errors:
            running.discard()
            if not errors[channel].transient:
                store.record_failure(running.action, str(errors[channel]), recording.path)
        else:
            try:
                outcomes[channel] = running.commit(summaries[channel])
            except StoreError as err:  # a full disk: what other channels have is kept
                errors[channel] = err
    return outcomes, errors


def _feed(
    recording: Recording,
    extractors: Mapping[str, ChannelExtractor],
    errors: dict[str, BagAssetsError],
) -> None:
    """Hand each message to the extractors of its topic; one that fails gets no more of them."""
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
            except Exception as err:  # noqa: BLE001  (as above)
                errors[channel] = in_words(err, recording.path, channel)
