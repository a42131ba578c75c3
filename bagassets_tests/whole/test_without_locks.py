"""Recordings, store and datasets on a file system without locks or without hard links; the state is on a local disk.

Functions of the system fail as they do there, in each process of a build: Python imports `sitecustomize` first.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bagassets.forkserver.client import Client
from bagassets.recipe import load_recipe
from bagassets.store.store import Store
from bagassets_tests.defs.launchers.test_slurm_build import content
from bagassets_tests.in_process import QUICK
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.long

EARLY = """
import errno, fcntl, os

SHARED, TOLD = {shared!r}, {told!r}


def refuse(what, code):
    with open(TOLD, "a") as file:
        file.write(f"{{what}} {{os.getpid()}}\\n")
    raise OSError(code, os.strerror(code))


def wrap(original, name, code, paths):
    def called(*arguments, **options):
        if any(path.startswith(SHARED) for path in paths(*arguments)):
            refuse(name, code)
        return original(*arguments, **options)

    return called


def of_file(descriptor, *_):
    number = descriptor if isinstance(descriptor, int) else descriptor.fileno()
    return [os.readlink(f"/proc/self/fd/{{number}}")]


LACKS = {lacks!r}
if "locks" in LACKS:
    fcntl.flock = wrap(fcntl.flock, "locks", errno.{no_lock}, of_file)
if "links" in LACKS:
    os.link = wrap(os.link, "links", errno.{no_link}, lambda *paths: [os.fspath(path) for path in paths[:2]])
"""
KEYS = ("a.bag", "b.mcap", "c.bag")


class Place:
    """A folder that machines share, and projects with a state of their own."""

    def __init__(self, folder):
        self.folder = folder
        self.shared = folder / "shared"
        self.told = folder / "told"
        self.environment = dict(os.environ)
        for key in KEYS:
            kind = {".bag": "ros1", ".mcap": "mcap"}[Path(key).suffix]
            write_drive(self.shared / "bags" / key, kind, duration_s=1.0)

    def lacks(self, *what, no_lock="ENOLCK", no_link="EPERM"):
        early = self.folder / "early"
        early.mkdir()
        text = EARLY.format(
            shared=str(self.shared), told=str(self.told), lacks=what, no_lock=no_lock, no_link=no_link
        )
        (early / "sitecustomize.py").write_text(text)
        self.environment["PYTHONPATH"] = str(early)

    def project(self, name, *, own_dataset=True):
        folder = self.folder / name
        folder.mkdir()
        dataset = self.shared / (f"dataset-{name}" if own_dataset else "dataset")
        text = QUICK.format(name="test", root=self.shared / "bags")
        text = text.replace("nuscenes: {", f"nuscenes: {{output: {dataset}, ")
        (folder / "recipe.yaml").write_text(f"{text}store: {self.shared / 'store'}\n")
        return folder / "recipe.yaml"

    def start(self, recipe_file, command="build", *options):
        return subprocess.Popen(
            [sys.executable, "-m", "bagassets", command, "--recipe", str(recipe_file), *options],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=self.environment,
        )  # fmt: skip

    def run(self, *arguments):
        return self.finish(self.start(*arguments))

    def finish(self, process):
        out, err = process.communicate(timeout=200)
        assert process.returncode == 0, out + err
        assert "Traceback" not in err
        return out, err

    def refused(self):
        """What was refused -> how many processes met that."""
        lines = {tuple(line.split()) for line in self.told.read_text().splitlines()}
        return {what: len([pid for found, pid in lines if found == what]) for what, _ in lines}


@pytest.fixture
def place(tmp_path):
    made = Place(tmp_path)
    yield made
    for recipe_file in tmp_path.glob("*/recipe.yaml"):
        for client in Client.all_of(load_recipe(recipe_file).state):
            client.shutdown(grace_s=1.0)


def made_elsewhere(place, tmp_path):
    """The dataset that a machine with a usual file system makes of these recordings."""
    other = Place(tmp_path / "usual")
    shutil.rmtree(other.shared / "bags")
    shutil.copytree(place.shared / "bags", other.shared / "bags")
    recipe_file = other.project("p")
    other.run(recipe_file)
    for client in Client.all_of(load_recipe(recipe_file).state):
        client.shutdown(grace_s=1.0)
    return content(other.shared / "dataset-p")


@pytest.mark.parametrize(
    ("lacks", "codes"),
    [
        (("locks",), {"no_lock": "ENOLCK"}),
        (("links",), {"no_link": "EPERM"}),
        (("locks", "links"), {"no_lock": "EOPNOTSUPP", "no_link": "EOPNOTSUPP"}),
    ],
)
def test_a_project_is_built_changed_and_verified(place, tmp_path, lacks, codes):
    place.lacks(*lacks, **codes)
    project = place.project("p")
    out, err = place.run(project)
    assert "3 built" in out
    assert "warning" not in err.lower()
    assert set(place.refused()) == set(lacks)
    assert min(place.refused().values()) > 1, "its workers met that, too"
    place.run(project, "verify")
    assert "nothing to do" in place.run(project)[0]
    (place.shared / "bags" / "b.mcap").unlink()
    write_drive(place.shared / "bags" / "b.mcap", "mcap", duration_s=1.4)
    (place.shared / "bags" / "c.bag").unlink()
    out, _ = place.run(project)
    assert "1 built" in out
    place.run(project, "verify")
    assert not [path for path in place.shared.rglob(".*") if path.is_file() and ".lock" not in path.name]
    found = content(place.shared / "dataset-p")
    assert without_guard(found) == without_guard(made_elsewhere(place, tmp_path))
    place.run(project, "gc")
    place.run(project, "verify")


def without_guard(found):
    return {name: digest for name, digest in found.items() if name != ".bagassets.lock"}


@pytest.mark.parametrize("lacks", [(), ("locks",), ("locks", "links")])
def test_two_machines_that_make_the_same_at_once_agree(place, lacks):
    place.lacks(*lacks)
    projects = [place.project("one"), place.project("two")]
    processes = [place.start(project) for project in projects]
    done = [place.finish(process) for process in processes]
    assert all("3 built" in out or "hit" in out for out, _ in done), done
    one, two = (without_guard(content(place.shared / f"dataset-{name}")) for name in ("one", "two"))
    assert one == two
    assert len(one) > len(KEYS)
    store = Store(load_recipe(projects[0]).store_path)
    records = list((store.root / "actions").glob("*/*.json"))
    assert records
    made = {path.parent for path in store.root.glob("artifacts/*/*/manifest.json")}
    assert len({path.name for path in records}) == len(records) >= len(made)
    for project in projects:
        place.run(project, "verify")
        assert "nothing to do" in place.run(project)[0]
    assert not list((store.root / "tmp").iterdir()), "nothing half-made is left"


def test_a_state_folder_without_locks_is_refused_in_words(place):
    place.lacks("locks")
    project = place.project("p")
    state = place.shared / "state"
    project.write_text(f"{project.read_text()}state: {state}\n")
    process = place.start(project)
    out, err = process.communicate(timeout=100)
    assert process.returncode == 1, out
    assert "Traceback" not in err
    assert (
        "files cannot be locked there (No locks available); set `state` in the recipe to a folder on a local disk"
        in err
    )
