"""Figures in README and docs: each comes from a file in `benchmarks/results/`, and nobody types one in.

A table or a single figure stands between two comments::

    <!-- figures: rq1 -->
    (the table of rq1.json)
    <!-- end of figures -->

`python -m benchmarks.pages` writes them anew; a test compares. What has not been measured yet says so.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.chaos import chaos_table
from benchmarks.check import ages_table
from benchmarks.clicks import clicks_table
from benchmarks.cold import cold_table
from benchmarks.common import ROOT, median
from benchmarks.crash import crash_table
from benchmarks.damaged import damaged_table
from benchmarks.doors import doors_table, tiny_table
from benchmarks.first_contact import first_contact_table
from benchmarks.floor import floor_table
from benchmarks.incremental import incremental_table
from benchmarks.kernels import kernels_table
from benchmarks.launch import DEFAULT, SHIPPED, launch_table
from benchmarks.lerobot import lerobot_table
from benchmarks.patches import patches_table
from benchmarks.peers import peers_table
from benchmarks.plan import plan_table
from benchmarks.reader import reader_table
from benchmarks.reads import reads_table
from benchmarks.rq1 import rq1_table
from benchmarks.rq2 import rq2_table
from benchmarks.rq3 import rq3_table
from benchmarks.scale import scale_table, unbuilt_table
from benchmarks.slurm import scaling_table, slurm_table
from benchmarks.small import small_table
from benchmarks.soak import soak_table
from benchmarks.windows import report_opened
from scripts.call_path import call_path_table
from scripts.code_size import code_size_table

__all__ = ["FIGURES", "MARK", "NOT_YET", "RESULTS", "pages", "with_figures"]

RESULTS = Path(__file__).parent / "results"
MARK = re.compile(r"(<!-- figures: ([a-z0-9 ]+) -->)(.*?)(<!-- end of figures -->)", re.DOTALL)
NOT_YET = "not measured yet"


def _step(launcher: str) -> Callable[[Any], str]:
    return lambda found: f"{median(found['seconds'][launcher]['click to the first step']):.2f} s"


def _plotted(tell: Callable[[Any], str], name: str, title: str) -> Callable[[Any], str]:
    return lambda found: f"{tell(found)}\n![{title}](../benchmarks/results/{name}.png)\n"


FIGURES: dict[str, tuple[str, Callable[[Any], str]]] = {
    "ages": ("measured", ages_table),
    "call path": ("call_path", call_path_table),
    "chaos": ("chaos", chaos_table),
    "clicks": ("clicks", clicks_table),
    "code size": ("code_size", code_size_table),
    "cold": ("cold", cold_table),
    "crash": ("crash", crash_table),
    "damaged": ("damaged", damaged_table),
    "doors": ("doors", doors_table),
    "doors tiny": ("doors", tiny_table),
    "first contact": ("first_contact", first_contact_table),
    "floor": ("floor", floor_table),
    "incremental": ("incremental", incremental_table),
    "kernels": ("kernels", kernels_table),
    "launch": ("launch", launch_table),
    "launch default": ("launch", _step(DEFAULT)),
    "launch shipped": ("launch", _step(SHIPPED)),
    "lerobot": ("lerobot", lerobot_table),
    "patches": ("patches", patches_table),
    "peers": ("peers", peers_table),
    "plan": ("plan", plan_table),
    "reader": ("reader", reader_table),
    "reads": ("reads", reads_table),
    "rq1": ("rq1", _plotted(rq1_table, "rq1", "run times, logarithmic")),
    "rq2": ("rq2", _plotted(rq2_table, "rq2", "run time over size")),
    "rq3": ("rq3", _plotted(rq3_table, "rq3", "times by number of files")),
    "scale": ("scale", scale_table),
    "unbuilt": ("scale", unbuilt_table),
    "scale postgres": ("scale_postgres", scale_table),
    "small": ("small", small_table),
    "small daily": ("small", lambda found: f"{1e4 * median(found['each']['record_bytes']) / 1e9:.1f} GB"),
    "small records": ("small", lambda found: f"{median(found['each']['record_bytes']) / 1e6:.2f} MB"),
    "slurm": ("slurm", slurm_table),
    "slurm model": ("slurm", scaling_table),
    "soak": ("soak", soak_table),
    "windows report": ("windows", report_opened),
}
"""Name in a page -> the file that has its figures (without `.json`), and how they are worded."""


def pages() -> list[Path]:
    """Return all pages that may have figures."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def with_figures(text: str, results: Path = RESULTS) -> str:
    """Return a page with all its figures written anew.

    Raises:
        KeyError: it asks for figures that there are not.
    """

    def filled(match: re.Match[str]) -> str:
        start, name, _, end = match.groups()
        file, tell = FIGURES[name]
        path = results / f"{file}.json"
        words = tell(json.loads(path.read_text("utf-8"))) if path.exists() else NOT_YET
        # A table is a paragraph of its own.
        return f"{start}\n\n{words}\n{end}" if "\n" in words else f"{start}{words}{end}"

    return MARK.sub(filled, text)


def main() -> None:
    for page in pages():
        before = page.read_text("utf-8")
        after = with_figures(before)
        if after != before:
            page.write_text(after, "utf-8")
            print(f"{page.relative_to(ROOT)}: figures written anew")


if __name__ == "__main__":
    main()
