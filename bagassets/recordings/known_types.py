"""Message definitions of common drivers, for recordings that lack them.

ROS 2 wrote none into SQLite bags before Iron. The files in `definitions/` list the fields of
the interfaces that sensors and labels come in, a package per file. Where a package changed
its types over time without renaming them, sections `=== version` follow each other, newest first;
what a section does not list is as in the one above it. Which one a recording was made with is told
from its messages (`bagassets.recordings.layouts`).
"""

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.typesys import get_types_from_msg

__all__ = ["Types", "known_versions"]

# Type -> (constants, fields), as rosbags has it.
Types = Mapping[str, Any]

_FOLDER = Path(__file__).parent / "definitions"


@cache
def known_versions(package: str) -> tuple[Types, ...]:
    """Return the types of a package, one mapping per version of it, newest first; none if it is not known."""
    path = _FOLDER / f"{package}.msg"
    if not path.is_file():
        return ()
    text = "\n".join(line for line in path.read_text("utf-8").splitlines() if not line.startswith("#"))
    versions: list[Types] = []
    types: dict[str, Any] = {}
    for section in re.split(r"^=== .*$", text, flags=re.MULTILINE)[1:]:
        for message in section.split("MSG: ")[1:]:
            name, _, fields = message.partition("\n")
            types |= get_types_from_msg(fields, f"{package}/msg/{name.strip()}")
        versions.append(dict(types))
    return tuple(versions)
