"""Rules about files: those in the tables are whole in the store, and no others are listed."""

from collections.abc import Callable, Mapping, Sequence

from bagassets.assets.quality.finding import Finding, counted
from bagassets.base.errors import StoreError
from bagassets.base.json_types import JsonMapping
from bagassets.store.artifact import Artifact


def files_match(
    sample_data: Sequence[JsonMapping],
    files: Sequence[Mapping[str, str]],
    artifact: Callable[[str], Artifact],
) -> Finding:
    """Check the files of one recording's tables against the store.

    Args:
        sample_data: rows of the table.
        files: content of `files.json`: where each `filename` is in the store.
        artifact: digest -> artifact; raises StoreError if it is gone.
    """
    named = [str(row["filename"]) for row in sample_data]
    listed = {entry["filename"] for entry in files}
    nowhere = sorted(set(named) - listed)
    unnamed = sorted(listed - set(named))
    problems = counted("{} files|file of sample_data are|is in no artifact", nowhere)
    problems += counted("{} listed files|file are|is not in sample_data", unnamed)
    artifacts: dict[str, tuple[Artifact, dict[str, int]]] = {}
    lost: dict[str, str] = {}
    missing, torn = [], []
    total = 0
    for entry in files:
        digest = entry["artifact"]
        if digest not in artifacts and digest not in lost:
            try:
                found = artifact(digest)
                artifacts[digest] = found, {file.path: file.size for file in found.entries()}
            except StoreError as err:
                lost[digest] = str(err)
                problems.append(f"{entry['filename']}: {err}")
        if digest in lost:
            continue
        whole, sizes = artifacts[digest]
        try:
            size = whole.path(entry["file"]).stat().st_size
        except FileNotFoundError:
            missing.append(entry["filename"])
            continue
        total += size
        expected = sizes.get(entry["file"])
        if size != expected:
            torn.append(f"{entry['filename']} ({size} bytes instead of {expected})")
    problems += counted("{} files|file are|is not in the store", missing)
    whose = "their|its artifacts'|artifact's manifests|manifest"
    problems += counted(f"{{}} files|file do|does not have the sizes|size in {whose}", torn)
    return Finding(problems, {"files": len(files), "bytes": total})
