"""Have the newest lerobot load, decode, merge and train on what we write: by hand, after a change of the writers.

    python -m scripts.newest_lerobot [--python python3.13] [--debian]

It needs Python 3.12 or later, and some 6 GB of disk where torch comes with CUDA. Without such a Python, `--debian` makes
one as root, by debootstrap of Debian 13. The result is committed, and a test fails when the writers changed since.
"""

import argparse
import ast
import json
import os
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree as ET

from blake3 import blake3

from scripts.test_all import find_pythons

__all__ = ["RESULT", "main", "writers_fingerprint"]

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "build" / "newest-lerobot"
DEBIAN = FOLDER / "debian"
RESULT = ROOT / "benchmarks" / "results" / "newest_lerobot.json"
LEAST_PYTHON = (3, 12)
# Module -> what of it shapes what readers see; empty: all. The rest links, counts and says why.
WRITERS: dict[str, set[str]] = {
    "join": {"run", "_rows", "_own_columns", "_statistics"},
    "metadata": set(),
    "recording_part": {"as_column", "_specifications"},
    "statistics": set(),
    "video": set(),
}
_PACKAGES = ["lerobot[dataset]", "accelerate"]
# Where that index cannot be reached, trying it again for each package takes many minutes.
_WITHOUT_CUDA = ["--retries", "0", "--extra-index-url", "https://download.pytorch.org/whl/cpu"]
_TOLD = """
import json, sys
from importlib.metadata import version
names = ("lerobot", "torch", "av", "datasets", "numpy")
print(json.dumps({"python": sys.version.split()[0], **{name: version(name) for name in names}}))
"""


def main(arguments: list[str]) -> int:
    """Make the environment, run the tests in it, and keep the result; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--python", help="Python 3.12 or later; default: the newest here")
    parser.add_argument("--debian", action="store_true", help="make one with debootstrap, as root")
    options = parser.parse_args(arguments)
    FOLDER.mkdir(parents=True, exist_ok=True)
    python = _debian() if options.debian else options.python or _newest()
    if python is None:
        parser.error("the newest lerobot needs Python 3.12 or later: name one with --python, or see --debian")
    environment = FOLDER / "environment"
    inside: Path = environment / "bin" / "python"
    if options.debian:
        inside = _in_debian(inside)
    if not (environment / ".made").exists():
        _run(python, "-m", "venv", "--clear", environment)
        _install(inside)
        (environment / ".made").touch()
    report = FOLDER / "report.xml"
    started = time.monotonic()
    status = subprocess.run(
        [sys.executable, "-m", "pytest", "-n", "0", "-m", "lerobot", f"--junitxml={report}", "bagassets_tests/formats/lerobot"],
        cwd=ROOT, env={**os.environ, "BAGASSETS_LEROBOT_PYTHON": str(inside)}, check=False,
    ).returncode  # fmt: skip
    cases = ET.parse(report).getroot().iter("testcase")
    found = {
        **json.loads(subprocess.check_output([inside, "-c", _TOLD], text=True)),
        "date": datetime.now(UTC).date().isoformat(),
        "minutes": round((time.monotonic() - started) / 60, 1),
        "tests": {case.attrib["name"]: "failed" if len(case) else "passed" for case in cases},
        "writers": writers_fingerprint(),
    }
    RESULT.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found, indent=1))
    return status


def writers_fingerprint() -> str:
    """Return a digest of the code that writes LeRobot datasets, without comments, docstrings and imports."""
    lines = []
    for name, functions in WRITERS.items():
        text = (ROOT / "bagassets" / "formats" / "lerobot" / f"{name}.py").read_text(encoding="utf-8")
        parts = [one for one in ast.walk(ast.parse(text)) if getattr(one, "name", "") in functions]
        text = "\n".join(ast.get_source_segment(text, one) or "" for one in parts) if functions else text
        left_out: set[int] = set()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Expr) and not isinstance(node.value, ast.Constant):
                continue
            if isinstance(node, ast.Expr | ast.Import | ast.ImportFrom):
                left_out.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        kept = (line.strip() for number, line in enumerate(text.splitlines(), 1) if number not in left_out)
        lines += [line for line in kept if line and not line.startswith("#")]
    return blake3("\n".join(lines).encode()).hexdigest()


def _newest() -> str | None:
    pythons = {version: path for version, path in find_pythons().items() if version >= LEAST_PYTHON}
    return pythons[min(pythons)] if pythons else None  # torch has wheels for the oldest of them first


def _debian() -> Path:
    """Return the Python of a Debian 13 in a folder, which debootstrap makes."""
    if not (DEBIAN / "usr" / "bin" / "python3").exists():
        _run("debootstrap", "--variant=minbase", "--include=python3-venv,ca-certificates", "trixie", DEBIAN)
    return _in_debian(Path("/usr/bin/python3"))


def _in_debian(program: Path) -> Path:
    """Return a script that runs a program there, with the checkout, /tmp and the certificates of this system."""
    script = FOLDER / f"{program.parts[-3]}-python"
    script.write_text(
        f"""#!/bin/sh
cp /etc/resolv.conf {DEBIAN}/etc/resolv.conf
exec unshare --mount sh -c 'for one in {ROOT} /tmp /dev /proc /etc/ssl; do
  mkdir -p {DEBIAN}$one && mount --rbind $one {DEBIAN}$one || exit 1
done
exec chroot {DEBIAN} {program} "$@"' sh "$@"
"""
    )
    script.chmod(0o755)
    return script


def _install(python: Path) -> None:
    """Install lerobot, with torch for the processor alone if its index can be reached."""
    install: list[str | Path] = [python, "-m", "pip", "install", "--quiet"]
    if subprocess.run([*install, *_WITHOUT_CUDA, *_PACKAGES], check=False).returncode:
        _run(*install, *_PACKAGES)


def _run(*command: str | Path) -> None:
    print("+", *command, flush=True)
    subprocess.run(command, check=True)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
