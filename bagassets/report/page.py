"""The report: one self-contained HTML page about the whole dataset."""

from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from bagassets.base.alike import Told, told_once, without_path
from bagassets.base.escaping import html
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text, readable_length, span_text
from bagassets.engine.splits import SplitShare
from bagassets.report.grid_map import colour_of_split, grid_map, legend
from bagassets.report.model import RecordingFacts, ReportData
from bagassets.report.style import LEGEND_SCRIPT, PAGE_CSS, TABLE_SCRIPT

# Total size of the pictures on a page, before base64 makes four bytes of three.
PICTURE_BYTES = 2_700_000
_MOST_GAPS = 5
_MOST_PROBLEMS = 500
_SINGULAR = {"boxes": "box"}
_FACTS = ("state", "reason", "format", "rig", "split", "size", "start_ns", "duration_s", "length_m", "daylight", "counts",
          "boxes", "lost")  # fmt: skip
_COLOURS = {"error": "failed", "warn": "stale"}


def report_page(data: ReportData) -> str:
    """Return the page.

    Pictures share a budget: few recordings show all their pictures, many show a thumbnail each.
    """
    chosen = _chosen_pictures(data.recordings)
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">',
        f"<title>{html(data.name)}: dataset report</title>",
        f"<style>{PAGE_CSS}</style></head><body>",
        f"<h1>{html(data.name)}</h1>",
        f'<p class="dim">Dataset in <code>{html(str(data.dataset))}</code></p>',
        _cards(data),
        _split_table(data.shares),
        _idle_pins(data.idle_pins),
        _map(data),
        _left_out(data),
        _checks(data),
        _categories(_in_dataset(data)),
        "<h2>Recordings</h2>",
        '<input id="filter" placeholder="filter" aria-label="Filter recordings">',
        '<table id="recordings"><thead><tr>',
        *(f'<th class="{kind}">{name}</th>' for name, kind in _columns(data)),
        "</tr></thead><tbody>",
        *(_row(number, one, chosen[one.key], data.counted) for number, one in enumerate(data.recordings)),
        "</tbody></table>",
        f"<script>{LEGEND_SCRIPT}{TABLE_SCRIPT}</script></body></html>",
    ]
    return "\n".join(part for part in parts if part)


def report_json(data: ReportData) -> JsonObject:
    """Return the content of the page as JSON, without pictures and routes."""
    return {
        "name": data.name,
        "dataset": str(data.dataset),
        "splits": {share.name: share.as_json() for share in data.shares},
        "idle_pins": list(data.idle_pins),
        "excluded": dict(sorted(data.excluded.items())),
        "checks": {"passed": data.checks_passed, "problems": [asdict(one) for one in data.problems]},
        "recordings": [
            {
                "recording": recording.key,
                **{name: getattr(recording, name) for name in _FACTS},
                "gaps": [asdict(gap) for gap in recording.gaps],
                "checks": {
                    "passed": recording.checks_passed,
                    "problems": [asdict(one) for one in recording.problems],
                },
                "notes": list(recording.notes),
            }
            for recording in data.recordings
        ],
    }


def _columns(data: ReportData) -> list[tuple[str, str]]:
    """Return the columns of the table of recordings, each with the class of its cells."""
    texts, numbers = ("picture", "recording", "state", "split", "start (UTC)"), ("span", "MB", "length")
    return [(name, "") for name in texts] + [(name, "n") for name in (*numbers, *data.counted, "gaps")]


def _chosen_pictures(recordings: Sequence[RecordingFacts]) -> Mapping[str, Sequence[tuple[str, Path]]]:
    """Return recording -> pictures that fit the budget: all, the first, the thumbnail, or none."""
    with_pictures = [recording for recording in recordings if recording.thumbnail is not None]
    budget = PICTURE_BYTES // max(len(with_pictures), 1)
    chosen: dict[str, Sequence[tuple[str, Path]]] = {recording.key: () for recording in recordings}
    for recording in with_pictures:
        pictures = list(recording.pictures.items())
        thumbnail = [("thumbnail", recording.thumbnail)] if recording.thumbnail is not None else []
        for offer in (pictures, pictures[:1], thumbnail):
            if offer and sum(path.stat().st_size for _, path in offer) <= budget:
                chosen[recording.key] = offer
                break
    return chosen


def _in_dataset(data: ReportData) -> list[RecordingFacts]:
    return [recording for recording in data.recordings if recording.state in {"ready", "stale"}]


