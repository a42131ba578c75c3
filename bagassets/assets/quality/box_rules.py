"""Rules about boxes: few are lost, tracks do not jump, and sizes are plausible for road users."""

import numpy as np

from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.boxes.tracks import tracks_of
from bagassets.assets.quality.finding import Finding, clock, counted
from bagassets.base.json_types import JsonMapping
from bagassets.recipe.model_checks import BoxesCheck


def boxes_plausible(counts: JsonMapping, table: BoxTable, check: BoxesCheck) -> Finding:
    """Check the boxes of one recording.

    Args:
        counts: `counts` of `annotations.json`: source -> `boxes` (read, written, lost, first, kept).
        table: content of `annotations.parquet`.
        check: thresholds.
    """
    problems = []
    for source, entry in sorted(counts.items()):
        boxes = entry["boxes"]
        lost = boxes["read"] - boxes["written"]
        if lost > check.max_lost * boxes["read"]:
            reason = max(sorted(boxes["lost"]), key=lambda text: boxes["lost"][text])
            first = boxes.get("first", {}).get(reason)
            problems.append(
                f"{source}: {lost} of {boxes['read']} boxes were lost, most often for this reason: {reason}"
                f"{f' (first: {first})' if first else ''}; a share of {check.max_lost:g} is accepted"
            )
    kept = {
        source: entry["boxes"]["kept"] for source, entry in sorted(counts.items()) if entry["boxes"]["kept"]
    }
    facts = {
        "boxes": len(table),
        "tracks": table.track_count,
        "without_track": table.without_track,
        "kept": kept,
    }
    return Finding([*problems, *_jumps(table, check), *_sizes(table, check)], facts)


def _jumps(table: BoxTable, check: BoxesCheck) -> list[str]:
    """Find tracks that jump: two objects with one id look like one that jumps back and forth."""
    jumping = []
    for track in tracks_of(table):
        seconds = np.diff(track.stamps_ns) / 1e9
        moves = np.diff(track.centers_m, axis=0)
        distances = np.sqrt((moves * moves).sum(axis=1))
        # Labels are a few decimetres off, however close in time they are.
        jumps = np.flatnonzero(distances > check.max_speed_mps * seconds + check.noise_m)
        if len(jumps):
            at = int(jumps[0])
            jumping.append(
                f"{track.track_id} of {track.source}: {distances[at]:.1f} m from {clock(int(track.stamps_ns[at]))} to "
                f"{clock(int(track.stamps_ns[at + 1]))}; perhaps two objects share the id"
            )
    return counted("{} tracks|track jump|jumps", jumping)


def _sizes(table: BoxTable, check: BoxesCheck) -> list[str]:
    wrong = np.flatnonzero(
        (table.sizes_m.max(axis=1, initial=0.0) > check.max_size_m)
        | (table.sizes_m.min(axis=1, initial=np.inf) < check.min_size_m)
    )
    boxes = [
        f"{table.tracks[row] or 'one without a track'} of {table.sources[row]} at {clock(int(table.stamps_ns[row]))}: "
        f"{' x '.join(f'{size:g}' for size in table.sizes_m[row].tolist())} m"
        for row in wrong.tolist()
    ]
    limits = f"smaller than {check.min_size_m:g} m or larger than {check.max_size_m:g} m"
    return counted(f"{{}} boxes|box are|is {limits}", boxes)
