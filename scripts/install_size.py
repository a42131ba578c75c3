"""Measure how much disk space an installation takes, and which packages take it.

    python -m scripts.install_size                      # measures, writes benchmarks/results/install_size.json
    python -m scripts.install_size --print              # the table of docs/install.md from that file

Makes an environment with the Python that runs this, installs the checkout with the versions of `requirements.lock`,
as `pip install .` does, and adds up the files of each package. The environment is removed in the end.
"""

import argparse
import json
import platform
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scripts.licences import required

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "benchmarks" / "results" / "install_size.json"
SHOWN = 8
MB = 1e6

NEEDED = "needed"
# What each large package is for, and how to do without.
REASONS = {
    "llvmlite": ("compiles loops over images and points", "uninstall it: the same bytes, more slowly"),
    "pyarrow": ("Parquet: poses, boxes, indexes", NEEDED),
    "opencv-python-headless": ("decodes, undistorts and encodes images", NEEDED),
    "dagster": ("the assets, runs and their records", NEEDED),
    "dagster-webserver": ("the web UI", "uninstall it where only builds or the daemon run"),
    "numpy": ("arrays", NEEDED),
    "grpcio": ("of Dagster: talks to code servers", NEEDED),
    "sqlalchemy": ("of Dagster: its database", NEEDED),
    "zstandard": ("unpacks recordings", NEEDED),
}
# Packages that may be missing, with all that only they require.
OPTIONAL = ("llvmlite", "dagster-webserver")

_SIZES = """
import importlib.metadata, json
sizes = {}
for one in importlib.metadata.distributions():
    files = {str(file.locate().resolve()) for file in one.files or ()}
    sizes[one.metadata["Name"].lower().replace("_", "-").replace(".", "-")] = [one.version, sorted(files)]
print(json.dumps(sizes))
"""


def main() -> None:
    """Measure, or print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--print", action="store_true", help="print the table of the last measurement")
    parser.add_argument("--output", type=Path, default=RESULT)
    arguments = parser.parse_args()
    if not arguments.print:
        result = measure()
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text(json.dumps(result, indent=1) + "\n")
    print(table(json.loads(arguments.output.read_text())))


def measure() -> dict[str, Any]:
    """Install into a new environment, and return the bytes of each package there."""
    with TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        python = Path(folder) / "bin" / "python"
        install: list[str | Path] = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*install, "--constraint", ROOT / "requirements.lock", ROOT], check=True)
        found = subprocess.run([python, "-c", _SIZES], check=True, capture_output=True, text=True, cwd=folder)
        packages = {
            name: {"version": version, "bytes": sum(map(size_of, files)), "files": len(files)}
            for name, (version, files) in json.loads(found.stdout).items()
        }
        total = sum(map(size_of, map(str, Path(folder).rglob("*"))))
        compiled = sum(map(size_of, map(str, Path(folder).rglob("*.pyc"))))
    alone = {name: sorted(required() - required(without=name)) for name in OPTIONAL}
    return {
        "python": platform.python_version(),
        "system": platform.system(),
        "machine": platform.machine(),
        "total_bytes": total,
        "compiled_bytes": compiled,
        "optional": {
            name: {"packages": names, "bytes": sum(packages[one]["bytes"] for one in names)}
            for name, names in alone.items()
        },
        "packages": dict(sorted(packages.items(), key=lambda item: -item[1]["bytes"])),
    }


def size_of(path: str) -> int:
    """Return the bytes of a file; nothing for a link, a folder, or what is gone."""
    file = Path(path)
    return file.stat().st_size if file.is_file() and not file.is_symlink() else 0


def table(result: dict[str, Any]) -> str:
    """Return the largest packages as Markdown, and the sum of all."""
    packages = list(result["packages"].items())
    rows = [
        f"| `{name}` | {one['bytes'] / MB:.0f} | {' | '.join(REASONS.get(name, ('', '')))} |"
        for name, one in packages[:SHOWN]
    ]
    rest = result["total_bytes"] - sum(one["bytes"] for _, one in packages[:SHOWN])
    return "\n".join(
        [
            "| package | MB | what for | without it |",
            "|---|--:|---|---|",
            *rows,
            f"| {len(packages) - SHOWN} others | {rest / MB:.0f} | | |",
            f"| **all** | **{result['total_bytes'] / MB:.0f}** | | |",
            "",
            *(_without(name, one) for name, one in result["optional"].items()),
            f"- {result['compiled_bytes'] / MB:.0f} MB of all are compiled Python (`.pyc`): `pip install --no-compile` leaves out what is not imported later.",
        ]
    )


def _without(name: str, one: dict[str, Any]) -> str:
    """Return how to do without an optional package, and what that saves."""
    others = (
        ""
        if len(one["packages"]) == 1
        else ", with all that only it requires; in an environment that has nothing else"
    )
    return (
        f"- `pip uninstall {' '.join(one['packages'])}` saves {one['bytes'] / MB:.0f} MB: `{name}`{others}."
    )


if __name__ == "__main__":
    main()