def _cards(data: ReportData) -> str:
    ready = _in_dataset(data)
    length, unit = readable_length(sum(recording.length_m or 0.0 for recording in ready)).split()
    states = [recording.state for recording in data.recordings]
    values = [
        _counted(len(ready), "recordings"),
        _time(sum(share.duration_s for share in data.shares)),
        (unit, length),
        *(_counted(sum(recording.counts.get(name, 0) for recording in ready), name) for name in data.counted),
        ("skipped", str(states.count("skipped") + len(data.excluded))),
        ("failed", str(states.count("failed"))),
    ]
    cards = "".join(f'<div class="card"><b>{value}</b><span>{name}</span></div>' for name, value in values)
    return f'<div class="cards">{cards}</div>'


def _time(seconds: float) -> tuple[str, str]:
    """Return the largest unit of which there is at least one, and how many there are."""
    units = (("hour", 3600), ("minute", 60), ("second", 1))
    unit, length_s = next((one for one in units if seconds >= one[1]), units[-1])
    digits = 0 if unit == "second" and seconds >= 9.5 else 1
    number = f"{seconds / length_s:,.{digits}f}".removesuffix(".0")
    return unit if number == "1" else f"{unit}s", number


def _counted(number: int, plural: str) -> tuple[str, str]:
    return (_SINGULAR.get(plural, plural[:-1]) if number == 1 else plural), f"{number:,}"


def _split_table(shares: Sequence[SplitShare]) -> str:
    if not shares:
        return ""
    rows = "".join(
        f"<tr><td>{html(share.name)}</td><td class=n>{share.recordings}</td><td class=n>{share.duration_s:,.1f}</td>"
        f"<td class=n>{share.share:.1%}</td><td class=n>{share.asked:.1%}</td><td class=n>{share.deviation:+z.1%}</td></tr>"
        for share in shares
    )
    numbers = ("recordings", "seconds", "share", "asked", "deviation")
    return f"<h2>Split</h2>{_table(['split'], rows, numbers)}"


def _table(texts: Sequence[str], rows: str, numbers: Sequence[str] = ()) -> str:
    """Return a table whose first columns have texts, and the others numbers."""
    head = "".join([f"<th>{name}</th>" for name in texts] + [f"<th class=n>{name}</th>" for name in numbers])
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _idle_pins(keys: Sequence[str]) -> str:
    if not keys:
        return ""
    names = ", ".join(html(key) for key in keys)
    return f'<p class="stale">Pinned in the recipe, but not among the recordings: {names}</p>'


def _map(data: ReportData) -> str:
    splits = [share.name for share in data.shares]
    shown = _in_dataset(data)
    on_earth = [r for r in shown if r.points]
    local = [r for r in shown if not r.points and r.local]
    parts = []
    for title, recordings, is_on_earth in (
        ("Map", on_earth, True),
        ("Recordings without a position on Earth, each in its own local frame", local, False),
    ):
        ways = [(r, colour_of_split(r.split, splits)) for r in recordings]
        routes = [(r.key, colour, r.points if is_on_earth else r.local) for r, colour in ways]
        if svg := grid_map(routes, on_earth=is_on_earth):
            parts += [f"<h2>{title}</h2>", svg, legend((r.split, colour, r.key) for r, colour in ways)]
    return "".join(parts)


def _left_out(data: ReportData) -> str:
    rows = told_once(
        [
            *(
                ((r.state,), r.key, without_path(r.key, r.reason))
                for r in data.recordings
                if r.state in {"skipped", "failed", "copy"}
            ),
            *((("excluded",), path, why) for path, why in sorted(data.excluded.items())),
        ]
    )
    if not rows:
        return ""
    body = "".join(
        f'<tr><td>{_names(one)}</td><td class="{one.kind[0]}">{one.kind[0]}</td><td>{html(one.text)}</td></tr>'
        for one in rows
    )
    return f"<h2>Left out</h2>{_table(['recording', 'what', 'why'], body)}"


def _checks(data: ReportData) -> str:
    found = [
        *(("datasets", problem) for problem in data.problems),
        *((recording.key, problem) for recording in data.recordings for problem in recording.problems),
    ]
    passed = data.checks_passed + sum(recording.checks_passed for recording in data.recordings)
    if not found and not passed:
        return ""
    found.sort(key=lambda one: one[1].weight != "error")
    told = told_once(
        ((one.check, one.weight), name, f"{one.sentence}{f' (and {one.more} more)' if one.more else ''}")
        for name, one in found
    )
    rows = "".join(
        f'<tr><td>{_names(one)}</td><td>{html(one.kind[0])}</td><td class="{_COLOURS.get(one.kind[1], "")}">{one.kind[1]}'
        f"</td><td>{html(one.text)}</td></tr>"
        for one in told[:_MOST_PROBLEMS]
    )
    left_out = sum(len(one.names) for one in told[_MOST_PROBLEMS:])
    more = f"; {left_out:,} of these are not shown" if left_out else ""
    summary = (
        f"<p>{passed:,} passed, {len(found):,} found something{more}.</p>"
        if found
        else f"<p>All {passed:,} passed.</p>"
    )
    table = _table(["recording", "check", "severity", "what"], rows) if found else ""
    return f"<h2>Checks</h2>{summary}{table}"


