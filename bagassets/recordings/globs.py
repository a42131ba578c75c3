"""Globs over paths below the bag root, with `**` for any number of folders."""

import re
from functools import cache


def matches(pattern: str, relative: str) -> bool:
    """Tell whether a glob matches a path with `/`.

    `*` and `?` match within one name, `**` spans any number of folders, `[…]` is a set. `drives/**` also matches the
    folder `drives` itself, which may be a ROS 2 bag.
    """
    return _compiled(pattern).fullmatch(relative) is not None


def literal_glob(relative: str) -> str:
    """Return a glob that matches just this path."""
    return re.sub(r"([*?\[])", r"[\1]", relative)


def may_match_within(pattern: str, folder: str) -> bool:
    """Tell whether a glob may match a folder or something in it, by the text before its first wildcard."""
    start = _text_before_wildcard(pattern)
    return f"{folder}/".startswith(start) or start.startswith(f"{folder}/")


@cache
def _text_before_wildcard(pattern: str) -> str:
    """Return the text that all paths which a glob matches start with; `[*]` and its like stand for one character."""
    text, rest = "", pattern
    while plain := re.match(r"[^*?\[]|\[([*?\[])\]", rest):
        text += plain[1] or plain[0]
        rest = rest[plain.end() :]
    return text


@cache
def _compiled(pattern: str) -> re.Pattern[str]:
    parts = []
    at = 0
    while at < len(pattern):
        if at > 0 and pattern[at:] == "/**":
            parts.append("(?:/.*)?")
            at += 3
        elif pattern.startswith("**/", at) and pattern[at - 1 : at] in {"", "/"}:
            parts.append("(?:.*/)?")
            at += 3
        elif pattern.startswith("**", at):
            parts.append(".*")
            at += 2
        elif pattern[at] == "*":
            parts.append("[^/]*")
            at += 1
        elif pattern[at] == "?":
            parts.append("[^/]")
            at += 1
        elif pattern[at] == "[" and "]" in pattern[at + 2 :]:
            end = pattern.index("]", at + 2)
            # Python's set operators mean nothing in a glob.
            inside = re.sub(r"[\\\[&~|]", r"\\\g<0>", pattern[at + 1 : end])
            parts.append(f"[{'^' + inside[1:] if inside.startswith('!') else inside}]")
            at = end + 1
        else:
            parts.append(re.escape(pattern[at]))
            at += 1
    return re.compile("".join(parts), re.DOTALL)
