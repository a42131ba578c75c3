"""Finding recordings below a folder, by names and sizes; of MCAP files the head is read, too."""

import errno
import hashlib
import os
import re
import stat
import unicodedata
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from operator import attrgetter, itemgetter
from pathlib import Path

from bagassets.base.alike import names_text
from bagassets.base.errors import RecordingError
from bagassets.base.fingerprints import signature_of
from bagassets.base.garbage import uncollected
from bagassets.recipe.model import Bags
from bagassets.recordings import unfinished
from bagassets.recordings.globs import literal_glob, matches, may_match_within
from bagassets.recordings.join_parts import Joined, join_parts
from bagassets.recordings.journals import journals_of
from bagassets.recordings.model import METADATA, Format, RecordingFiles
from bagassets.recordings.own_files import is_view_file
from bagassets.recordings.series import candidates, whole_of

_ROS2_KEY, _HEAD_BYTES = b"rosbag2_bagfile_information", 4096
_NO_STORAGE = "there is no .db3 or .mcap file beside its metadata.yaml; it is still being copied, or damaged"
_LEADS_NOWHERE = "a link that leads nowhere"
_VIEW_FILE = "a scene that `bagassets view` wrote"
# Storage files of a ROS 2 bag folder; zstd when compressed by file.
_STORAGE = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
_BARE: dict[str, Format] = {".bag": "ros1", ".mcap": "mcap", ".db3": "ros2"}
_SPECIAL = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
# Folders of file systems themselves, readable by root only.
_SYSTEM_FOLDERS = frozenset({"lost+found", "System Volume Information", "$RECYCLE.BIN"})
# Keys become parts of file names, which are limited to 255 bytes.
_LONGEST_SLUG = 100
# Paths that are their own key but for the slashes. Most are, so that thousands of keys cost no time.
_WORD = "[A-Za-z0-9]+(?:[._-][A-Za-z0-9]+)*"
_PLAIN = re.compile(f"{_WORD}(?:/{_WORD})*")


@dataclass(frozen=True)
class Discovery:
    """The recordings below the bag root.

    Attributes:
        recordings: partition key -> recording, sorted by key.
        excluded: path below the root and reason, for each recording left out and each folder that cannot be read.
        unreadable: path below the root -> a sentence, for each folder or file that cannot be read and is not in
            `bags.exclude`.
        asked: path of a whole drive -> the question whether some recordings are its parts.
        near: key of such a recording -> that path; until the question is answered, they lie in one split.
    """

    recordings: dict[str, RecordingFiles]
    excluded: list[tuple[str, str]]
    unreadable: dict[str, str] = field(default_factory=dict)
    asked: dict[str, str] = field(default_factory=dict)
    near: dict[str, str] = field(default_factory=dict)

    @property
    def former_keys(self) -> dict[str, tuple[str, ...]]:
        """Key of each series -> the keys that its parts would have alone, and had before they were joined."""
        return {
            key: tuple(part.key for part in one.parts) for key, one in self.recordings.items() if one.parts
        }

    def joined_into(self, key: str) -> str | None:
        """Return the key of the series that the recording of a key is part of; None if it is part of none."""
        return next((whole for whole, keys in self.former_keys.items() if key in keys), None)

    def unseen(self, keys: Iterable[str]) -> frozenset[str]:
        """Return those of `keys` that were not found, but may lie in a folder that cannot be read.

        A key does not tell its path exactly, so this may keep too many.
        """
        heads = tuple(_start_of_keys(f"{relative}/") for relative in self.unreadable)
        same = {_key(relative) for relative in self.unreadable}
        return frozenset(
            key for key in keys if key not in self.recordings and (key in same or key.startswith(heads))
        )

    def removed(self, keys: Iterable[str]) -> tuple[str, ...]:
        """Return, sorted, those of `keys` whose recordings are certainly gone."""
        missing = [key for key in keys if key not in self.recordings]
        return tuple(sorted(set(missing) - self.unseen(missing)))


