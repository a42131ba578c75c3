"""Installs packages with decoders, as pip does: from wheels that are made here, without network or build backend."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

from bagassets.base.plugins import announced, installed_decoders, installed_extensions
from bagassets.formats.catalogue import catalogue
from bagassets.store import action


def forget_packages() -> None:
    """Forget what was installed, as a new process would."""
    installed_decoders.cache_clear()
    announced.cache_clear()
    installed_extensions.cache_clear()
    catalogue.cache_clear()
    action._version.cache_clear()


EXAMPLE = Path(__file__).parent.parent / "examples" / "decoder_plugin"


def wheel_of(project: Path, folder: Path, version: str | None = None) -> Path:
    """Make the wheel that a build of `project` would make; `version` instead of its own."""
    about = tomllib.loads((project / "pyproject.toml").read_text())["project"]
    entries = {
        group: "\n".join(f"{name} = {value}" for name, value in points.items())
        for group, points in about["entry-points"].items()
    }
    modules = {path.relative_to(project).as_posix(): path.read_text() for path in project.rglob("*.py")}
    return make_wheel(folder, about["name"], version or about["version"], entries, modules)


def make_wheel(folder, name, version, entries, modules) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    stem = name.replace("-", "_")
    info = f"{stem}-{version}.dist-info"
    path = folder / f"{stem}-{version}-py3-none-any.whl"
    files = {
        **modules,
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": "".join(f"[{group}]\n{text}\n" for group, text in entries.items()),
    }
    files[f"{info}/RECORD"] = "".join(f"{name},,\n" for name in [*files, f"{info}/RECORD"])
    with zipfile.ZipFile(path, "w") as archive:
        for file, text in files.items():
            archive.writestr(file, text)
    return path


def pip_install(wheel: Path, target: Path) -> None:
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*command, "--no-index", "--target", target, wheel], check=True)


class Site:
    """A folder of installed packages that this process searches first."""

    def __init__(self, monkeypatch, folder: Path) -> None:
        self.folder = folder
        self._monkeypatch = monkeypatch
        folder.mkdir(parents=True, exist_ok=True)
        monkeypatch.syspath_prepend(folder)
        self._modules: set[str] = set()
        forget_packages()

    def unpack(self, wheel: Path) -> None:
        """Put a wheel in place as an installer does, instead of other versions of it."""
        stem = wheel.name.split("-")[0]
        for old in self.folder.glob(f"{stem}-*.dist-info/*"):
            old.unlink()
        for old in self.folder.glob(f"{stem}-*.dist-info"):
            old.rmdir()
        # Stale byte code is recognised by the second of its source, which is too coarse here.
        shutil.rmtree(self.folder / "__pycache__", ignore_errors=True)
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(self.folder)
            files = [name.removesuffix(".py") for name in archive.namelist() if name.endswith(".py")]
            self._modules |= {name.removesuffix("/__init__").replace("/", ".") for name in files}

    def install(self, name, version, code, group="bagassets.decoders", **objects) -> None:
        """Install a package of one module `name`; `objects` are entry points -> object."""
        points = "\n".join(f"{point.replace('__', '.')} = {name}:{value}" for point, value in objects.items())
        wheel = make_wheel(
            self.folder.parent / "wheels", name, version, {group: points}, {f"{name}.py": code}
        )
        self.unpack(wheel)
        self.restart()

    def restart(self) -> None:
        """Forget what a new process would not know."""
        for name in self._modules:
            sys.modules.pop(name, None)
        self._monkeypatch.syspath_prepend(self.folder)  # drops the caches of the import system
        forget_packages()

    def close(self) -> None:
        for name in self._modules:
            sys.modules.pop(name, None)
        forget_packages()
