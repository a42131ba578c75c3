"""Finding recordings below a folder, by names and sizes only."""

import hashlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bagassets.bags.globs import matches
from bagassets.bags.model import Format, Found
from bagassets.errors import RecordingError
from bagassets.recipe.model import Bags

__all__ = ["Discovery", "discover", "find_one", "matches"]

METADATA = "metadata.yaml"
# What may lie in a ROS 2 bag folder beside its metadata; zstd when compressed by file.
_STORAGE = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
_BARE: dict[str, Format] = {".bag": "ros1", ".mcap": "mcap", ".db3": "ros2"}


@dataclass(frozen=True)
class Discovery:
    """What lies below the bag root.

    Attributes:
        found: partition key -> recording, sorted by key.
        excluded: path below the root and reason of each recording that the globs leave out.
    """

    found: dict[str, Found]
    excluded: list[tuple[str, str]]


def discover(bags: Bags) -> Discovery:
    """Return the recordings that the recipe's `bags` select.

    Hidden files and those of unfinished copies (`.active`, `.part`, `.tmp`) are no recordings.

    Raises:
        RecordingError: the root is missing or cannot be read.
    """
    if not bags.root.is_dir():
        raise RecordingError(f"{bags.root}: no such folder; correct bags.root in the recipe.")
    found: dict[str, Found] = {}
    excluded: list[tuple[str, str]] = []
    for recording in _walk(bags.root):
        reason = _exclusion(bags, recording.relative)
        if reason is not None:
            excluded.append((recording.relative, reason))
        else:
            found[recording.key] = recording
    return Discovery(dict(sorted(found.items())), sorted(excluded))


def find_one(path: Path) -> Found:
    """Return the recording at a path given by a user.

    Raises:
        RecordingError: there is nothing, or it is no recording.
    """
    path = path.absolute()
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder.")
    if path.is_dir():
        found = _folder_recording(path, path.parent)
        if found is None:
            raise RecordingError(
                f"{path}: expected a bag; a ROS 2 bag folder holds metadata.yaml and .db3 or .mcap files."
            )
        return found
    if path.suffix not in _BARE:
        raise RecordingError(
            f"{path}: expected a recording: a .bag, .mcap or .db3 file, or a ROS 2 bag folder."
        )
    stat = path.stat()
    return _found(path, path.parent, _BARE[path.suffix], (path,), stat.st_size, stat.st_mtime_ns)


def _exclusion(bags: Bags, relative: str) -> str | None:
    if not any(matches(pattern, relative) for pattern in bags.include):
        return "not matched by bags.include"
    for pattern in bags.exclude:
        if matches(pattern, relative):
            return f"excluded by bags.exclude ({pattern})"
    return None


def _walk(root: Path) -> Iterator[Found]:
    """Yield recordings in no particular order; links are followed, circles are not."""
    todo = [root]
    visited: set[tuple[int, int]] = set()
    while todo:
        folder = todo.pop()
        try:
            status = folder.stat()
            if (status.st_dev, status.st_ino) in visited:
                continue
            visited.add((status.st_dev, status.st_ino))
            whole = _folder_recording(folder, root)
            if whole is not None:
                yield whole
                continue
            with os.scandir(folder) as entries:
                for entry in entries:
                    if entry.name.startswith("."):
                        continue
                    suffix = os.path.splitext(entry.name)[1]  # noqa: PTH122  (a Path per file is slow)
                    if suffix in _BARE and entry.is_file():
                        stat = entry.stat()
                        path = Path(entry.path)
                        yield _found(path, root, _BARE[suffix], (path,), stat.st_size, stat.st_mtime_ns)
                    elif entry.is_dir():
                        todo.append(Path(entry.path))
        except FileNotFoundError:
            continue  # removed while we looked
        except PermissionError as err:
            raise RecordingError(
                f"{folder}: cannot be read ({err.strerror}); correct its permissions."
            ) from err


def _folder_recording(folder: Path, root: Path) -> Found | None:
    """Return the ROS 2 bag that a folder is, or None."""
    if not (folder / METADATA).is_file():
        return None
    files = sorted(path for path in folder.iterdir() if path.name == METADATA or path.name.endswith(_STORAGE))
    if len(files) < 2:
        return None
    stats = [path.stat() for path in files]
    size, mtime_ns = sum(s.st_size for s in stats), max(s.st_mtime_ns for s in stats)
    return _found(folder, root, "ros2", tuple(files), size, mtime_ns)


def _found(
    path: Path, root: Path, file_format: Format, files: tuple[Path, ...], size: int, mtime_ns: int
) -> Found:
    relative = path.relative_to(root).as_posix() if path != root else path.name
    return Found(_key(relative), relative, path, file_format, files, size, mtime_ns)


def _key(relative: str) -> str:
    """Return a readable partition key that depends on the path alone.

    Where the readable form could be that of another path too, a short digest tells them apart.
    """
    slug = re.sub(r"[^A-Za-z0-9._-]+", "-", relative.replace("/", "__"))
    slug = re.sub(r"\.{2,}", ".", slug).strip(".-") or "recording"
    if slug == relative.replace("/", "__") and "__" not in relative:
        return slug
    return f"{slug}-{hashlib.blake2s(relative.encode(), digest_size=3).hexdigest()}"