@uncollected()
def discover(bags: Bags, *, joined: bool = True) -> Discovery:
    """Return the recordings that the recipe's `bags` select.

    Hidden files and unfinished copies (`.part`, `.tmp`) are no recordings. What recorders leave unfinished is listed: `x.bag.active`
    is the recording `x.bag` once it has not grown for ten minutes, unless that is there, too. Folders and files that cannot be read
    are left out; ask `Discovery.removed` before dropping the recordings in them.

    Args:
        bags: where to look, and which recordings count.
        joined: parts of one drive are one recording; else each file is, and none is opened.

    Raises:
        RecordingError: the root is missing or cannot be read.
    """
    if not bags.root.is_dir():
        raise RecordingError(f"{bags.root}: no such folder; correct bags.root in the recipe.")
    walk = _Walk(bags)
    walk.folder(bags.root, "", _identities(bags.root.resolve().parents))
    found = sorted(walk.recordings, key=attrgetter("relative"))
    if bags.include != ("**",) or bags.exclude:
        reasons = {one.relative: _exclusion(bags, one.relative) for one in found}
        walk.excluded += [(relative, reason) for relative, reason in reasons.items() if reason is not None]
        found = [one for one in found if reasons[one.relative] is None]
    series = join_parts(bags, found, _key) if joined else Joined({one.relative: one for one in found})
    walk.excluded += series.left_out
    recordings: dict[str, RecordingFiles] = {}
    for recording in series.recordings.values():
        if recording.parts and (reason := _exclusion(bags, recording.relative, include=False)) is not None:
            walk.excluded.append((recording.relative, reason))
        elif recording.key in recordings:
            other = recordings[recording.key].relative
            walk.excluded.append(
                (recording.relative, f"its key {recording.key} is that of {other}; rename one")
            )
        else:
            recordings[recording.key] = recording
    return Discovery(
        dict(sorted(recordings.items())),
        sorted(walk.excluded),
        dict(sorted({**walk.unreadable, **series.broken}.items())),
        series.asked,
        {_key(relative): whole for relative, whole in series.near.items()},
    )


def _identities(folders: Iterable[Path]) -> tuple[tuple[int, int], ...]:
    """Return device and inode of folders, as far as they can be seen."""
    found = []
    for folder in folders:
        with suppress(OSError):
            status = folder.stat()
            found.append((status.st_dev, status.st_ino))
    return tuple(found)


def find_one(path: Path) -> RecordingFiles:
    """Return the files of the recording at a path.

    Raises:
        RecordingError: nothing is there, or it is no recording.
    """
    path = path.absolute()
    if not path.exists():
        names = [one.name for one in path.parent.glob("*")]
        parts = next((list(one.numbers) for one in candidates(names) if one.whole == path.name), [])
        told = f", but a drive in {len(parts)} files: {names_text(parts)}; name these" if parts else ""
        raise RecordingError(f"{path}: no such file or folder{told}.")
    entries: list[os.DirEntry[str]] = []
    try:
        if (what := _special_kind(path.stat())) is not None:
            raise RecordingError(f"{path}: expected a recording, but this is {what}; name a file or folder.")
        if path.is_dir():
            with os.scandir(path) as scan:
                entries += scan
            recording = _folder_recording(path, path.name, entries)
            if isinstance(recording, str):
                raise RecordingError(f"{path}: expected a ROS 2 bag folder, but {recording}.")
        elif path.suffix in _BARE:
            recording = _recording_files(path, path.name, _BARE[path.suffix], [(path, path.stat())])
        elif (whole := unfinished.whole_name(path.name)) is not None:
            recording = _recording_files(path, whole, "ros1", [(path, path.stat())])
        elif path.suffix in unfinished.SUFFIXES and (reason := unfinished.reason(path, path.stat())):
            raise RecordingError(f"{path}: this is no recording: {reason}.")
        else:
            raise RecordingError(
                f"{path}: expected a recording: a .bag, .mcap or .db3 file, or a ROS 2 bag folder."
            )
    except OSError as err:
        raise RecordingError(f"{path}: cannot be read ({err.strerror}).") from err
    if recording is None and _lacks_storage(path, entries):
        raise RecordingError(f"{path}: {_NO_STORAGE}.")
    if recording is None:
        raise RecordingError(
            f"{path}: this is no ROS 2 bag folder (metadata.yaml with .db3 or .mcap files); name a recording in it."
        )
    return recording


