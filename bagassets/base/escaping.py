"""Escaping text from recordings for terminals, Markdown, HTML and YAML.

Names of topics and frames, types, labels, file names and the errors that quote them may contain anything.
Everything that shows them goes through here.
"""

import re

# Control characters, line breaks, characters without width or that set the direction of text, lone surrogates.
_INVISIBLE = re.compile(
    "[\x00-\x1f\x7f-\x9f\xad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ufffe\uffff"
    "\ud800-\udfff\U000e0000-\U000e0fff]"
)

# Inside a word an underscore is literal; anywhere else it may begin or end emphasis.
_MARKDOWN = re.compile(r"[\\`*\[\]<>&|~!#@$^]|(?<![^\W_])_|_(?![^\W_])|:(?=//)|(?<=www)\.")
_HTML = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#x27;"})

# Text that every YAML reader takes as text even without quotes.
_BARE = re.compile(r"[A-Za-z_/][A-Za-z0-9_./-]*")
_NOT_TEXT = frozenset({"null", "true", "false", "yes", "no", "on", "off", "y", "n"})


def visible(text: str) -> str:
    r"""Return text as one line in which every character is visible; others are escaped, as in `\n` or `\x1b`.

    Applied again, it changes nothing.
    """
    return text if text.isprintable() else _INVISIBLE.sub(_spelled, text)


def _spelled(found: re.Match[str]) -> str:
    return found.group().encode("unicode_escape").decode("ascii")


def terminal(text: str) -> str:
    """Return text of one or more lines without control sequences for terminals.

    Names within the text must be made `visible` before: here, line breaks are kept.
    """
    return "\n".join(visible(line) for line in text.split("\n"))


def markdown(text: str) -> str:
    """Return text that Markdown, including GitHub's tables, shows literally: no link, image, tag or emphasis."""
    return _MARKDOWN.sub(r"\\\g<0>", visible(text).strip())


def html(text: str) -> str:
    """Return text for the content of an HTML element, or of an attribute in quotes."""
    return visible(text).translate(_HTML)


def yaml_scalar(text: str) -> str:
    """Return text as a YAML scalar that any reader takes for this text, quoted only if necessary."""
    if _BARE.fullmatch(text) and text.lower() not in _NOT_TEXT:
        return text
    quoted = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{_INVISIBLE.sub(_spelled, quoted)}"'
