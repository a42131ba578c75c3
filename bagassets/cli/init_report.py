"""What `bagassets init` prints: the topics it found and what becomes of them, what is open, and what to do next."""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from textwrap import wrap

from bagassets.base.alike import names_text
from bagassets.base.escaping import visible
from bagassets.base.quantities import count_text
from bagassets.cli.terminal import echo
from bagassets.propose.commented_yaml import Question
from bagassets.propose.proposal import Proposal
from bagassets.propose.sensors import shown_type
from bagassets.propose.summary import USES, TopicUse

_WIDEST = 110
_LISTED = 20
_LEFT_OUT_LISTED = 8


def print_found(proposal: Proposal, unreadable: Mapping[str, str]) -> None:
    """Print the rigs with their topics, and the recordings that are left out."""
    printed: dict[tuple[tuple[str, str, str], ...], str] = {}
    for rig in proposal.rigs:
        poses = f"poses from {rig.pose.fields['source']}" if rig.pose.fields else "no poses"
        title = "One rig" if len(proposal.rigs) == 1 else f"Rig {rig.name}"
        echo(f"{title} ({count_text(len(rig.recordings), 'recording')}; {poses})")
        uses = rig.topic_uses
        same = printed.setdefault(
            tuple((use.topic.name, use.topic.msgtype, _becomes(use)) for use in uses), rig.name
        )
        if same == rig.name:
            _print_topics(uses)
        else:
            echo(f"  the topics of rig {same}, with other frames or poses")
    for reason in sorted({one.reason for one in proposal.bare}):
        recordings = [one for one in proposal.bare if one.reason == reason]
        echo(f"Left out: {names_text([one.path for one in recordings])}: {reason}")
        _print_topics(_merged(use for one in recordings for use in one.topic_uses))
    for path, reason in list(unreadable.items())[:_LISTED]:
        echo(f"Left out: {path}: {reason}")
    if len(unreadable) > _LISTED:
        echo(f"Left out: {len(unreadable) - _LISTED} more that cannot be read")
    echo("")


def print_next_steps(
    project: Path, written: Sequence[str], proposal: Proposal, problems: Sequence[str]
) -> None:
    """Print what was written, what is to be decided, and the next commands.

    Args:
        project: the project folder.
        written: names of the files written there.
        proposal: what was written as recipe.
        problems: what is wrong with the recipe besides its questions.
    """
    echo(f"Project {project}: {', '.join(written)}")
    if proposal.guesses:
        are, them = ("guess is", "it") if proposal.guesses == 1 else ("guesses are", "them")
        echo(f"{proposal.guesses} {are} marked in recipe.yaml; look at {them} first.")
    where = "recipe.yaml before the first build"
    print_questions(where, proposal, problems, f"cd {project}", "bagassets build")


def print_questions(where: str, proposal: Proposal, problems: Sequence[str], *steps: str) -> None:
    """Print what is to be decided, questions of one text together, and the steps that follow, if there is a rig."""
    is_open = proposal.questions or problems
    if is_open:
        echo(f"To be decided in {where}:")
    together: dict[tuple[str, str], list[Question]] = {}
    for question in proposal.questions:
        together.setdefault((question.rig, question.text), []).append(question)
    for (rig, text), same in together.items():
        subjects = ", ".join(question.subject for question in same)
        lines = ", ".join(str(question.line) for question in same)
        whose = f"{rig}: " if rig and len(proposal.rigs) > 1 else ""
        sentence = f"{whose}{subjects} (line{'s' if len(same) > 1 else ''} {lines}): {text}"
        for line in wrap(
            visible(sentence),
            min(_columns(), _WIDEST),
            initial_indent="  ",
            subsequent_indent="    ",
            break_long_words=False,
            break_on_hyphens=False,
        ):
            echo(line)
    for problem in problems:
        echo(f"  {problem}")
    if proposal.rigs:
        echo("When that is done:" if is_open else "Then:")
        for step in steps:
            echo(f"  {step}")


def _print_topics(uses: Sequence[TopicUse]) -> None:
    """Print a table of topics; of those that nothing needs, only the first."""
    shown = [use for use in uses if use.status != "not needed"]
    unneeded = [use for use in uses if use.status == "not needed"]
    shown += unneeded[:_LEFT_OUT_LISTED]
    if not shown:
        echo("  no topics")
        return
    rows = [("topic", "type", "messages", "becomes")]
    rows += [
        (visible(use.topic.name), shown_type(use.topic.msgtype), str(use.topic.count), _becomes(use))
        for use in shown
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    columns = _columns()
    for name, msgtype, count, text in rows:
        line = f"  {name:{widths[0]}}  {msgtype:{widths[1]}}  {count:>{widths[2]}}"
        if len(line) + 2 + len(text) <= columns:
            echo(f"{line}  {text}")
        else:
            echo(line)
            echo(f"      {text}")
    if (more := len(unneeded) - _LEFT_OUT_LISTED) > 0:
        echo(f"  and {more} more that {'is' if more == 1 else 'are'} not needed")


def _becomes(use: TopicUse) -> str:
    if use.status == "used":
        return use.text
    return f"{use.status}: {use.text}" if use.text else use.status


def _merged(uses: Iterable[TopicUse]) -> list[TopicUse]:
    """Return each topic once, with the first of its uses."""
    by_name: dict[tuple[str, str], TopicUse] = {}
    for use in uses:
        by_name.setdefault((use.topic.name, use.topic.msgtype), use)
    return sorted(by_name.values(), key=lambda use: USES.index(use.status))


def _columns() -> int:
    return shutil.get_terminal_size((120, 24)).columns