def _names(told: Told) -> str:
    """Return the recordings that something is said of: of many the first few, and the others on a click."""
    if len(told.names) == 1:
        return html(told.title)
    names = "<br>".join(map(html, told.names))
    return f"<details><summary>{html(told.title)}</summary>{names}</details>"


def _categories(recordings: Sequence[RecordingFacts]) -> str:
    boxes: Counter[str] = Counter()
    having: Counter[str] = Counter()
    for recording in recordings:
        boxes.update(recording.boxes)
        having.update(recording.boxes.keys())
    if not boxes:
        return ""
    total = sum(boxes.values())
    rows = "".join(
        f"<tr><td>{html(category)}</td><td class=n>{number:,}</td><td class=n>{number / total:.1%}</td>"
        f"<td class=n>{having[category]:,}</td></tr>"
        for category, number in sorted(boxes.items(), key=lambda one: (-one[1], one[0]))
    )
    return f"<h2>Boxes</h2>{_table(['category'], rows, ['boxes', 'share', 'recordings'])}"


def _row(
    number: int, recording: RecordingFacts, pictures: Sequence[tuple[str, Path]], counted: Sequence[str]
) -> str:
    gaps = sum(gap.number for gap in recording.gaps)
    start = thumbnail = ""
    if pictures and recording.thumbnail is not None:
        thumbnail = f'<img class="t" alt="" loading="lazy" src="{_data_uri(recording.thumbnail)}">'
    if recording.start_ns is not None:
        start = datetime.fromtimestamp(recording.start_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S")
    daylight = f"<br><span class=dim>{recording.daylight}</span>" if recording.daylight else ""
    made_by = f"<span class=dim>{html(recording.format)} {html(recording.rig)}</span>"
    cells = [
        f"<td>{thumbnail}</td>",
        f"<td class=k>{html(recording.key)}<br>{made_by}{_details(number, recording, pictures)}</td>",
        f'<td class="{recording.state}">{recording.state}</td>',
        f"<td>{html(recording.split)}</td>",
        f"<td>{start}{daylight}</td>",
        _number(None if recording.start_ns is None else recording.duration_s, span_text),
        _number(None if recording.size is None else recording.size / 1e6, "{:,.1f}".format),
        _number(recording.length_m, readable_length),
        *(_number(recording.counts.get(name), "{:,d}".format) for name in counted),
        _number(gaps if recording.size is not None else None, "{:d}".format),
    ]
    return f"<tr>{''.join(cells)}</tr>"


def _number(value: float | None, text: Callable[[float], str]) -> str:
    """Return a cell with a number, which the table is sorted by; `text` is how it is shown."""
    return (
        "<td class=n data-v=-1></td>"
        if value is None
        else f"<td class=n data-v={value:.6g}>{text(value)}</td>"
    )


def _details(number: int, recording: RecordingFacts, pictures: Sequence[tuple[str, Path]]) -> str:
    """Return further facts about a recording, in a box that opens over the page."""
    shown = "".join(
        f'<img class="p" alt="{html(title)}" title="{html(title)}" src="{_data_uri(path)}">'
        for title, path in pictures
        if path != recording.thumbnail
    )
    lines = list(_lines(recording))
    if recording.full_pictures is not None and pictures:
        lines.append(f'<a href="{recording.full_pictures.as_uri()}">pictures in full size</a>')
    if not lines:
        return ""
    inside = f"<h2>{html(recording.key)}</h2><p>{'<br>'.join(lines)}</p>{shown}"
    button = f'<br><button popovertarget="more{number}">more</button>'
    return f'{button}<div id="more{number}" popover>{inside}</div>'


def _lines(recording: RecordingFacts) -> Iterator[str]:
    """Yield lines about what is unusual."""
    if recording.reason:
        yield html(without_path(recording.key, recording.reason))
    for gap in recording.gaps[:_MOST_GAPS]:
        yield f"{html(gap.topic)}: {count_text(gap.number, 'gap')}, longest {gap.longest_s:.2f} s"
    if len(recording.gaps) > _MOST_GAPS:
        yield f"and gaps of {count_text(len(recording.gaps) - _MOST_GAPS, 'more topic')}"
    yield from (html(line) for line in recording.lost)
    yield from (f"{problem.check}: {html(problem.sentence)}" for problem in recording.problems)
    yield from (html(note) for note in recording.notes)


def _data_uri(path: Path) -> str:
    return "data:image/jpeg;base64," + b64encode(path.read_bytes()).decode()
