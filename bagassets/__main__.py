"""The command `bagassets`, and `python -m bagassets`.

A build with nothing to do is decided here, before anything is imported that takes time, and any other is begun by its
server meanwhile.
"""

import os
import sys

__all__ = ["main"]


def main() -> int:
    """Run the command line and return its exit status."""
    try:
        return _main()
    except KeyboardInterrupt:  # before the command line is there to say it
        from bagassets.cli.exit_status import ExitStatus

        sys.stderr.write("Interrupted.\n")
        return ExitStatus.INTERRUPTED


def _main() -> int:
    if sys.getfilesystemencoding() != "utf-8" and os.environ.get("PYTHONUTF8") != "1":
        # Names of recordings are UTF-8, whatever the locale; Python can only be started with that.
        os.execve(sys.executable, sys.orig_argv, os.environ | {"PYTHONUTF8": "1"})  # noqa: S606  (no shell)
    handed_over = None
    if sys.argv[1:2] == ["build"]:
        from bagassets.freshness.decide import nothing_to_do, plain_build

        lines = nothing_to_do(sys.argv[1:])
        if lines is not None:
            sys.stdout.write("".join(f"{line}\n" for line in lines))
            return 0
        if asked := plain_build(sys.argv[1:]):
            from bagassets.cli.early import hand_over

            handed_over = hand_over(*asked)
    from bagassets.cli.main import main as run

    return run(handed_over=handed_over)


if __name__ == "__main__":
    sys.exit(main())
