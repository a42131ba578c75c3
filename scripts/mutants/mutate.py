"""The mutants of a source file: mutmut's operators on its syntax tree, each mutant one small change.

Left out is what no behaviour depends on: annotations, `Literal`, decorators, imports, docstrings, `__all__`, the
wording of errors that are raised, and `strict=` of `zip`, which checks the code itself.
"""

import ast
import difflib
import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import libcst as cst
from libcst.metadata import MetadataWrapper, PositionProvider
from mutmut.mutation.mutators import mutation_operators

from scripts.mutants.choose import line_keys

__all__ = ["PACKAGES", "Mutant", "all_mutants", "render", "sample"]

# Row of the table -> the files that it counts, below the folder `bagassets`.
PACKAGES = {
    "decode": ("decode/**/*.py",),
    "geometry": ("geometry/**/*.py",),
    "timeline": ("timeline/**/*.py",),
    "annotations": ("annotations/**/*.py",),
    "formats": ("formats/**/*.py",),
    "assets": ("assets/**/*.py",),
    "store": ("store/**/*.py",),
    "staleness": (
        "build/plan*.py", "build/code_version.py", "build/graph.py", "build/execute.py", "freshness/*.py",
    ),
}  # fmt: skip


_EMPTY = cst.Module([])


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of one file: a variant of an operator at a node.

    Attributes:
        path: relative to the checkout.
        place: digest of the function, the line, the code and which of equal ones it is: it stays what it is when
            other lines change.
        node: number of the node.
        operator: what changes it.
        variant: which of the changes that the operator makes.
        first_line: of the statement that it is in, of a compound one of its head; from 1.
        last_line: the same, inclusive.
    """

    path: str
    place: str
    node: int
    operator: str
    variant: int
    first_line: int
    last_line: int

    @property
    def name(self) -> str:
        """What tells it from all others."""
        return f"{self.path}:{self.place}:{self.operator}:{self.variant}"

    @property
    def package(self) -> str:
        """The row of the table."""
        inside = Path(self.path).parts[1]
        return "staleness" if inside in {"build", "freshness"} else inside


class _Finder(cst.CSTVisitor):
    """Visits every node once, in order, and knows which ones are left alone."""

    METADATA_DEPENDENCIES = (PositionProvider,)

    def __init__(self) -> None:
        super().__init__()
        self.nodes: list[tuple[cst.CSTNode, tuple[int, int]]] = []
        self._statements: list[tuple[int, int]] = []
        self._raising = 0

    def on_visit(self, node: cst.CSTNode) -> bool:
        if isinstance(node, cst.Annotation | cst.Decorator | cst.Import | cst.ImportFrom):
            return False
        if (
            isinstance(node, cst.Subscript)
            and isinstance(node.value, cst.Name)
            and node.value.value == "Literal"
        ):
            return False
        if isinstance(node, cst.Expr) and isinstance(node.value, cst.SimpleString | cst.ConcatenatedString):
            return False
        if isinstance(node, cst.Assign) and isinstance(node.targets[0].target, cst.Name):
            name = node.targets[0].target.value
            if name == "__all__":
                return False
        if isinstance(node, cst.SimpleStatementLine | cst.BaseCompoundStatement | cst.MatchCase):
            self._statements.append(self._lines(node))
        self._raising += isinstance(node, cst.Raise)
        if not (self._raising and isinstance(node, cst.BaseString)) and self._statements:
            self.nodes.append((node, self._statements[-1]))
        return True

    def on_leave(self, original_node: cst.CSTNode) -> None:
        if isinstance(original_node, cst.SimpleStatementLine | cst.BaseCompoundStatement | cst.MatchCase):
            self._statements.pop()
        self._raising -= isinstance(original_node, cst.Raise)

    def _lines(self, node: cst.CSTNode) -> tuple[int, int]:
        span = self.get_metadata(PositionProvider, node)
        body = getattr(node, "body", None)
        if isinstance(node, cst.SimpleStatementLine) or not isinstance(body, cst.BaseSuite):
            return span.start.line, span.end.line
        return span.start.line, max(span.start.line, self.get_metadata(PositionProvider, body).start.line - 1)


@cache
def _parsed(source: str) -> tuple[cst.Module, list[tuple[cst.CSTNode, tuple[int, int]]]]:
    wrapper = MetadataWrapper(cst.parse_module(source))
    finder = _Finder()
    wrapper.visit(finder)
    return wrapper.module, finder.nodes


def _variants(node: cst.CSTNode) -> Iterator[tuple[str, int, cst.CSTNode]]:
    for kind, operator in mutation_operators:
        if isinstance(node, kind):
            for number, changed in enumerate(operator(node)):
                if not _only_strict(node, changed):
                    yield operator.__name__, number, changed


def _only_strict(node: cst.CSTNode, changed: cst.CSTNode) -> bool:
    """Tell whether two calls differ in `strict=` alone."""

    def others(call: cst.Call) -> list[str]:
        return [
            _EMPTY.code_for_node(arg.value)
            for arg in call.args
            if arg.keyword is None or arg.keyword.value != "strict"
        ]

    if not (isinstance(node, cst.Call) and isinstance(changed, cst.Call)):
        return False
    return len(others(node)) < len(node.args) and others(node) == others(changed)


def _in_strict(nodes: list[tuple[cst.CSTNode, tuple[int, int]]]) -> set[int]:
    """Return the `True` and `False` of `strict=`, by identity."""
    return {
        id(node.value)
        for node, _ in nodes
        if isinstance(node, cst.Arg) and node.keyword is not None and node.keyword.value == "strict"
    }


def mutants_of(path: str, source: str) -> Iterator[Mutant]:
    """Yield all mutants of a file; `path` is relative to the checkout."""
    _, nodes = _parsed(source)
    strict, keys, seen = _in_strict(nodes), line_keys(source), Counter[str]()
    for index, (node, (first, last)) in enumerate(nodes):
        found = [] if id(node) in strict else [(operator, number) for operator, number, _ in _variants(node)]
        if found:
            where = f"{path}|{keys[first - 1]}|{type(node).__name__}|{_EMPTY.code_for_node(node)}"
            seen[where] += 1
            place = hashlib.sha256(f"{where}|{seen[where]}".encode()).hexdigest()[:12]
            for operator, number in found:
                yield Mutant(path, place, index, operator, number, first, last)


def all_mutants(root: Path) -> list[Mutant]:
    """Return all mutants of the packages, in an order that depends on the sources alone."""
    folder = root / "bagassets"
    files = sorted({path for globs in PACKAGES.values() for glob in globs for path in folder.glob(glob)})
    return [
        mutant
        for path in files
        for mutant in mutants_of(path.relative_to(root).as_posix(), path.read_text("utf-8"))
    ]


def render(mutant: Mutant, source: str) -> str | None:
    """Return the changed source; None if it is no program, or the same one."""
    module, nodes = _parsed(source)
    node = nodes[mutant.node][0]
    changed = next(
        new for name, number, new in _variants(node) if (name, number) == (mutant.operator, mutant.variant)
    )
    text = module.deep_replace(node, changed).code  # type: ignore[attr-defined]
    try:
        same = ast.dump(ast.parse(text)) == ast.dump(ast.parse(source))
        compile(text, mutant.path, "exec")
    except (SyntaxError, ValueError):
        return None
    return None if same else text


def difference(before: str, after: str) -> str:
    """Return the lines that differ, as a diff without its head."""
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    return "\n".join(line for line in list(lines)[2:] if not line.startswith("@@"))


def sample(mutants: list[Mutant], number: int, seed: int, root: Path) -> Iterator[tuple[Mutant, str]]:
    """Yield a random sample with the changed sources: places are drawn without putting back, then one variant each.

    A call of six arguments has twelve variants, a comparison one; both are one place. The order in which places are
    drawn is that of digests of seed and place, so that the sample of changed code has new places only where the
    code is new.
    """
    places: dict[str, list[Mutant]] = {}
    for mutant in mutants:
        places.setdefault(mutant.place, []).append(mutant)
    drawn = 0
    for chance, place in sorted(
        (hashlib.sha256(f"{seed}|{place}".encode()).hexdigest(), place) for place in places
    ):
        if drawn == number:
            return
        mutant = places[place][int(chance[:12], 16) % len(places[place])]
        text = render(mutant, (root / mutant.path).read_text("utf-8"))
        if text is not None:
            drawn += 1
            yield mutant, text
