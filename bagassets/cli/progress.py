"""The progress of a build: a live display on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from typing import TYPE_CHECKING, Self

from bagassets.base.quantities import clock_text, count_text
from bagassets.cli.terminal import echo, print_lines
from bagassets.engine.build_report import Event

if TYPE_CHECKING:
    from rich.console import RenderableType

_BAR_WIDTH, _SMALL_BAR_WIDTH = 30, 10
_MOST_SHOWN = 12


class SilentProgress:
    """Shows nothing of the events of a build; the others show them."""

    def __call__(self, event: Event) -> None:
        """Ignore an event."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class LinesProgress(SilentProgress):
    """One line when a recording starts and one when it ends, for logs; on standard error unless `err` is False."""

    def __init__(self, *, err: bool = True) -> None:
        self._err = err
        self._total = self._ended = 0
        self._announced: set[str] = set()
        self._since: dict[str, float] = {}

    def __call__(self, event: Event) -> None:
        """Print an event."""
        now = time.monotonic()
        if event.is_preparation:
            if event.kind not in self._announced:
                echo(event.message, err=self._err)
            self._announced.add(event.kind)
        elif event.kind == "planned":
            self._total = len(event.sizes)
            if self._total:
                verb = "needs" if self._total == 1 else "need"
                echo(f"{count_text(self._total, 'recording')} {verb} a run.", err=self._err)
            for line in event.message.splitlines():
                echo(line, err=self._err)
        elif event.kind == "own":
            self._total, self._ended = len(event.sizes), 0
            echo(event.message, err=self._err)
        elif event.kind == "started":
            self._since[event.key] = now
            echo(f"start    {event.key or 'dataset'}", err=self._err)
        elif event.kind == "where":
            if event.message:
                echo(f"         {event.key or 'dataset'}: {event.message}", err=self._err)
        else:
            self._ended += bool(event.key)
            took = now - self._since.pop(event.key, now)
            place = f"{self._ended}/{self._total} " if event.key else ""
            # The summary says why it failed.
            ahead = f", {event.message}" if event.kind == "done" and event.message else ""
            echo(f"{event.kind:<8} {place}{event.key or 'dataset'} ({took:.1f} s{ahead})", err=self._err)


class LiveProgress(SilentProgress):
    """A bar with done/total and the time left, and a line per active recording, with a bar if it is long.

    The time left is extrapolated from the bytes done so far; it is shown once a recording is done.
    """

    def __init__(self) -> None:
        from rich.console import Console
        from rich.live import Live

        self._sizes: dict[str, int] = {}
        self._since: dict[str, float] = {}
        self._where: dict[str, Event] = {}
        self._done: set[str] = set()
        self._failed = 0
        self._preparing = "scanning recordings …"
        self._counted = "recordings"
        self._began = time.monotonic()
        console = Console(stderr=True, highlight=False)
        self._live = Live(console=console, get_renderable=self.render, transient=True, refresh_per_second=4)

    def __call__(self, event: Event) -> None:
        """Note an event and redraw."""
        now = time.monotonic()
        self._preparing = event.message if event.is_preparation else ""
        if event.kind == "planned":
            self._sizes = dict(event.sizes)
            self._began = now
            if event.message:
                print_lines(self._live.console, event.message)
        elif event.kind == "own":
            self._sizes, self._done, self._failed = dict(event.sizes), set(), 0
            self._began, self._counted = now, "runs"
            print_lines(self._live.console, event.message)
        elif event.kind == "started":
            self._since[event.key] = now
        elif event.kind == "where":
            self._where[event.key] = event
        elif not event.is_preparation:
            self._since.pop(event.key, None)
            self._where.pop(event.key, None)
            self._done.add(event.key)
            self._failed += event.kind == "failed"
            if event.kind == "failed":
                print_lines(self._live.console, f"failed {event.key or 'dataset'}")
        self._live.refresh()

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def render(self) -> "RenderableType":
        """Return the current display."""
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        now = time.monotonic()
        if not self._sizes and not self._since:
            return Text(self._preparing, style="dim")
        # Every recording counts a little more than its bytes, so that empty ones move the bar as well.
        weight = {key: size + 1_000_000 for key, size in self._sizes.items()}
        total = sum(weight.values())
        done = sum(weight.get(key, 0) for key in self._done)
        number = len(self._done & weight.keys())
        text = f"{number}/{len(weight)} {self._counted}, {clock_text(now - self._began)}"
        if done and number < len(weight):
            text += f", about {clock_text((now - self._began) * (total - done) / done)} left"
        if self._failed:
            text += f", {self._failed} failed"
        row = Table.grid(padding=(0, 1))
        row.add_row(ProgressBar(total=max(total, 1), completed=done, width=_BAR_WIDTH), text)
        in_work = Table.grid(padding=(0, 1))
        for key, since in list(self._since.items())[:_MOST_SHOWN]:
            where = self._where.get(key)
            share = None if where is None else where.share
            in_work.add_row(
                Text(
                    f"  {clock_text(now - since)}  {key or 'dataset: linking files and writing tables'}",
                    style="cyan",
                ),
                "" if share is None else ProgressBar(total=1.0, completed=share, width=_SMALL_BAR_WIDTH),
                Text("" if where is None else where.message, style="cyan", no_wrap=True, overflow="ellipsis"),
            )
        # After the runs what they may have changed is planned again.
        return Group(row, in_work, *([Text(self._preparing, style="dim")] if self._preparing else []))


@contextmanager
def planning_shown() -> Iterator[Callable[[int, int], None]]:
    """Show how far planning is, from the first call on: most plans take no longer than a display would be of use."""
    with ExitStack() as stack:
        display = cache(lambda: stack.enter_context(progress_for()))
        yield lambda done, total: display()(Event.planning(done, total))


@contextmanager
def bar_shown(label: str, length: int) -> Iterator[Callable[[int], None]]:
    """Show a bar on a terminal; call what is yielded with how much more is done."""
    import click

    hidden = not sys.stderr.isatty()
    with click.progressbar(length=length, label=label, file=sys.stderr, hidden=hidden) as bar:
        yield bar.update


def progress_for() -> SilentProgress:
    """Return the display for standard error: live on a terminal, lines in a log."""
    return LiveProgress() if sys.stderr.isatty() else LinesProgress()
