"""`bagassets inspect`: the inventory of one recording, without a project."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.escaping import visible
from bagassets.cli.terminal import echo_lines

if TYPE_CHECKING:
    from bagassets.recordings.model import RecordingFiles
    from bagassets.recordings.recording import Recording


@click.command(
    epilog="""\b
Examples:
  bagassets inspect /data/recordings/monday.bag
  bagassets inspect /data/recordings/tuesday --json | jq '.topics[].name'
  bagassets inspect monday_0.bag monday_1.bag          # the parts of one drive
  bagassets inspect old.db3 --definitions my_msgs/msg"""
)
@click.argument("bags", metavar="BAG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--json", "as_json", is_flag=True, help="Print the inventory as JSON, with digests, gaps and definitions."
)
@click.option(
    "--definitions",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    metavar="DIR",
    multiple=True,
    help="Folder of .msg files, for recordings without type definitions; may be repeated.",
)
@click.option(
    "--recipe",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Recipe whose bags.message_definitions and limits apply.",
)
def inspect(
    bags: tuple[Path, ...], as_json: bool, definitions: tuple[Path, ...], recipe: Path | None
) -> None:
    """Print what a recording holds.

    BAG is a .bag, .mcap or .db3 file, or a ROS 2 bag folder; several files are the parts of one drive. It is read
    completely. The inventory shows topics, types, counts, rates, gaps, frames, the offset of header stamps from log time,
    place and daylight, and what a build takes the times of lidar points for.
    """
    import json
    import tempfile

    from bagassets.assets.inventory import make_inventory
    from bagassets.propose.scan import point_time_notes, scan_recording
    from bagassets.recordings.describe import describe_inventory
    from bagassets.recordings.discover import find_one
    from bagassets.recordings.salvage.open import read_as_far
    from bagassets.store.artifact import ArtifactWriter

    folders, limits = list(definitions), None
    if recipe is not None:
        from bagassets.recipe import load_recipe

        loaded = load_recipe(recipe)
        folders += loaded.bags.message_definitions
        limits = loaded.limits
    bags = tuple(dict.fromkeys(bags))
    found = find_one(bags[0]) if len(bags) == 1 else _drive([bag.resolve() for bag in bags])
    with tempfile.TemporaryDirectory(prefix="bagassets-inspect-") as folder:

        def look(recording: "Recording") -> tuple[Path, list[str]]:
            place = Path(folder) / ("salvaged" if recording.damage else "artifact")
            make_inventory(recording, ArtifactWriter(place), size=found.size)
            return place, point_time_notes(scan_recording(recording))

        place, notes = read_as_far(found, look, folders, limits)
        inventory = json.loads(next(place.rglob("inventory.json")).read_text(encoding="utf-8"))
    inventory["notes"] += notes
    if as_json:
        echo_lines(json.dumps(inventory, sort_keys=True, indent=1, ensure_ascii=False))
        return
    echo_lines(f"{visible(', '.join(map(str, bags)))}\n\n{describe_inventory(inventory)}", nl=False)


def _drive(parts: list[Path]) -> "RecordingFiles":
    """Return the drive that several files are the parts of.

    Raises:
        RecordingError: they are not, or that is a question.
    """
    from bagassets.base.alike import names_text
    from bagassets.base.errors import RecordingError
    from bagassets.recordings.discover import bags_of_parts, discover

    found = discover(bags_of_parts(parts).model_copy(update={"series": {}}))
    drives = list(found.recordings.values())
    if len(drives) != 1 or found.asked:
        names = names_text([part.name for part in parts])
        raise RecordingError(
            f"{names}: by their names, topics or times these are not surely the parts of one drive; inspect them one by one."
        )
    return drives[0]
