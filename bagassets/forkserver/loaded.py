"""Noticing source files that were edited after they were imported."""

import sys
import sysconfig
from pathlib import Path

__all__ = ["LoadedSources"]


class LoadedSources:
    """The source files of all loaded modules, except those of Python and installed packages."""

    def __init__(self) -> None:
        installed = {Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "purelib", "platlib")}
        files = {Path(name) for m in list(sys.modules.values()) if (name := getattr(m, "__file__", None))}
        self._seen = {
            file: _signature(file) for file in files if not any(root in file.parents for root in installed)
        }

    def changed(self) -> list[Path]:
        """Return the files that changed since they were loaded."""
        return sorted(file for file, seen in self._seen.items() if _signature(file) != seen)


def _signature(file: Path) -> tuple[int, int]:
    try:
        stat = file.stat()
    except OSError:
        return (-1, -1)
    return stat.st_size, stat.st_mtime_ns
