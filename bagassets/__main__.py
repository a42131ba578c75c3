"""The command `bagassets`, and `python -m bagassets`.

A build with nothing to do is decided here, before anything is imported that takes time, and any other is begun by its
server meanwhile. A command that only reads is carried out by that server, if it is up.
"""

import os
import signal
import sys

from bagassets.base.lost_interrupts import interrupt_soon
from bagassets.base.unread_pipe import outliving_reader

# Commands that only read, or may (`build --check`).
_READING = ("build", "check", "explain", "status")


def run() -> None:
    """Run the command line and end this process.

    A command that is over in a moment does not have Python take apart all that it imported, which takes 20 ms: it has
    closed what it opened.
    """
    sys.unraisablehook = interrupt_soon
    try:
        status = main()
    except SystemExit as end:  # of a command
        if not isinstance(end.code, int):
            raise
        status = end.code
    if sys.argv[1:2] and sys.argv[1] in _READING:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        except (OSError, ValueError):
            pass  # Python meets it again, and reports it
        else:
            os._exit(status)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # Python would print where it is when it ends
    sys.exit(status)


def main() -> int:
    """Run the command line and return its exit status."""
    try:
        return _main()
    except KeyboardInterrupt:  # before the command line is there to say it
        from bagassets.cli.exit_status import ExitStatus

        sys.stderr.write("Interrupted.\n")
        return ExitStatus.INTERRUPTED


def _main() -> int:
    _replace_closed_streams()
    if sys.getfilesystemencoding() != "utf-8" and os.environ.get("PYTHONUTF8") != "1":
        # Names of recordings are UTF-8, whatever the locale; Python can only be started with that.
        os.execve(sys.executable, sys.orig_argv, os.environ | {"PYTHONUTF8": "1"})  # noqa: S606  (no shell)
    arguments = sys.argv[1:]
    if arguments[:1] != ["watch"]:  # which would go on for ever
        sys.stdout, sys.stderr = outliving_reader(sys.stdout), outliving_reader(sys.stderr)
    handed_over = None
    if arguments[:1] == ["build"]:
        from bagassets.engine.freshness.decide import nothing_to_do, plain_build

        lines = nothing_to_do(arguments)
        if lines is not None:
            return _print(lines)
        if asked := plain_build(arguments):
            from bagassets.cli.early import hand_over

            handed_over = hand_over(*asked)
    if handed_over is None and arguments[:1] and arguments[0] in _READING:
        from bagassets.cli.on_server import run_on_server

        status = run_on_server(arguments)
        if status is not None:
            return status
    from bagassets.cli.main import main as run_command

    return run_command(handed_over=handed_over)


def _print(lines: list[str]) -> int:
    """Print lines; return the exit status."""
    try:
        sys.stdout.write("".join(f"{line}\n" for line in lines))
        sys.stdout.flush()
    except OSError as err:
        from bagassets.cli.terminal import status_of_unwritten

        status = status_of_unwritten(err)
        if status is None:
            raise
        return status
    return 0


def _replace_closed_streams() -> None:
    """Have something to read from and write to where a caller has closed a stream, as in `>&-`.

    Otherwise the next file that is opened would take its place, and get what others write to standard output.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode, encoding="utf-8", errors="backslashreplace")  # noqa: SIM115, PTH123  (to the end of the process; Path takes long to import)
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)


if __name__ == "__main__":
    run()