def bags_of_one(path: Path) -> Bags:
    """Return the `bags` of a recipe that select just the recording at a path.

    The recording of a file in a ROS 2 bag folder is that folder.

    Raises:
        RecordingError: nothing is there, or it is no recording.
    """
    path = path.absolute()
    if path.is_file() and (path.parent / METADATA).is_file() and path.name.endswith(_STORAGE):
        path = path.parent
    recording = find_one(path)
    if recording.format == "mcap" and is_view_file(path, path.stat()):
        raise RecordingError(f"{path}: expected a recording, but this is {_VIEW_FILE}; name a recording.")
    if path.is_dir():
        return Bags(root=path)
    if path.name.startswith("."):
        raise RecordingError(f"{path}: hidden files are not taken for recordings; rename it.")
    if unfinished.whole_name(path.name) and (reason := unfinished.reason(path, path.stat())):
        raise RecordingError(f"{path}: {reason}.")
    return Bags(root=path.parent, include=(literal_glob(recording.relative),))


def bags_of_parts(paths: Sequence[Path]) -> Bags:
    """Return the `bags` of a recipe that select the files at some paths, as the parts of one drive.

    Raises:
        RecordingError: one is no recording of a single file.
    """
    for path in paths:
        recording = find_one(path)
        if path.suffix != paths[0].suffix or path not in recording.files:
            raise RecordingError(f"{path}: the parts of a drive are files of one format.")
    root = Path(os.path.commonpath([path.absolute().parent for path in paths]))
    names = tuple(path.absolute().relative_to(root).as_posix() for path in paths)
    whole = next((one.whole for one in candidates(names)), names[0])
    return Bags(root=root, include=tuple(map(literal_glob, names)), series={whole: names})


def series_with(path: Path) -> str:
    """Return the name of the whole drive that a file is surely a part of, by the files beside it; "" if of none."""
    try:
        beside = [one.name for one in path.parent.iterdir() if not one.name.startswith(".")]
    except OSError:
        return ""
    for whole, numbers in candidates(beside):
        if path.name in numbers:
            found = discover(Bags(root=path.parent, include=tuple(map(literal_glob, numbers)))).recordings
            parts = {part.relative for one in found.values() for part in one.parts}
            return whole if path.name in parts else ""
    return ""


