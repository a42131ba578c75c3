"""What the sensor remembers from one scan to the next."""

import json
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from bagassets.recordings.digest import RecordingStat
from bagassets.store.canonical import digest_json


class Request(NamedTuple):
    """A run that was requested.

    Attributes:
        what: digest of the state of the recording and of the assets to make.
        tries: how often it was requested.
        at_s: when it was last requested (Unix seconds).
    """

    what: str
    tries: int
    at_s: float


@dataclass
class Cursor:
    """What a scan keeps for the next; small, however many recordings there are.

    The names of its fields are on record in Dagster instances.

    Attributes:
        watched: key of a recording that is new or changed -> digest of its sizes and times, and since when they have
            been the same (Unix seconds).
        asked: key -> its last request, until that is met.
        looked_s: when the last scan was (Unix seconds).
        busy_since_s: since when runs have been active without a pause, or None.
        empty_since_s: since when there has been no recording at all where there were several, or None.
        runs: number of runs requested, which makes run keys unique.
        quiet: digest of everything that the last scan depended on, if it found nothing to do; else empty.
        said: the message of that scan.
    """

    watched: dict[str, tuple[str, float]] = field(default_factory=dict)
    asked: dict[str, Request] = field(default_factory=dict)
    looked_s: float | None = None
    busy_since_s: float | None = None
    empty_since_s: float | None = None
    runs: int = 0
    quiet: str = ""
    said: str = ""

    @classmethod
    def parse(cls, text: str | None) -> "Cursor":
        """Return the cursor in `text`; a new one if it is unreadable."""
        try:
            value = json.loads(text or "{}")
            value["watched"] = {key: (str(e[0]), float(e[1])) for key, e in value["watched"].items()}
            value["asked"] = {key: Request(*entry) for key, entry in value["asked"].items()}
            return cls(**value)
        except (ValueError, KeyError, TypeError, AttributeError, IndexError):
            return cls()

    def text(self) -> str:
        """Return the cursor as text."""
        return json.dumps(self.__dict__, sort_keys=True)

    # --- settling ------------------------------------------------------------------------

    def settle(
        self,
        stats: Mapping[str, RecordingStat],
        known: Container[str],
        settle_s: float,
        now_s: float,
    ) -> set[str]:
        """Note the current sizes and times of the recordings, and return the keys of those that are finished.

        A recording is finished if it is `known` (recorded in Dagster as it is now), or has kept its sizes and times for
        `settle_s`. A change is dated by the file's own time if that lies between the last scan and this one, for then
        the clocks agree; else by this scan, whatever the clock of a file server says.
        """
        finished, watched = set(), {}
        for key, stat in stats.items():
            if key in known:
                finished.add(key)
                continue
            state = digest_json(stat.as_json())
            before = self.watched.get(key)
            if before is not None and before[0] == state:
                since_s = before[1]
            else:
                changed_s = max((mtime_ns for _, _, mtime_ns in stat.files), default=0) / 1e9
                has_seen_it_come = self.looked_s is not None and self.looked_s <= changed_s <= now_s
                since_s = changed_s if has_seen_it_come else now_s
            watched[key] = (state, since_s)
            if now_s - since_s >= settle_s:
                finished.add(key)
        self.watched = watched
        self.looked_s = now_s
        return finished

    def next_settled_s(self, settle_s: float, finished: Iterable[str]) -> float | None:
        """Return when the next recording will have settled, if nobody writes to it any more, or None."""
        done = set(finished)
        times = [since_s + settle_s for key, (_, since_s) in self.watched.items() if key not in done]
        return min(times, default=None)

    # --- asking --------------------------------------------------------------------------

    def tried(self, key: str, what: str) -> tuple[int, float]:
        """Return how often `what` was requested, and when it was last (Unix seconds)."""
        before = self.asked.get(key)
        return (before.tries, before.at_s) if before is not None and before.what == what else (0, 0.0)

    def ask(self, key: str, what: str, now_s: float) -> None:
        """Note that `what` is requested."""
        self.asked[key] = Request(what, self.tried(key, what)[0] + 1, now_s)
        self.runs += 1

    def forget(self, keys: Iterable[str]) -> None:
        """Drop requests that were met, or whose recordings are gone."""
        for key in keys:
            self.asked.pop(key, None)
