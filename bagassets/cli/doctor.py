"""`bagassets doctor`: what is wrong with a recording, what can be saved of it, and a mended copy."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.errors import RecordingError
from bagassets.base.escaping import visible
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.terminal import echo_json, echo_lines

if TYPE_CHECKING:
    from bagassets.recordings.salvage.examine import Examined

_STATUS = {"sound": 0, "mendable": ExitStatus.FOUND, "lost": ExitStatus.FAILED}
_SHOWN = 20


@click.command(
    epilog="""\b
Examples:
  bagassets doctor /data/recordings/monday.bag
  bagassets doctor monday.bag.active --write monday_mended.bag
  bagassets doctor tuesday --json | jq .damage.lost

\b
Exit status: 0 the recording is sound; 3 it is damaged, and can be read in part or as a whole; 1 nothing of it can."""
)
@click.argument("recording", type=click.Path(path_type=Path), metavar="PATH")
@click.option(
    "--write",
    "copy",
    type=click.Path(path_type=Path),
    metavar="COPY",
    help="Write what can be read to a new recording: a .bag, an .mcap, or a ROS 2 bag folder for one of ROS 2.",
)
@click.option("--json", "as_json", is_flag=True, help="Print what was found as JSON.")
def doctor(recording: Path, copy: Path | None, as_json: bool) -> None:
    """Say what is wrong with a recording, where, what can be saved, and what to do next.

    PATH is a .bag, .bag.active, .mcap or .db3 file, one of these compressed with zstd, or a ROS 2 bag folder. It is read completely,
    and never written to.
    """
    from bagassets.recordings.salvage.examine import examine, mend

    if copy is not None and copy.exists():
        raise RecordingError(f"{copy}: there is something already; name a path where nothing is.")
    found = examine(recording)
    written = None if copy is None or found.verdict == "lost" else mend(recording, copy)
    if as_json:
        echo_json({**found.as_json(), **({} if copy is None else {"copy": str(copy), "written": written})})
    else:
        _print(found, copy, written)
    sys.exit(_STATUS[found.verdict])


def _print(found: "Examined", copy: Path | None, written: int | None) -> None:
    """Print one page: what is wrong, where, what can be saved, what to do next."""
    from bagassets.base.quantities import count_text
    from bagassets.recordings.damage import without_advice
    from bagassets.recordings.salvage.damage_map import NO_INDEX

    path, damage, no_index = visible(str(found.path)), found.damage, f"{found.path.name}: {NO_INDEX}"
    findings = [] if damage is None else [*damage.findings]
    if found.verdict == "sound":
        number = sum(count for _, count in found.topics.values())
        sound = {0: "Sound, but empty: it holds no message.", 1: "Sound: its only message can be read."}
        echo_lines(f"{path}\n\n{sound.get(number, f'Sound: all {number} messages can be read.')}")
    else:
        problem = without_advice(found.problem).removeprefix(f"{found.path}: ")
        if "its index is damaged" in problem and no_index in findings:
            problem = problem.replace("its index is damaged", "it was cut off before its index")
            findings.remove(no_index)
        echo_lines(f"{path}\n\nWhat is wrong\n  {problem}")
    if damage is not None:
        lines = findings + [
            f"{hole.file}, bytes {hole.begin} to {hole.end}{_between(hole.start_ns, hole.end_ns)}: {hole.reason}"
            for hole in damage.holes[:_SHOWN]
        ]
        if len(damage.holes) > _SHOWN:
            lines.append(f"and {len(damage.holes) - _SHOWN} more places; --json has all")
        if lines:
            echo_lines("\nWhere\n" + "\n".join(f"  {line}" for line in lines))
        width = max(map(len, found.topics), default=0)
        rows = [f"  {name:{width}}  {count:>8}" for name, (_, count) in found.topics.items()]
        losses = [damage.lost.get(name, 0) for name in found.topics]
        rows = [f"{row}  {lost:>6} lost" if lost else row for row, lost in zip(rows, losses, strict=True)]
        if "" in damage.lost:
            rows.append(f"  {'of unknown topics':{width}}  {'':>8}  {damage.lost['']:>6} lost")
        share = damage.share()
        echo_lines(f"\nWhat can be saved\n  {share[:1].upper()}{share[1:]}.\n" + "\n".join(rows))
    if found.verdict != "sound":
        echo_lines("\nWhat to do next\n" + "\n".join(f"  {line}" for line in _advice(found, copy)))
    if written is not None:
        echo_lines(f"\n{visible(str(copy))}: {count_text(written, 'message')} written.")


def _between(start_ns: int | None, end_ns: int | None) -> str:
    from bagassets.assets.quality.finding import clock

    times = [] if start_ns is None else [f"after {clock(start_ns)}"]
    times += [] if end_ns in {None, start_ns} else [f"before {clock(end_ns)}"]
    return f", {' and '.join(times)}" if times else ""


def _advice(found: "Examined", copy: Path | None) -> list[str]:
    from bagassets.recordings.damage import MISNAMED, NO_RECORDING
    from bagassets.recordings.model import METADATA
    from bagassets.recordings.salvage.examine import BEHIND

    if MISNAMED in found.problem:
        return ["Rename it, and ask again."]
    if NO_RECORDING in found.problem and found.damage is None:
        return [
            "If it is no recording, remove it, or name it in bags.exclude of the recipe.",
            "If it lost its first bytes, copy it again from where it was recorded; nothing in this file can be read.",
        ]
    if found.damage is None and f" of its {METADATA} " in found.problem:
        return ["Do so, and ask again; without the file, nothing was read."]
    if found.damage is None:
        return ["Copy it again from where it was recorded; nothing in this file can be read."]
    if found.path.suffix == ".zstd":
        made = {".bag": "a .bag file", ".mcap": "an .mcap file"}.get(
            Path(found.path.stem).suffix, "a ROS 2 bag folder"
        )
        return [
            f"Builds take no such file; `--write COPY` makes {made} of what can be read, which they take."
        ]
    if found.problem == BEHIND:
        lines = ["Builds use it as it is, whatever `recover` in the recipe says."]
    elif found.damage.is_complete:
        lines = ["Builds use it as it is, unless the recipe says `recover: refuse`."]
    else:
        lines = [
            "Copy it again from where it was recorded, if it is whole there.",
            "Or have builds use what can be read: `recover: all` in bags of the recipe.",
        ]
    if copy is None:
        lines.append("For other programs, `--write COPY` makes a mended copy; this file stays as it is.")
    return lines
