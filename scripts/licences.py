"""Write the licences of all packages that an installation consists of into docs/install.md.

    python scripts/licences.py            # in the environment of requirements.lock

Packages are found by what bagassets requires, and what that requires; licences are those that the packages state in their
metadata, in SPDX's spelling. What wheels bring along under other terms is told by hand, for every package whose licence
files have the text of a copyleft licence: `test_licences` fails if one of them is not here.
"""

import re
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "install.md"
BEGIN, END = "<!-- licences -->\n", "<!-- end of licences -->"

# What packages call their licence -> its name at SPDX; other texts are shown as they are.
_SPDX = {
    "3-Clause BSD License": "BSD-3-Clause",
    "Apache 2.0": "Apache-2.0",
    "Apache License Version 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD",
    "MIT License": "MIT",
    "MIT license": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
    "any-OSI": "Zlib, or any that OSI approved",
}
_LONGEST = 40  # of a field that names a licence; longer ones are its text

_GCC = "`libgfortran`: GPL-3.0-or-later WITH GCC-exception-3.1, `libquadmath`: LGPL-2.1-or-later"
# What is copyleft of the wheel of a package.
COPYLEFT = {
    "av": "shared libraries: FFmpeg as built with x264 and x265: GPL-2.0-or-later, and others under the LGPL; only with the extra "
    "`video`",
    "certifi": "all: MPL-2.0",
    "grpcio": "`roots.pem`, a list of certificates: MPL-2.0",
    "grpcio-health-checking": "as `grpcio`, whose licence file it has; of its files none",
    "numpy": f"shared libraries: {_GCC}",
    "opencv-python-headless": f"shared libraries: FFmpeg (`libav…`, `libsw…`): LGPL-2.1-or-later; {_GCC}",
    "psycopg2-binary": "all: LGPL-3.0-or-later with exceptions; only with the extra `postgres`",
    "tqdm": "some files: MPL-2.0",
}
# Packages whose licence files name a copyleft licence, of which nothing is.
NAMED_ONLY = {
    "backports-zstd": "Python's licence tells its history; zstd is BSD or GPL-2.0, as one likes",
    "typing-extensions": "Python's licence tells its history",
}
_COPYLEFT_NAME = re.compile(
    r"\b(A|L)?GPL|\bMPL|General Public|Mozilla Public|\bEPL|\bCDDL|\bEUPL", re.IGNORECASE
)
_LICENCE_FILE = re.compile("licen[cs]e|copying|notice|third", re.IGNORECASE)
_COPYLEFT_TEXT = re.compile(r"General\s+Public\s+License|Mozilla\s+Public\s+License", re.IGNORECASE)


def main() -> None:
    """Write the tables."""
    before, _, rest = PAGE.read_text("utf-8").partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}{tables()}{END}{rest.partition(END)[2]}", "utf-8")


def tables() -> str:
    """Return the licences of the packages that are installed here, and what is copyleft of them, as Markdown."""
    packages = required()
    extras = {extra: sorted(required(extra) - packages) for extra in _extras()}
    by_licence: dict[str, list[str]] = {}
    for name in sorted(packages):
        by_licence.setdefault(licence(name), []).append(f"{name} {metadata.version(name)}")
    rows = [
        f"| {stated} | {', '.join(names)} |\n"
        for stated, names in sorted(by_licence.items(), key=_most_first)
    ]
    for extra, names in extras.items():
        told = ", ".join(f"{name} {metadata.version(name)} ({licence(name)})" for name in names)
        rows.append(f"| added by the extra `{extra}` | {told} |\n")
    every = sorted(packages.union(*extras.values()) & COPYLEFT.keys())
    copyleft = [f"| {name} | {COPYLEFT[name]} |\n" for name in every]
    return "".join(
        ["| licence | packages |\n|---|---|\n", *rows, "\n| copyleft | what of it |\n|---|---|\n", *copyleft]
    )


def _most_first(entry: tuple[str, list[str]]) -> tuple[int, str]:
    return -len(entry[1]), entry[0]


def _extras() -> list[str]:
    return sorted(
        extra
        for extra in metadata.metadata("bagassets").get_all("Provides-Extra") or ()
        if all(is_installed(one.name) for one in _requirements("bagassets", extra))
    )


def required(extra: str = "", without: str = "") -> set[str]:
    """Return the names of all packages that bagassets requires here, itself not included.

    Args:
        extra: of bagassets, whose packages are included.
        without: a package that is left out, with all that only it requires.
    """
    found: set[str] = set()
    waiting = [("bagassets", extra)]
    while waiting:
        name, wanted = waiting.pop()
        for one in _requirements(name, wanted):
            key = canonicalize_name(one.name)
            if key == without:
                continue
            new = [(key, more) for more in one.extras]
            if key not in found:
                found.add(key)
                new.append((key, ""))
            waiting += new
    return found


def _requirements(name: str, extra: str) -> Iterator[Requirement]:
    """Yield what a package requires here without an extra, or what it requires because of one, too."""
    for text in metadata.requires(name) or ():
        one = Requirement(text)
        if one.marker is None or one.marker.evaluate({"extra": extra}):
            yield one


def is_installed(name: str) -> bool:
    """Return whether a package is installed here."""
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True


def licence(name: str) -> str:
    """Return the licence that a package states: its expression, else its field, else its classifiers."""
    stated = metadata.metadata(name)
    if expression := stated.get_all("License-Expression"):
        return str(expression[0])
    lines = "".join(stated.get_all("License") or ()).strip().splitlines()
    classifiers = [
        one.rpartition(" :: ")[2]
        for one in stated.get_all("Classifier") or ()
        if one.startswith("License ::")
    ]
    if len(lines) == 1 and len(lines[0]) <= _LONGEST and lines[0] != "Dual License":
        return _SPDX.get(lines[0], lines[0])
    return " OR ".join(_SPDX.get(one, one) for one in classifiers) or "not stated"


def names_copyleft(name: str) -> bool:
    """Return whether the licence of a package, or the text of one of its licence files, is that of a copyleft licence."""
    if _COPYLEFT_NAME.search(licence(name)):
        return True
    files = [one for one in metadata.files(name) or () if _LICENCE_FILE.match(one.name)]
    paths = [Path(str(file.locate())) for file in files if file.suffix not in {".py", ".pyc"}]
    texts = (path.read_text("utf-8", errors="replace") for path in paths if path.is_file())
    return any(_COPYLEFT_TEXT.search(text) for text in texts)


if __name__ == "__main__":
    main()
