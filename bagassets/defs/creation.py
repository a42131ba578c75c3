"""Letting one process alone create the database of an instance: Dagster itself takes no care of that."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

__all__ = ["alone_if_new"]

# What Dagster keeps in SQLite, below the folder of the storage.
_DATABASES = ("history/runs.db", "history/runs/index.db", "schedules/schedules.db")


@contextmanager
def alone_if_new(home: Path) -> Iterator[None]:
    """Keep others from opening the instance in `home` while its tables are made.

    Those who find them made open it side by side. Other databases than SQLite are left to their servers.
    """
    folder = _storage(home)
    if folder is None:
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder / "opening.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH)  # waits while somebody makes the tables
        if not all((folder / name).exists() for name in _DATABASES):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _storage(home: Path) -> Path | None:
    try:
        config = yaml.safe_load((home / "dagster.yaml").read_text("utf-8"))
        return Path(config["storage"]["sqlite"]["base_dir"])
    except (OSError, yaml.YAMLError, KeyError, TypeError):
        return None
