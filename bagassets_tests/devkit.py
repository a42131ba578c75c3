"""Running scripts in the environment of the real nuscenes-devkit, which needs numpy < 2."""

import json
import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
HERE = Path(__file__).resolve().parent


def devkit_python():
    """The devkit's interpreter; a missing one is a failure, never a skipped test."""
    python = Path(os.environ.get("BAGASSETS_DEVKIT_PYTHON", ROOT / ".devkit-venv" / "bin" / "python"))
    if not python.is_file():
        raise AssertionError(
            f"{python} does not exist: the tests of the devkit need its environment, which `make test` makes "
            "(or name one in BAGASSETS_DEVKIT_PYTHON)."
        )
    return str(python)


def run_devkit(script, *arguments):
    """Run a script of this folder and return the JSON on the last line of its output."""
    done = subprocess.run(
        [devkit_python(), str(HERE / script), *map(str, arguments)],
        capture_output=True, text=True, timeout=300, check=False, env={**os.environ, "MPLBACKEND": "Agg"},
    )  # fmt: skip
    assert done.returncode == 0, f"{script} failed:\n{done.stderr[-4000:]}"
    return json.loads(done.stdout.strip().splitlines()[-1])
