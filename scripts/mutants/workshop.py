"""A copy of the checkout with an environment of its own, in which files may be changed while tests run."""

import shutil
import subprocess
import sys
from pathlib import Path

__all__ = ["Workshop"]

_BEGIN_COVERAGE = (
    "import os; os.environ.get('COVERAGE_PROCESS_START') and __import__('coverage').process_startup()\n"
)


class Workshop:
    """A folder with `tree`, the checkout, and `env`, which has it installed and all else from this environment."""

    def __init__(self, folder: Path, checkout: Path) -> None:
        self.folder = folder
        self.tree = folder / "tree"
        self.python = folder / "env" / "bin" / "python"
        self.scratch = folder / "tmp"
        if not self.python.exists():
            self._make_environment()
        self._copy(checkout)

    def _copy(self, checkout: Path) -> None:
        """Have in `tree` exactly the files that git knows of, as they are now."""
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=checkout, check=True, capture_output=True, text=True,
        ).stdout.split("\0")  # fmt: skip
        wanted = {name for name in listed if name and (checkout / name).is_file()}
        for path in [path for path in self.tree.rglob("*") if path.is_file()]:
            if path.relative_to(self.tree).as_posix() not in wanted:
                path.unlink()
        for name in sorted(wanted):
            source, target = checkout / name, self.tree / name
            if not target.exists() or target.read_bytes() != source.read_bytes():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(source, target)
        shutil.rmtree(self.scratch, ignore_errors=True)
        self.scratch.mkdir(parents=True)

    def _make_environment(self) -> None:
        env = self.python.parent.parent
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(env)], check=True)
        ours = Path(sys.executable).parent
        (packages,) = env.glob("lib/python*/site-packages")
        (installed,) = ours.parent.glob("lib/python*/site-packages")
        # Files `.pth` in a folder that a `.pth` names are not read, so the checkout itself is not found there.
        (packages / "mutants.pth").write_text(f"{self.tree}\n{installed}\n{_BEGIN_COVERAGE}")
        for script in ours.iterdir():
            target = self.python.parent / script.name
            if script.is_file() and not target.exists():
                head, newline, rest = script.read_bytes().partition(b"\n")
                if head.startswith(b"#!") and str(ours).encode() in head:
                    target.write_bytes(f"#!{self.python}".encode() + newline + rest)
                    target.chmod(0o755)
