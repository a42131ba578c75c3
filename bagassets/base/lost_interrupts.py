"""Interrupts that Python would print and forget."""

import signal
import sys

_SOON_S = 0.01


def interrupt_soon(lost: "sys.UnraisableHookArgs") -> None:
    """Interrupt again soon where Python would print that and go on: in a finalizer, or a callback of an import.

    For `sys.unraisablehook` of a process that ends by an interrupt.
    """
    if issubclass(lost.exc_type, KeyboardInterrupt):
        signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
        signal.setitimer(signal.ITIMER_REAL, _SOON_S)
    else:
        sys.__unraisablehook__(lost)
