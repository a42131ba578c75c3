"""`bagassets watch`: the digest service of a file server."""

import json
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.errors import RecordingError
from bagassets.base.quantities import readable_bytes
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.options import Number, index_option
from bagassets.cli.terminal import echo_lines

if TYPE_CHECKING:
    from bagassets.recordings.watch import WatchEvent


@click.command(
    epilog="""\b
Examples:
  bagassets watch /data/recordings
  bagassets watch --recipe project/recipe.yaml
  bagassets watch /data/recordings --verify --once

Exit status: 0 when stopped by SIGTERM or Ctrl-C; 1 there is no such folder; 3 --once --verify found disagreements."""
)
@click.argument("root", required=False, type=click.Path(path_type=Path))
@index_option("watched if no ROOT is given")
@click.option(
    "--settle",
    "settle_s",
    type=Number(min=0),
    metavar="SECONDS",
    help="A recording is finished once it has not changed for this long; default: bags.settle_s of the recipe, or 5.",
)
@click.option(
    "--rescan",
    "rescan_s",
    type=Number(min=0.1),
    default=300.0,
    show_default=True,
    metavar="SECONDS",
    help="Scan all files this often even without a notification; shorten it where the file system sends none.",
)
@click.option(
    "--verify",
    is_flag=True,
    help="First hash all content again, and report and correct every digest that disagrees.",
)
@click.option("--once", is_flag=True, help="Hash the recordings that are finished, then end.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line.")
def watch(
    root: Path | None,
    recipe: Path | None,
    settle_s: float | None,
    rescan_s: float,
    verify: bool,
    once: bool,
    as_json: bool,
) -> int:
    """Watch a folder of recordings and keep their digests up to date.

    Meant to run on the machine that has the disks. Each finished recording below ROOT is hashed once; the digest is
    stored with its files, together with their size and time, so that builds elsewhere need not read them to identify
    them. After a restart it catches up.
    """
    from bagassets.recipe import load_recipe
    from bagassets.recipe.model import Bags
    from bagassets.recordings.digest_record import DigestIndex
    from bagassets.recordings.watch import Watcher, WatchEvent

    loaded = None if recipe is None else load_recipe(recipe)
    if root is not None:
        if not root.is_dir():
            raise RecordingError(f"{root}: no such folder; name that of the recordings.")
        bags = Bags(root=root.absolute())
    elif loaded is not None:
        bags = loaded.bags
    else:
        raise click.UsageError("name the folder of the recordings, or a recipe with --recipe.")
    if settle_s is not None:
        bags = bags.model_copy(update={"settle_s": settle_s})
    index = None if loaded is None else DigestIndex(loaded.state)
    wrong = 0

    def report(event: WatchEvent) -> None:
        nonlocal wrong
        wrong += event.kind == "wrong"
        echo_lines(_json_line(event) if as_json else _line(event))

    watcher = Watcher(bags, index, report, rescan_s=rescan_s)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: watcher.stop())
    if not once:
        report(WatchEvent("note", f"watching {bags.root}", bags.root))
    watcher.run(verify=verify, once=once)
    return ExitStatus.FOUND if once and verify and wrong else 0


def _line(event: "WatchEvent") -> str:
    if event.kind == "hashed":
        rate = event.size / 1e6 / max(event.seconds, 1e-9)
        return f"hashed  {event.path}  {event.digest}  {readable_bytes(event.size)}, {rate:.0f} MB/s"
    return f"{event.kind}  {event.message}"


def _json_line(event: "WatchEvent") -> str:
    fields = {name: value for name, value in vars(event).items() if name != "kind"}
    return json.dumps({"event": event.kind, **fields, "seconds": round(event.seconds, 3)}, default=str)
