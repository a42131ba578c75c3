"""The messages that docs/troubleshooting.md explains are those of the code, word by word."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.once

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
QUOTED = [line[2:] for line in PAGE.splitlines() if line.startswith("> ")]


def texts_of(module):
    """The texts in a module; `\\0` stands for what an f-string fills in."""
    for node in ast.walk(ast.parse(module.read_text("utf-8"))):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "\0" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@cache
def texts():
    """All texts of the code; seconds of parsing, which only those who run these tests spend."""
    return "\n\n".join(text for module in (ROOT / "bagassets").rglob("*.py") for text in texts_of(module))


def missing(message):
    """Return the words between `…` that are nowhere in the code; a message may be put together from several texts."""
    return [words for words in map(str.strip, message.split("…")) if len(words) > 2 and words not in texts()]


def test_there_are_ten_at_least():
    assert len(QUOTED) >= 10


@pytest.mark.parametrize("message", QUOTED, ids=lambda message: re.sub(r"\W+", "_", message)[:40])
def test_the_code_has_this_message(message):
    assert missing(message) == []


def test_a_message_that_nothing_says_is_found():
    assert missing("…: this is said by nobody …: no recording found") == [": this is said by nobody"]