@dataclass
class _Walk:
    """A walk below the bag root that collects recordings in no particular order.

    Links are followed as by `find -L`: a folder linked twice is walked twice, so that the result does not depend on the
    order in which the disk lists names; a folder linked within itself is not, be it one that the bag root lies in.
    """

    bags: Bags
    recordings: list[RecordingFiles] = field(default_factory=list)
    excluded: list[tuple[str, str]] = field(default_factory=list)
    unreadable: dict[str, str] = field(default_factory=dict)

    def folder(self, path: Path, relative: str, ancestors: tuple[tuple[int, int], ...]) -> None:
        """Walk one folder; `ancestors` are device and inode of the folders it lies in."""
        try:
            status = os.stat(path)
            identity = (status.st_dev, status.st_ino)
            if identity in ancestors:
                return
            with os.scandir(path) as scan:
                entries = [entry for entry in scan if not entry.name.startswith(".")]
        except FileNotFoundError:
            return  # removed during the walk
        except OSError as err:
            self._unreadable(relative, err)
            return
        name = relative or path.name
        recording = _folder_recording(path, name, entries)
        if isinstance(recording, str):
            self._leave_out(name, recording)
            return
        if recording is not None:
            self._take(recording)
            return
        if _lacks_storage(path, entries):
            self.excluded.append((name, _NO_STORAGE))
        for entry in entries:
            within = f"{relative}/{entry.name}" if relative else entry.name
            try:
                self._entry(entry, path, within, (*ancestors, identity))
            except OSError as err:
                is_gone = isinstance(err, FileNotFoundError)
                if entry.is_symlink() and (is_gone or err.errno == errno.ELOOP):
                    if entry.name.endswith(tuple(_BARE)):
                        self._leave_out(within, _LEADS_NOWHERE)
                elif not is_gone:  # it was removed during the walk
                    self._unreadable(within, err)

    def _entry(
        self, entry: os.DirEntry[str], folder: Path, relative: str, ancestors: tuple[tuple[int, int], ...]
    ) -> None:
        suffix = entry.name[entry.name.rfind(".") :]  # hidden files are left out
        if suffix in _BARE and not entry.is_dir():
            path, status = folder / entry.name, entry.stat()  # half the time of a `Path` of all of it
            if (what := _special_kind(status)) is not None:
                self._leave_out(relative, f"this is {what}, no file")
            elif suffix == ".mcap" and is_view_file(path, status):
                self._leave_out(relative, _VIEW_FILE)
            else:
                self._take(_recording_files(path, relative, _BARE[suffix], [(path, status)]))
        elif suffix in unfinished.SUFFIXES and not entry.is_dir():
            self._unfinished(entry, relative)
        elif suffix.lower() in _BARE and not entry.is_dir():
            self._leave_out(relative, f"the name of a recording ends in {suffix.lower()}; rename it so")
        elif entry.name not in _SYSTEM_FOLDERS and entry.is_dir() and self._may_hold_included(relative):
            self.folder(folder / entry.name, relative, ancestors)

    def _unfinished(self, entry: os.DirEntry[str], relative: str) -> None:
        """Take or list what a recorder left that was stopped."""
        path, status = Path(entry.path), entry.stat()
        if not stat.S_ISREG(status.st_mode):
            return
        if reason := unfinished.reason(path, status):
            self._leave_out(relative, reason)
        elif (whole := unfinished.whole_name(relative)) is not None:
            self._take(_recording_files(path, whole, "ros1", [(path, status)]))

    def _may_hold_included(self, folder: str) -> bool:
        """Tell whether a folder is worth a walk: for one recording in a home folder, not all of that is walked."""
        return any(may_match_within(pattern, folder) for pattern in self.bags.include)

    def _take(self, recording: RecordingFiles) -> None:
        shown = _shown(recording.relative)
        if shown == recording.relative:
            self.recordings.append(recording)
        else:
            self.excluded.append((shown, "its name is not UTF-8; rename it"))

    def _leave_out(self, relative: str, reason: str) -> None:
        self.excluded.append((_shown(relative), _exclusion(self.bags, relative) or reason))

    def _unreadable(self, relative: str, err: OSError) -> None:
        """Leave out what cannot be read; the root itself must be readable."""
        for pattern in self.bags.exclude:
            if matches(pattern, relative) or matches(pattern, f"{relative}/"):
                self.excluded.append((relative, f"cannot be read, and excluded by bags.exclude ({pattern})"))
                return
        cause = "permissions" if isinstance(err, PermissionError) else err.strerror
        if not relative:
            raise RecordingError(
                f"{self.bags.root}: cannot be read: {cause}; correct that or bags.root."
            ) from err
        reason = f"cannot be read: {cause}; correct that, or name it in bags.exclude"
        self.excluded.append((_shown(relative), reason))
        self.unreadable[relative] = f"{self.bags.root / relative}: {reason}."


