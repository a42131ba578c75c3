"""Interrupts that wait for a good moment."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


class Interrupt:
    """Whether somebody asked to stop.

    Attributes:
        asked: True from the first signal on.
    """

    def __init__(self) -> None:
        self.asked = False

    def receive(self, _number: int, _frame: FrameType | None) -> None:
        """Note the first signal; raise KeyboardInterrupt at the second one.

        Raises:
            KeyboardInterrupt: somebody insists.
        """
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


@contextmanager
def deferred_interrupts() -> Iterator[Interrupt]:
    """Note the first signal that would raise KeyboardInterrupt; whoever waits in a loop looks at the note.

    Python raises KeyboardInterrupt wherever the process happens to be. In a finalizer or a callback of the garbage
    collector it is printed and lost, and in the middle of a read so is what was read.

    Signals reach the main thread only; in another one nothing is changed, and nothing noted.
    """
    interrupt = Interrupt()
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    deferred = [number for number in numbers if signal.getsignal(number) is signal.default_int_handler]
    with signals_handled(interrupt.receive, *deferred):
        yield interrupt


@contextmanager
def signals_handled(how: Callable[..., object] | signal.Handlers, *numbers: signal.Signals) -> Iterator[None]:
    """Have signals handled by something else meanwhile, but for a SIGHUP that `nohup` ignores.

    In another thread than the main one, nothing is changed.
    """
    is_main = threading.current_thread() is threading.main_thread()
    kept = {signal.SIGHUP} if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else set()
    before = {number: signal.signal(number, how) for number in numbers if is_main and number not in kept}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Have Ctrl-C wait meanwhile; processes that are started then never get it, as they inherit what is blocked."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
