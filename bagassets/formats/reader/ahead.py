"""Samples in order; threads decode the files of those that come next while the caller works on one."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future

S = TypeVar("S")
T = TypeVar("T")
_NEXT = 2  # samples; with one, threads would wait for the last of its files


@dataclass
class Ahead:
    """The methods of a sample that the caller has given a channel, and those that threads have begun: by channel."""

    asked: dict[str, Callable[[Any, str], object]] = field(default_factory=dict)
    begun: "dict[str, Future[Any]]" = field(default_factory=dict)

    def take(self, channel: str, method: Callable[[Any, str], object], read: Callable[[], T]) -> T:
        """Return what a thread has made of a channel, which is handed out once, or else what `read` makes now."""
        self.asked[channel] = method
        return self.begun.pop(channel).result() if channel in self.begun else read()


def in_order(numbers: range, make: Callable[[int, Ahead], S]) -> Iterator[S]:
    """Yield what `make` makes of each number; what the caller asks of one is read ahead for the next ones."""
    from concurrent.futures import ThreadPoolExecutor, wait

    process, aheads = os.getpid(), dict[int, Ahead]()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for place, number in enumerate(numbers, 1):
            ahead = aheads.pop(number, None) or Ahead()
            wait(ahead.begun.values())  # so that whoever has it may fork
            yield make(number, ahead)
            if os.getpid() != process:  # a fork has none of the threads, and goes on without
                aheads.clear()
                continue
            for following in numbers[place : place + _NEXT]:
                begun = aheads.setdefault(following, Ahead()).begun
                for channel in ahead.asked.keys() - begun.keys():
                    begun[channel] = pool.submit(ahead.asked[channel], make(following, Ahead()), channel)
            ahead.begun.clear()