def _exclusion(bags: Bags, relative: str, *, include: bool = True) -> str | None:
    # A glob may be about the drive that it is a part of.
    names = [name for name in (relative, whole_of(relative)) if name is not None]
    if include and not any(matches(pattern, name) for pattern in bags.include for name in names):
        return "not matched by bags.include"
    for pattern in bags.exclude:
        if matches(pattern, relative):
            return f"excluded by bags.exclude ({pattern})"
    return None


def _folder_recording(
    folder: Path, relative: str, entries: list[os.DirEntry[str]]
) -> RecordingFiles | str | None:
    """Return the files of a ROS 2 bag folder, why they cannot be opened, or None if the folder is not one."""
    if not any(entry.name == METADATA for entry in entries):
        return None
    own = [entry for entry in entries if entry.name == METADATA or entry.name.endswith(_STORAGE)]
    for entry in own:
        with suppress(OSError):  # whoever opens it reports that
            if (what := _special_kind(entry.stat())) is not None:
                return f"{entry.name} in it is {what}, no file"
    files = [(folder / entry.name, entry.stat()) for entry in own if not entry.name.startswith(".")]
    return _recording_files(folder, relative, "ros2", files) if len(files) > 1 else None


def _special_kind(status: os.stat_result) -> str | None:
    """Return the name of a kind of file that must not be opened: reading a pipe or a device may never end."""
    return _SPECIAL.get(stat.S_IFMT(status.st_mode))


def _lacks_storage(folder: Path, entries: list[os.DirEntry[str]]) -> bool:
    """Tell whether a folder is a ROS 2 bag without its storage files; other metadata.yaml are common."""
    if not any(entry.name == METADATA for entry in entries):
        return False
    try:
        with (folder / METADATA).open("rb") as file:
            return _ROS2_KEY in file.read(_HEAD_BYTES)
    except OSError:
        return False


def _recording_files(
    path: Path, relative: str, file_format: Format, files: list[tuple[Path, os.stat_result]]
) -> RecordingFiles:
    if file_format == "ros2":  # others have none, and there may be thousands
        files = [*files, *journals_of(path for path, _ in files).items()]
    files.sort(key=itemgetter(0))
    size, mtime_ns = sum(s.st_size for _, s in files), max(s.st_mtime_ns for _, s in files)
    names, seen = tuple(name for name, _ in files), tuple(signature_of(s) for _, s in files)
    return RecordingFiles(_key(relative), relative, path, file_format, names, size, mtime_ns, seen=seen)


def _shown(name: str) -> str:
    """Return a path as it is, or with escapes for what is not UTF-8 in it."""
    return name.encode(errors="backslashreplace").decode()


def _key(relative: str) -> str:
    """Return a readable partition key that depends on the path alone.

    The suffix stays, because recordings are often converted next to the original, and that must not change a key. Where
    another path could have the same readable form, a short digest tells them apart.
    """
    plain = relative.replace("/", "__")
    if len(plain) <= _LONGEST_SLUG and _PLAIN.fullmatch(relative):
        return plain
    slug = _slug(plain) or "recording"
    parts = relative.split("/")
    ambiguous = "__" in relative or (len(parts) > 1 and any(part != part.strip("_") for part in parts))
    if slug == plain and not ambiguous and len(slug) <= _LONGEST_SLUG:
        return slug
    digest = hashlib.blake2s(relative.encode("utf-8", "surrogateescape"), digest_size=4).hexdigest()
    return f"{slug[:_LONGEST_SLUG].rstrip('.-')}-{digest}"


def _slug(plain: str) -> str:
    folded = unicodedata.normalize("NFKD", plain).encode("ascii", "ignore").decode()
    return re.sub(r"\.{2,}", ".", re.sub(r"[^A-Za-z0-9._-]+", "-", folded)).strip(".-")


def _start_of_keys(prefix: str) -> str:
    """Return the common start of the keys of all paths below `prefix`, which ends with a slash."""
    return _slug(prefix.replace("/", "__"))[:_LONGEST_SLUG].rstrip(".-")
