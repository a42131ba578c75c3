"""Write anew what pages and pictures show of the code: `make docs`, after an asset, a format, a check or a field has changed.

These are the references of recipe and assets, the graph and the table of inputs, the tables of checks and decoders, the
picture of the architecture, and figures of `benchmarks/results/`. The prose of all pages is wrapped at one width.
Tests compare each with the code.
"""

from collections.abc import Callable
from pathlib import Path

from bagassets.base.plugins import FAMILIES
from bagassets.cli.docs import asset_reference, parameters_of, reads_of
from bagassets.decode.registry import expected_types
from bagassets.formats.catalogue import formats, known_assets
from bagassets.formats.checking import render_checks
from bagassets.recipe.reference import render_reference
from bagassets_tests.faults import FAULTS, OUTCOMES
from benchmarks.pages import pages, with_figures
from scripts.architecture import PICTURES, THEMES, draw, edges
from scripts.wrap import wrapped

__all__ = ["generated", "graph", "input_table", "write"]

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
# What an asset does not always read: (source, target) -> when it does.
SOMETIMES = {("ego_poses", "sweeps"): "if deskewed or compensated"}


def graph() -> str:
    """Return the graph of assets and datasets, for Mermaid."""
    lines = ["flowchart LR", "  bag([bag]) --> inventory"]
    for asset in known_assets():
        sources = [source for source, target in edges() if target == asset.name]
        always = [source for source in sources if (source, asset.name) not in SOMETIMES]
        lines += [f"  {' & '.join(always)} --> {asset.name}"] if always else []
        lines += [
            f"  {one} -. {SOMETIMES[one, asset.name]} .-> {asset.name}"
            for one in sources
            if one not in always
        ]
    lines += [
        f"  {' & '.join(kind.part for kind in formats())} --> dataset_inputs([dataset_inputs])",
        f"  dataset_inputs --> {' & '.join(f'{kind.name}_dataset' for kind in formats())}",
        "  ego_poses --> trajectory_map",
    ]
    return "\n".join(lines)


# What stands between two comments, `<!-- name -->` and `<!-- end of name -->`.
PARTS: dict[str, Callable[[], str]] = {
    "checks": lambda: f"\n{render_checks()}\n",
    "faults": lambda: f"\n{fault_tables()}\n",
    "decoders": lambda: f"{decoder_table()}\n",
    "graph": lambda: f"\n```mermaid\n{graph()}\n```\n\n",
    "inputs": lambda: f"{input_table()}\n",
}


def input_table() -> str:
    """Return the table of what each asset reads, its parameters and libraries."""
    rows = [
        (f"`{asset.name}`", reads_of(asset), parameters_of(asset), ", ".join(asset.libraries))
        for asset in known_assets()
    ]
    lines = ["| asset | reads | parameters | libraries |", "|---|---|---|---|"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def decoder_table() -> str:
    """Return the types of messages that each family has built-in decoders for."""
    rows = [f"| `{family}` | {expected_types(family)} |" for family in FAMILIES]
    return "\n".join(["| family | types |", "|---|---|", *rows])


def fault_tables() -> str:
    """Return the faults that tests execute, with what becomes of each; one table for each area."""
    lines = [f"- *{name}*: {what};" for name, what in OUTCOMES.items()]
    lines[-1] = lines[-1].replace(";", ".")
    formats = {"ros1": "ROS 1", "ros2": "ROS 2", "mcap": "MCAP"}
    for area in dict.fromkeys(fault.area for fault in FAULTS):
        lines += ["", f"### {area}", "", "| fault | outcome | what is said |", "|---|---|---|"]
        for fault in (one for one in FAULTS if one.area == area):
            some = ", ".join(formats[kind] for kind in fault.kinds)
            only = "" if len(fault.kinds) == len(formats) else f" ({some})"
            lines.append(
                f"| {fault.what}{only} | {fault.outcome} | {f'… {fault.says} …' if fault.says else ''} |"
            )
    return "\n".join(lines)


def others() -> list[Path]:
    """Return the pages that are written by hand throughout; their prose has the same width."""
    names = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "deploy/*.md", "examples/*/README.md")
    return [page for name in names for page in sorted(ROOT.glob(name))]


def generated() -> dict[Path, str]:
    """Return each file that is generated, or has parts that are, with what it should hold."""
    texts = {page: wrapped(page.read_text("utf-8")) for page in [*pages(), *others()]}
    texts[DOCS / "recipe.md"] = render_reference()
    texts[DOCS / "assets.md"] = asset_reference()
    for page, text in texts.items():
        for name, part in PARTS.items():
            before, begin, rest = text.partition(f"<!-- {name} -->\n")
            _, end, after = rest.partition(f"<!-- end of {name} -->")
            text = before + begin + part() + end + after if end else text  # noqa: PLW2901  (part by part)
        texts[page] = with_figures(text)
    return texts | {PICTURES / f"architecture{theme.suffix}.svg": draw(theme) for theme in THEMES}


def write() -> None:
    """Write the files that differ, and say which."""
    for path, text in generated().items():
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, "utf-8")
            print(f"{path.relative_to(ROOT)}: written anew")


if __name__ == "__main__":
    write()
