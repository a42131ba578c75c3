"""Write what docs/how-it-decides.md shows of the assets: their graph, and the table of what each reads, its parameters and libraries.

    python scripts/input_table.py

`bagassets_tests/test_asset_reference.py` compares the page with it.
"""

from itertools import groupby
from pathlib import Path

from bagassets.assets.asset import AnyAsset
from bagassets.cli.docs import parameters_of, reads_of
from bagassets.formats.catalogue import formats, known_assets
from bagassets.recipe.model import Recipe

PAGE = Path(__file__).parents[1] / "docs" / "how-it-decides.md"
MARKS = {name: (f"<!-- {name} -->\n", f"\n<!-- end of {name} -->") for name in ("graph", "inputs")}


def input_table() -> str:
    """Return the table."""
    rows = [
        (f"`{asset.name}`", reads_of(asset), parameters_of(asset), ", ".join(asset.libraries))
        for asset in known_assets()
    ]
    lines = ["| asset | reads | parameters | libraries |", "|---|---|---|---|"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def graph() -> str:
    """Return the graph of the assets, without edges that others imply; those that not every recipe has are dashed."""
    camera = {"modality": "camera", "topic": "/image"}
    rig = {"name": "small", "ego_pose": {"source": "fixed"}, "channels": {"CAM_FRONT": camera}}
    recipe = Recipe.model_validate({"name": "small", "bags": {"root": "."}, "rigs": [rig]})
    edges = []
    for asset in known_assets():
        always = asset.reads
        if asset.waits_for is not None:
            needed = asset.needs(asset.params(recipe, recipe.rigs[0]), None)
            always = tuple(one for one in asset.reads if one.name in needed)
            edges += [
                (one.name, "-. if the recipe asks for it .->", asset.name)
                for one in asset.reads
                if one not in always
            ]
        sources = " & ".join(_direct(always)) or "bag([bag])"
        edges.append((sources, "-->", asset.name))
    lines = [
        f"  {sources} {arrow} {' & '.join(target for _, _, target in same)}"
        for (sources, arrow), same in groupby(sorted(edges, key=edges.index), key=lambda edge: edge[:2])
    ]
    parts = " & ".join(kind.part for kind in formats())
    datasets = " & ".join(kind.asset for kind in formats())
    lines += [f"  {parts} --> dataset_inputs([dataset_inputs])", f"  dataset_inputs --> {datasets}"]
    return "\n".join(["```mermaid", "flowchart LR", *lines, "  ego_poses --> trajectory_map", "```"])


def _direct(reads: tuple[AnyAsset, ...]) -> list[str]:
    """Return those of the assets that none of the others reads."""
    implied = {name for one in reads for name in _upstream(one)}
    return [one.name for one in reads if one.name not in implied]


def _upstream(asset: AnyAsset) -> set[str]:
    """Return what an asset always reads, directly or not."""
    if asset.waits_for is not None:
        return set()
    return {name for one in asset.reads for name in (one.name, *_upstream(one))}


def page() -> str:
    """Return the page with both in their places."""
    text = PAGE.read_text("utf-8")
    for name, content in (("graph", graph()), ("inputs", input_table())):
        begin, end = MARKS[name]
        before, _, rest = text.partition(begin)
        text = before + begin + content + end + rest.partition(end)[2]
    return text


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
