"""The changelog has the form that its readers and the release procedure rely on."""

import re
from pathlib import Path

from packaging.version import Version

import bagassets

TEXT = (Path(__file__).parents[2] / "CHANGELOG.md").read_text("utf-8")
KINDS = ["Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"]


def test_the_version_is_the_newest_released_or_later_where_something_is_unreleased():
    """pip leaves what is installed in place if a wheel has the same version, and nodes of Slurm compare versions."""
    first, *rest = re.findall(r"^## (.+)$", TEXT, re.MULTILINE)
    newest = rest[0] if first == "[Unreleased]" else first
    released = re.fullmatch(r"\[(\d+\.\d+\.\d+)\] - \d{4}-\d{2}-\d{2}", newest)[1]
    if first == "[Unreleased]":
        assert re.fullmatch(r"\d+\.\d+\.\d+\.dev0", bagassets.__version__)
        assert Version(bagassets.__version__) > Version(released)
    else:
        assert bagassets.__version__ == released


def test_each_section_has_the_kinds_of_change_in_their_order():
    for section in re.split(r"^## ", TEXT, flags=re.MULTILINE)[1:]:
        kinds = re.findall(r"^### (.+)$", section, re.MULTILINE)
        assert kinds == [kind for kind in KINDS if kind in kinds], section.partition("\n")[0]


def test_no_entry_stands_above_the_sections():
    assert not re.search(r"^- ", TEXT.partition("### ")[0], re.MULTILINE)
