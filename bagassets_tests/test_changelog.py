"""The changelog has the form that its readers and the release procedure rely on."""

import re
from pathlib import Path

import bagassets

TEXT = (Path(__file__).parents[1] / "CHANGELOG.md").read_text("utf-8")
KINDS = ["Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"]


def test_the_version_of_the_package_is_the_newest_that_has_a_section():
    sections = re.findall(r"^## (.+)$", TEXT, re.MULTILINE)
    newest = next(section for section in sections if section != "[Unreleased]")
    assert re.fullmatch(r"\[\d+\.\d+\.\d+\] - (Unreleased|\d{4}-\d{2}-\d{2})", newest)
    assert newest.startswith(f"[{bagassets.__version__}]")


def test_each_section_has_the_kinds_of_change_in_their_order():
    for section in re.split(r"^## ", TEXT, flags=re.MULTILINE)[1:]:
        kinds = re.findall(r"^### (.+)$", section, re.MULTILINE)
        assert kinds == [kind for kind in KINDS if kind in kinds], section.partition("\n")[0]


def test_no_entry_stands_above_the_sections():
    assert not re.search(r"^- ", TEXT.partition("### ")[0], re.MULTILINE)
