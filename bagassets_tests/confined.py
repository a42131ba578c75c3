"""Steps that run where nothing exists but what their actions name.

All other files are moved away while a step runs, so that nobody can open them: neither Python, nor pyarrow
and OpenCV, whose own code opens files. A step that reads more either fails or, where it can do without,
makes other bytes.
"""

import sys
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from bagassets.engine import execute
from bagassets.engine.run_action import run_action
from bagassets.store.store import Store


@contextmanager
def confined(inventory: str, recording: Path, others: Iterable[Path]) -> Iterator[None]:
    """Confine every action that is executed in this block.

    Args:
        inventory: digest of the recording's inventory, which has the small messages.
        recording: the recording; there for the passes over it only.
        others: files and folders that no step may read.
    """
    make_action, run_pass = run_action, execute.run_pass

    def run_confined(store, action, make, subject=None):
        def make_confined(out):
            with nothing_but(store, {*action.inputs.values(), inventory}, [recording, *others]):
                return make(out)

        return make_action(store, action, make_confined, subject)

    def pass_confined(graph, opened, nodes, *rest):
        declared = {inventory, *(digest for node in nodes for digest in node.action.inputs.values())}
        with nothing_but(graph.store, declared, others):
            return run_pass(graph, opened, nodes, *rest)

    with pytest.MonkeyPatch.context() as patch:
        for module in [*sys.modules.values()]:
            if getattr(module, "run_action", None) is make_action:
                patch.setattr(module, "run_action", run_confined)
        patch.setattr(execute, "run_pass", pass_confined)
        yield


@contextmanager
def nothing_but(store: Store, declared: Collection[str], others: Iterable[Path]) -> Iterator[None]:
    """Take away the artifacts that are not declared, and other files; put them back in the end."""
    artifacts = [folder for folder in store.root.glob("artifacts/*/*") if folder.name not in declared]
    there = [path for path in others if path.exists()]  # not so if one step runs another
    with ExitStack() as taken:
        for path in (*artifacts, *there):
            taken.callback(_put_back, path.rename(path.with_name(f"{path.name}.away")), path)
        yield


def _put_back(away: Path, path: Path) -> None:
    if not path.exists():  # an artifact may have been made again, byte for byte
        away.rename(path)
