"""What the sensor remembers from one look at the recordings to the next."""

import json
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, field

from bagassets.recordings.digest import RecordingStat
from bagassets.store.canonical import digest_json

__all__ = ["Cursor", "Request"]

# A run that ended badly for no reason that the plan knows is asked for again, but not for ever.
MOST_TRIES = 3
RETRY_S = 60.0


@dataclass(frozen=True)
class Request:
    """A run that was asked for.

    Attributes:
        what: digest of what it should make of what.
        tries: how often it was asked for.
        at_s: when last, in Unix seconds.
    """

    what: str
    tries: int
    at_s: float


@dataclass
class Cursor:
    """What a look remembers for the next; small, however many recordings there are.

    Attributes:
        watched: key of a recording that is new or changed -> digest of sizes and times, and since
            when they hold (Unix seconds).
        asked: key -> the last request, as long as it was not met.
        looked_s: when the recordings were looked at last.
        busy_since_s: since when runs have been active without a pause, or None.
        empty_since_s: since when there has been no recording at all where there were several, or None.
        runs: number of runs asked for, which makes run keys unique.
        quiet: digest of everything that the last look depended on, if there was nothing to do; else empty.
        said: what was told about that look.
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
        """Return the cursor in `text`; an unreadable one is as good as none."""
        try:
            value = json.loads(text or "{}")
            value["watched"] = {key: (str(e[0]), float(e[1])) for key, e in value["watched"].items()}
            value["asked"] = {key: Request(*entry) for key, entry in value["asked"].items()}
            return cls(**value)
        except (ValueError, KeyError, TypeError, AttributeError, IndexError):
            return cls()

    def text(self) -> str:
        """Return the cursor as text."""
        asked = {key: [request.what, request.tries, request.at_s] for key, request in self.asked.items()}
        return json.dumps({**self.__dict__, "asked": asked}, sort_keys=True)

    # --- settling ------------------------------------------------------------------------

    def settle(
        self,
        stats: Mapping[str, RecordingStat],
        known: Container[str],
        settle_s: float,
        now_s: float,
    ) -> set[str]:
        """Note how the recordings look now, and return the keys of those that are finished.

        A recording is finished if it is one of the `known`, which are recorded as they are, or has kept its
        sizes and times for `settle_s`. Its change is dated by the file's own time if that lies between this look and the one
        before it: then the clocks agree. Else by this look, whatever the clock of a file server says.
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
        """Return when the next recording will have settled if it is not written any more, or None."""
        done = set(finished)
        times = [since_s + settle_s for key, (_, since_s) in self.watched.items() if key not in done]
        return min(times, default=None)

    # --- asking --------------------------------------------------------------------------

    def ask(self, key: str, what: str, now_s: float) -> bool:
        """Tell whether to ask for `what`, and note that; not if the same was asked for a while ago or too often."""
        before = self.asked.get(key)
        if before is None or before.what != what:
            tries = 1
        elif before.tries < MOST_TRIES and now_s - before.at_s >= RETRY_S * before.tries:
            tries = before.tries + 1
        else:
            return False
        self.asked[key] = Request(what, tries, now_s)
        self.runs += 1
        return True

    @property
    def may_ask_again(self) -> bool:
        """True if something that was asked for is not there, and will be asked for again."""
        return any(request.tries < MOST_TRIES for request in self.asked.values())

    def give_up(self, key: str, what: str) -> None:
        """Ask for `what` no more, as somebody did not want it."""
        before = self.asked.get(key)
        if before is not None and before.what == what:
            self.asked[key] = Request(what, MOST_TRIES, before.at_s)

    def forget(self, keys: Iterable[str]) -> None:
        """Drop requests that were met, or whose recordings are gone."""
        for key in keys:
            self.asked.pop(key, None)
