"""Projects that are built in this process: the driver's runs without its server."""

import os
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

from bagassets.defs import driver
from bagassets.defs import situation as situations
from bagassets.engine.build_report import BuildOptions
from bagassets.recipe import load_recipe
from bagassets.recipe.project import write_project
from bagassets_tests.small_drive import RECIPE, write_drive


class InProcessClient:
    """Does jobs when they are submitted."""

    def __init__(self, folder):
        self.places = SimpleNamespace(folder=folder)
        self.submitted = []
        self.events = []

    def submit(self, function, args, *, label, on_lost=None):
        self.submitted.append((args["partition_key"], tuple(args["assets"])))
        self._load_definitions()
        module, name = function.split(":")
        job = f"job-{len(self.submitted)}"
        result = getattr(import_module(module), name)(args)
        self.events.append({"event": "finished", "job": job, "exit": 0, "result": result})
        return job

    @staticmethod
    def _load_definitions():
        """The definitions read the recipe when they are imported; a new worker would import them."""
        recipe = Path(os.environ["BAGASSETS_RECIPE"])
        loaded = sys.modules.get("bagassets.definitions")
        if getattr(loaded, "read_from", None) != (recipe, recipe.read_text()):
            sys.modules.pop("bagassets.definitions", None)
            import_module("bagassets.definitions").read_from = (recipe, recipe.read_text())

    def wait(self, _timeout_s=None):
        return self.events.pop(0)

    def cancel(self, job, *, grace_s):
        return True

    def close(self):
        pass


# Without pictures, which take longer than all the rest.
QUICK = RECIPE + "preview: {{enabled: false}}\n"


def make_project(folder, drives=("a.bag",), *, text=QUICK, duration_s=1.0):
    """Write recordings and a project; return its recipe file."""
    for name in drives:
        kind = {".bag": "ros1", ".mcap": "mcap"}.get(Path(name).suffix, "ros2")
        write_drive(folder / "bags" / name, kind, duration_s=duration_s)
    write_project(folder, text.format(name="test", root="bags"))
    return folder / "recipe.yaml"


def build(recipe_file, monkeypatch, **options):
    """Build; return the report and the runs there were: (partition key, assets)."""
    client = InProcessClient(load_recipe(recipe_file).state / "locks")
    monkeypatch.setattr(driver, "connect", lambda _spec, _home: client)
    monkeypatch.setenv("BAGASSETS_RECIPE", str(recipe_file))
    report = driver.build(recipe_file, BuildOptions(**options), lambda _event: None)
    return report, client.submitted


def survey(recipe_file, **options):
    """Return the state of everything."""
    with situations.opened(recipe_file) as (instance, workspace):
        return situations.survey(instance, workspace, BuildOptions(**options))


def states(situation, key):
    """Return asset -> state of one recording."""
    return {name: asset.state for name, asset in situation.plan.bags[key].assets.items()}
