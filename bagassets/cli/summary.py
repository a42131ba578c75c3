"""The summary at the end of a build: a table of recordings, the findings of checks, the dataset."""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from bagassets.base.alike import Told, told_once
from bagassets.base.escaping import visible
from bagassets.base.json_types import JsonMapping
from bagassets.base.quantities import count_text, span_text
from bagassets.cli.terminal import print_lines, quoted
from bagassets.engine.build_report import BuildReport, Remark, SummaryRow, remark_lines
from bagassets.formats.nuscenes.schema import NAME as NUSCENES
from bagassets.formats.nuscenes.schema import devkit_split_name

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


_WIDTH_OF_LOGS = 140
_COLOURS = {"built": "green", "hit": "cyan", "failed": "bold red", "stopped": "yellow", "skipped": "dim",
            "not made": "yellow", "error": "bold red", "warn": "yellow"}  # fmt: skip


def print_summary(
    report: BuildReport, rows: Sequence[SummaryRow], recipe_file: Path, console: "Console | None" = None
) -> None:
    """Print the table, the dataset's path and the line that opens the web UI."""
    console = console or summary_console()
    if rows:
        console.print(_table(rows), crop=False)  # narrow terminals wrap it
    found = (((row.result,), row.recording, row.reason) for row in rows if row.reason)
    # The errors of a recording that fails may have several lines.
    _print_once(
        console,
        found,
        lambda one: f"{one.title}: {one.text if 'failed' in one.kind else visible(one.text)}",
        most=len(rows),
    )
    if 0 < len(rows) < len(report.outcomes):
        console.print(
            f"{count_text(len(report.outcomes) - len(rows), 'more recording')}; `bagassets status` lists all."
        )
    excluded = ((path, why) for path, why in report.excluded.items() if not why.startswith("not matched"))
    left_out = (((), name, reason) for name, reason in (*excluded, *report.left_out.items()))
    _print_once(console, left_out, lambda one: f"left out {visible(one.title)}: {visible(one.text)}")
    copies = ((("copy", first), copy, "") for copy, first in report.duplicates.items())
    _print_once(
        console,
        copies,
        lambda one: f"copy {one.title}: the same content as {one.kind[1]}, which is in the dataset for both",
        "`dataset.lock.json` lists all",
    )
    for key in report.removed:
        print_lines(console, f"removed {key}")
    moved = (
        ((), key, move_text(was, now, is_pinned=key in report.pinned))
        for key, (was, now) in report.moved.items()
    )
    _print_once(
        console,
        moved,
        lambda one: f"moved {one.title}: {one.text}",
        "`dataset.lock.json` has the splits of all",
    )
    print_remarks(report.remarks, console)
    print_lines(console, counts_line(report))
    _print_dataset(report, console)
    _print_own(report, console)
    print_lines(console, f"web UI:  {ui_command(recipe_file)}")


def move_text(was: str, now: str, *, is_pinned: bool) -> str:
    """Return from and to which split a recording moves, and why, or what keeps it where it is."""
    why = ", as `splits.pinned` says" if is_pinned else "; pin it in `splits.pinned` to keep it where it is"
    return f"from {was} to {now}{why}"


def _print_once(
    console: "Console",
    found: Iterable[tuple[tuple[str, ...], str, str]],
    line: Callable[[Told], str],
    rest: str = "`bagassets status` lists all",
    most: int = 12,
) -> None:
    """Print what is said of recordings, what is alike once.

    Args:
        console: where to print.
        found: see `told_once`; if the kind begins with a result or severity, so does the line, in its colour.
        line: what to print of those that are alike.
        rest: where all are listed, for those that are only counted here.
        most: most lines.
    """
    told = told_once(found)
    for one in told[:most]:
        if one.kind and one.kind[0] in _COLOURS:
            console.print(f"[{_COLOURS[one.kind[0]]}]{one.kind[0]}[/] ", end="")
        print_lines(console, line(one))
    if more := sum(len(one.names) for one in told[most:]):
        console.print(f"{more} more; {rest}.")


def summary_console() -> "Console":
    """Return a console for stdout."""
    from rich.console import Console

    return Console(highlight=False, width=None if sys.stdout.isatty() else _WIDTH_OF_LOGS)


