"""`bagassets digest`: print digests of recordings, and store them with the files."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.errors import BagAssetsError, RecordingError
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text, readable_bytes
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.options import index_option
from bagassets.cli.terminal import echo, echo_json, echo_lines

if TYPE_CHECKING:
    from bagassets.recipe.model import Bags
    from bagassets.recordings.digest_record import DigestIndex
    from bagassets.recordings.model import RecordingFiles


@click.command(
    epilog="""\b
Examples:
  bagassets digest /data/recordings/monday.bag
  bagassets digest /data/recordings --json | jq -r '.recordings[].digest'
  bagassets digest --recipe project/recipe.yaml
  bagassets digest /data/recordings --verify

Exit status: 0 success; 1 a recording cannot be read; 3 --verify found disagreements."""
)
@click.argument("bags", metavar="[BAG]...", nargs=-1, type=click.Path(path_type=Path))
@index_option("hashed if no BAG is given")
@click.option("--rehash", is_flag=True, help="Hash all content again, even where a digest is on record.")
@click.option(
    "--verify",
    is_flag=True,
    help="Hash all content again and report every digest on record that disagrees; change nothing.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def digest(bags: tuple[Path, ...], recipe: Path | None, rehash: bool, verify: bool, as_json: bool) -> int:
    """Print digests of recordings and store them with the files.

    BAG is a recording or a folder of recordings. A file is not read if its digest is on record for its size and time.
    The digest of a single file is its BLAKE3 digest, as `b3sum` prints it.
    """
    from bagassets.recipe import load_recipe
    from bagassets.recordings.digest_record import DigestIndex

    loaded = None if recipe is None else load_recipe(recipe)
    if loaded is None and not bags:
        raise click.UsageError("name a BAG, or a recipe with --recipe.")
    index = None if loaded is None else DigestIndex(loaded.state)
    roots = bags or ((loaded.bags.root,) if loaded is not None else ())
    done: list[JsonObject] = []
    errors: list[str] = []
    for recording in _recordings(roots, None if bags or loaded is None else loaded.bags, errors):
        try:
            entry = _verified(recording, index) if verify else _digested(recording, index, rehash=rehash)
        except BagAssetsError as err:
            errors.append(str(err))
            continue
        done.append(entry)
        if not as_json:
            if "digest" in entry:
                echo(f"{entry['digest']}  {entry['path']}")
            for disagreement in entry.get("disagreements", ()):
                echo_lines(disagreement["message"])
            sys.stdout.flush()
    for sentence in errors:
        echo_lines(f"error: {sentence}", err=True)
    wrong = sum(len(entry.get("disagreements", ())) for entry in done)
    if as_json:
        echo_json({"recordings": done, "errors": errors})
    else:
        _summarize(done, wrong if verify else None)
    return ExitStatus.FAILED if errors else ExitStatus.FOUND if wrong else 0


def _recordings(
    roots: tuple[Path, ...], bags: "Bags | None", errors: list[str]
) -> Iterator["RecordingFiles"]:
    """Yield the recordings at or below `roots`; a path without any is added to `errors`."""
    from bagassets.recipe.model import Bags
    from bagassets.recordings.discover import discover, find_one

    for root in roots:
        try:
            if bags is not None:
                discovery = discover(bags)
            elif root.is_dir() and not (root / "metadata.yaml").is_file():
                discovery = discover(Bags(root=root.absolute()))
            else:
                yield find_one(root)
                continue
            errors += discovery.unreadable.values()
            if not discovery.recordings and not discovery.unreadable:
                raise RecordingError(
                    f"{root}: no recording found; expected .bag, .mcap or .db3 files, or ROS 2 bag folders."
                )
        except BagAssetsError as err:
            errors.append(str(err))
            continue
        yield from discovery.recordings.values()


def _digested(recording: "RecordingFiles", index: "DigestIndex | None", *, rehash: bool) -> JsonObject:
    from bagassets.recordings.digest import recording_digest

    made = recording_digest(recording, index, rehash=rehash)
    return {
        "path": str(recording.path),
        "digest": made.digest,
        "size": made.size,
        "hashed_bytes": made.hashed_bytes,
        "files": [
            {"name": name, "digest": of_file, "kept": made.kept[name]} for name, of_file in made.files.items()
        ],
    }


def _verified(recording: "RecordingFiles", index: "DigestIndex | None") -> JsonObject:
    from bagassets.recordings.digest import check_digests

    return {
        "path": str(recording.path),
        "size": recording.size,
        "disagreements": [
            {**vars(wrong), "path": str(wrong.path), "message": str(wrong)}
            for wrong in check_digests(recording, index)
        ],
    }


def _summarize(done: list[JsonObject], wrong: int | None) -> None:
    """Print a summary to standard error, so that standard output stays a list of digests."""
    size = sum(entry["size"] for entry in done)
    number = f"{count_text(len(done), 'recording')}, {readable_bytes(size)}"
    if wrong is not None:
        echo(
            f"{number} hashed again: {count_text(wrong, 'disagreement') if wrong else 'no disagreements'}.",
            err=True,
        )
        return
    hashed = sum(entry["hashed_bytes"] for entry in done)
    nowhere = sum(file["kept"] == "nowhere" for entry in done for file in entry["files"])
    echo(f"{number}; {readable_bytes(hashed)} hashed, the rest was on record.", err=True)
    if nowhere:
        echo(
            f"{count_text(nowhere, 'digest')} could not be stored: you cannot set extended attributes of these files. "
            "Name a recipe with --recipe; its index takes them.",
            err=True,
        )
