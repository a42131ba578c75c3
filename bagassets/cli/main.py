"""The command `bagassets`: its subcommands by name, and the exit status.

A subcommand is imported when it is called, so `bagassets --help` imports none.
"""

import gc
import importlib
import os
import sys
from collections.abc import Sequence
from errno import EACCES, EDQUOT, EEXIST, EISDIR, ENAMETOOLONG, ENOENT, ENOSPC, ENOTDIR, EPERM, EROFS
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets import __version__
from bagassets.base.disk_errors import disk_fails
from bagassets.base.errors import BagAssetsError, kind_and_text
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.terminal import echo, status_of_unwritten

if TYPE_CHECKING:
    from bagassets.cli.early import HandedOver


# Name -> the line in the overview, which a test compares with the help of the command.
COMMANDS = {
    "init": "Make a project folder, with a recipe proposed from recordings.",
    "inspect": "Print what a recording holds.",
    "doctor": "Say what is wrong with a recording, where, what can be saved, and what to do next.",
    "build": "Bring all recordings and the dataset up to date, and report what was done.",
    "convert": "Convert one recording into a dataset, without a project.",
    "status": "Show what is fresh, stale, skipped or failed, and why.",
    "explain": "Show what an asset of a recording is made from, and what has changed since the last time.",
    "check": "Run the checks of the recipe on what was built, and print the findings.",
    "ui": "Open the web UI of a project.",
    "report": "Write one HTML page about the dataset: recordings, splits, checks, classes, gaps, losses, pictures, map.",
    "view": "Write a scene of the dataset as an MCAP file with Foxglove's message types.",
    "digest": "Print digests of recordings and store them with the files.",
    "watch": "Watch a folder of recordings and keep their digests up to date.",
    "verify": "Check that store and recordings are intact, and that actions are reproducible.",
    "gc": "Remove artifacts that nothing refers to any more.",
    "dataset": "Compare datasets, and restore one from its lock.",
    "demo": "Write sample drives and build the dataset from them.",
    "sample": "Write a synthetic drive with known ground truth.",
    "decoders": "List installed decoders for your own message types.",
    "formats": "List dataset formats, and the assets of recordings that packages add.",
    "docs": "Print documentation as Markdown: references, and pages about one subject each.",
}
# Those that are not in a module of their own.
_MODULES = {"decoders": "plugins", "formats": "plugins"}


# Importing Dagster makes a million objects that stay: with Python's 700, a quarter of its time is spent on looking.
_GC_THRESHOLD = 100_000

# Errors of the file system that a path given by the user, or a failing disk, can cause; any other is a defect.
_REFUSALS = {EACCES, EDQUOT, EEXIST, EISDIR, ENAMETOOLONG, ENOENT, ENOSPC, ENOTDIR, EPERM, EROFS}


class _LazyGroup(click.Group):
    """A group that imports a command when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002  (signature of click)
        """Return the names of the commands in the order of `COMMANDS`."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return one command."""
        if cmd_name not in self.list_commands(ctx):
            return None
        module = importlib.import_module(f"bagassets.cli.{_MODULES.get(cmd_name, cmd_name)}")
        command: click.Command = getattr(module, cmd_name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the overview without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name]) for name in self.list_commands(ctx)])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; suggest one if there is none of that name."""
        from difflib import get_close_matches

        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            near = get_close_matches(args[0], COMMANDS, n=1)
            hint = f"Did you mean {near[0]}?" if near else f"The commands are {', '.join(COMMANDS)}."
            ctx.fail(f"No such command '{args[0]}'. {hint}")
        return super().resolve_command(ctx, args)


@click.group(
    cls=_LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="""\b
Examples:
  bagassets init my-project --bags /data/recordings
  cd my-project && bagassets build
  bagassets inspect /data/recordings/monday.bag""",
)
@click.version_option(__version__, prog_name="bagassets", message="%(prog)s %(version)s")
def root() -> None:
    """Turn robot recordings into machine-learning datasets, built like a program."""


def main(args: Sequence[str] | None = None, *, handed_over: "HandedOver | None" = None) -> int:
    """Run the command line and return its exit status.

    A build may have been handed over to its server (`bagassets.cli.early`). 0 is success, 1 an error that the user can fix, 2 wrong usage, 70 a defect of this program, 130 an interruption.
    """
    arguments = list(sys.argv[1:] if args is None else args)
    gc.set_threshold(_GC_THRESHOLD)
    try:
        result = root.main(arguments, prog_name="bagassets", standalone_mode=False, obj=handed_over)
    except click.ClickException as err:
        err.show()
        return err.exit_code
    except BagAssetsError as err:
        for line in str(err).splitlines():
            echo(f"error: {line}", err=True)
        return ExitStatus.FAILED
    except OSError as err:
        status = status_of_unwritten(err)
        if status is not None:
            return status
        text = text_of_refusal(err)
        if text is None:
            return _crashed(err, arguments)
        echo(f"error: {text}", err=True)
        return ExitStatus.FAILED
    except Exception as err:  # noqa: BLE001  (a defect; its traceback goes to a file)
        if _is_interrupt(err):
            echo("Interrupted.", err=True)
            return ExitStatus.INTERRUPTED
        return _crashed(err, arguments)
    return result if isinstance(result, int) else 0


def _is_interrupt(err: Exception) -> bool:
    """Return whether somebody interrupted: click says so, and Python 3.11 and pydantic by another error, amid a class."""
    return isinstance(err, click.exceptions.Abort) or any(
        "KeyboardInterrupt" in repr(one) for one in (err, err.__cause__)
    )


def text_of_refusal(err: OSError) -> str | None:
    """Return a sentence about an error that a path given by the user, or the disk, can cause; None if it is a defect."""
    if disk_fails(err):  # reads of an open file do not name it
        return f"{err.filename or 'a file'} cannot be read or written ({err.strerror}); check the disks of project, store and recordings."
    if err.filename is None and err.errno == ENOENT and _folder_is_gone():
        return "the current folder is gone; change to one that is there, and try again."
    if err.errno not in _REFUSALS or err.filename is None:
        return None
    return f"{err.filename}: {err.strerror}; name another path, or fix this one and try again."


def _folder_is_gone() -> bool:
    try:
        Path.cwd()
    except FileNotFoundError:
        return True
    return False


def _crashed(err: Exception, arguments: list[str]) -> int:
    """Write the traceback to a file and print its path."""
    import tempfile
    import traceback

    try:
        descriptor, path = tempfile.mkstemp(prefix="bagassets-", suffix=".log")
        with os.fdopen(descriptor, "w", encoding="utf-8", errors="backslashreplace") as log:
            log.write(f"bagassets {__version__}, Python {sys.version}\narguments: {arguments}\n\n")
            traceback.print_exception(err, file=log)
        where = f"the traceback is in {path}; please report it"
    except OSError:
        where = "the traceback could not be written"
    echo(f"error: this is a defect of bagassets ({kind_and_text(err)}); {where}.", err=True)
    return ExitStatus.CRASHED