def counts_line(report: BuildReport) -> str:
    """Return the number of recordings by result, and the time taken, as one line."""
    counts = [f"{number} {result}" for result, number in report.counts().items() if number]
    return f"{', '.join(counts) or 'no recordings'} in {report.seconds:.1f} s"


def ui_command(recipe_file: Path) -> str:
    """Return the command that opens the web UI from the current folder."""
    if recipe_file.absolute() == Path.cwd() / "recipe.yaml":
        return "bagassets ui"
    return f"bagassets ui --recipe {quoted(recipe_file)}"


def print_remarks(remarks: Sequence[Remark], console: "Console") -> None:
    """Print the findings of checks, each severity in its colour; see `remark_lines`."""
    for line in remark_lines(remarks):
        severity, space, rest = line.partition(" ")
        is_remark = severity in _COLOURS
        if is_remark:
            console.print(f"[{_COLOURS[severity]}]{severity}[/]", end=space)
        print_lines(console, rest if is_remark else line)


def _print_dataset(report: BuildReport, console: "Console") -> None:
    for one in report.datasets.values():
        state = {"fresh": "up to date", "stopped": "not updated"}.get(one["state"], one["state"])
        print_lines(console, f"dataset: {one['path']} ({state})")
    if report.dataset_problem:
        print_lines(console, f"         {report.dataset_problem}")
    has_recordings = any(share["recordings"] for share in report.splits.values())
    if report.splits and report.outcomes and not has_recordings:
        print_lines(console, "         It is empty: no recording can be part of it, for the reasons above.")
    if has_recordings:
        print_lines(
            console,
            f"splits:  {splits_text(report.splits, of_nuscenes=f'{NUSCENES}_dataset' in report.datasets)}",
        )


def _print_own(report: BuildReport, console: "Console") -> None:
    """Print what became of the user's own assets."""
    if report.own_problem:
        console.print("[bold red]error[/] ", end="")
        print_lines(console, visible(report.own_problem))
    for name, one in report.own.items():
        counted = ", ".join(
            f"{number} {result}" if one.per_recording else result for result, number in one.results.items()
        )
        print_lines(console, f"{name}: {counted or 'no recordings'}")
        reasons = (((result, name), key, reason) for key, (result, reason) in one.reasons.items())
        _print_once(
            console,
            reasons,
            lambda one: f"{one.kind[1]}{f' of {one.title}' if one.title else ''}: {visible(one.text)}",
        )
    for name, why in report.own_left_out.items():
        print_lines(console, f"{name}: not made ({why})")


def splits_text(splits: Mapping[str, JsonMapping], *, of_nuscenes: bool = True) -> str:
    """Return the share of each split, the share asked for if that is far off, and its name in the devkit of nuScenes."""
    parts = []
    has_time = any(share["share"] for share in splits.values())  # not if each recording is but a moment
    for name, share in splits.items():
        asked = f", {share['asked']:.0%} asked for" if share["is_far"] else ""
        is_useless = share["recordings"] and not share["duration_s"]
        part = "with nothing for the dataset" if is_useless else f"{share['share']:.0%} of the time"
        time = f" ({part}{asked})" if has_time else ""
        parts.append(f"{name} {share['recordings']}{time}")
    renamed = [devkit_split_name(name) for name in splits if of_nuscenes and devkit_split_name(name) != name]
    return ", ".join(parts) + (f"; in the devkit {', '.join(renamed)}" if renamed else "")


def _table(rows: Sequence[SummaryRow]) -> "Table":
    from rich import box
    from rich.table import Table
    from rich.text import Text

    known = [["" if number is None else f"{number}" for number in row.counts.values()] for row in rows]
    cells = [
        [row.format or "", span_text(row.span_s), *one, row.result]
        for row, one in zip(rows, known, strict=True)
    ]
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=0)
    table.add_column("recording", overflow="fold", min_width=9)
    headings = ["format", "span", *rows[0].counts, "result"]
    for heading, column in zip(headings, zip(*cells, strict=True), strict=True):
        justify: Literal["left", "right"] = "left" if heading in {"format", "result"} else "right"
        least = max(len(text) for text in column)
        table.add_column(heading, justify=justify, overflow="fold", min_width=least)
    for row, texts in zip(rows, cells, strict=True):
        table.add_row(row.recording, *texts[:-1], Text(row.result, style=_COLOURS.get(row.result, "")))
    return table
