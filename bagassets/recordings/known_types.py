"""Message definitions of common drivers, for recordings that lack them.

Before Iron, ROS 2 wrote no definitions into SQLite bags. The files in `definitions/`, one per package, list the fields of
message types for sensors and labels. Where a package changed its types without renaming them, sections `=== version`
follow one another, newest first; a type that a section does not list is as in the section above. The messages of a
recording show which version it was made with (`bagassets.recordings.layouts`).
"""

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.interfaces.typing import Constdefs, Fielddefs, Typesdict
from rosbags.typesys import get_types_from_msg

Types = Mapping[str, tuple[Constdefs, Fielddefs]]
"""Type -> constants and fields, as rosbags has it."""

FieldType = Any
"""The type of a field as rosbags has it, `FieldDesc`: tuples in tuples, which no type checker tells apart."""

_FOLDER = Path(__file__).parent / "definitions"


@cache
def known_versions(package: str) -> tuple[Types, ...]:
    """Return the types of a package, one mapping per version, newest first; empty if the package is unknown."""
    path = _FOLDER / f"{package}.msg"
    if not path.is_file():
        return ()
    text = "\n".join(line for line in path.read_text("utf-8").splitlines() if not line.startswith("#"))
    versions: list[Types] = []
    types: Typesdict = {}
    for section in re.split(r"^=== .*$", text, flags=re.MULTILINE)[1:]:
        for message in section.split("MSG: ")[1:]:
            name, _, fields = message.partition("\n")
            types |= get_types_from_msg(fields, f"{package}/msg/{name.strip()}")
        versions.append(dict(types))
    return tuple(versions)
