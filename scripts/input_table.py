"""Write the table of docs/how-it-decides.md: what each asset reads, its parameters and libraries.

    python scripts/input_table.py

`bagassets_tests/test_asset_reference.py` compares the page with it.
"""

from pathlib import Path

from bagassets.cli.docs import parameters_of, reads_of
from bagassets.formats.catalogue import known_assets

PAGE = Path(__file__).parents[1] / "docs" / "how-it-decides.md"
BEGIN, END = "<!-- inputs -->\n", "\n<!-- end of inputs -->"


def input_table() -> str:
    """Return the table."""
    rows = [
        (f"`{asset.name}`", reads_of(asset), parameters_of(asset), ", ".join(asset.libraries))
        for asset in known_assets()
    ]
    lines = ["| asset | reads | parameters | libraries |", "|---|---|---|---|"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def page() -> str:
    """Return the page with the table in its place."""
    text = PAGE.read_text("utf-8")
    before, _, rest = text.partition(BEGIN)
    return before + BEGIN + input_table() + END + rest.partition(END)[2]


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
