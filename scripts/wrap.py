"""Wrap the prose of pages at one width.

    python -m scripts.wrap README.md docs/*.md

Code, tables, headings, quotes, comments, HTML and what is generated stay as they are.
"""

import re
import sys
from pathlib import Path
from textwrap import wrap

__all__ = ["WIDTH", "wrapped"]

WIDTH = 120
_NO_BREAK = "\0"  # in place of a space
_ITEM = re.compile(r"( *)([-*] |\d+\. )")
_AS_IT_IS = re.compile(r" *(```|~~~)|<!-- (\w+)(?:: [\w ]+)? -->$")  # code, and what is generated
_NO_PROSE = re.compile(r" *(\||#|<|!\[|>|    |\[[^\]]+\]: )|.*(  |\\)$")


def wrapped(text: str) -> str:
    """Return a page with its paragraphs and items wrapped anew."""
    output: list[str] = []
    paragraph: list[str] = []  # its lines, without indentation
    first = rest = ""  # what stands before its first line, and before all others
    until = ""  # what ends the lines that stay as they are

    def end() -> None:
        if paragraph:
            output.extend(_lines(" ".join(paragraph), first, rest))
            paragraph.clear()

    for line in text.split("\n"):
        begin = _AS_IT_IS.match(line)
        if until or begin:
            end()
            output.append(line)
            if begin and not until:
                until = begin[1] or f"<!-- end of {begin[2]} -->"
            elif line.lstrip().startswith(until):
                until = ""
            continue
        item = _ITEM.match(line)
        indent = len(line) - len(line.lstrip())
        if (
            not line.strip()
            or (not item and not paragraph and _NO_PROSE.match(line))
            or re.match(r" *(\||#|<|>)", line)
        ):
            end()
            output.append(line)
        elif item:
            end()
            first, rest = item[0], " " * len(item[0])
            paragraph.append(line[len(item[0]) :].strip())
        else:
            if not paragraph:
                first = rest = " " * indent
            paragraph.append(line.strip())
    end()
    return "\n".join(output)


def _lines(text: str, first: str, rest: str) -> list[str]:
    """Wrap a paragraph, without breaking code and figures."""
    text = re.sub(
        r"`[^`]*`|\S+ <!-- figures.*?end of figures -->", lambda code: code[0].replace(" ", _NO_BREAK), text
    )
    lines = wrap(
        text,
        WIDTH,
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )
    text, *lines = (line.replace(_NO_BREAK, " ") for line in (text, *lines))
    # A line must not begin with what would be an item, a heading or a table there.
    if any(re.match(r"\s*([-+*#|>]|\d+[.)])(\s|$)", line[len(rest) :]) for line in lines[1:]):
        return [first + text]
    return lines


if __name__ == "__main__":
    for name in sys.argv[1:]:
        page = Path(name)
        page.write_text(wrapped(page.read_text("utf-8")), "utf-8")
