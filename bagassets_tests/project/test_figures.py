"""Figures in README and docs are those of `benchmarks/results/`: none is typed in, and none is out of date."""

import json
import re
from itertools import pairwise

import pytest

from benchmarks.pages import FIGURES, MARK, NOT_YET, RESULTS, pages, with_figures

pytestmark = pytest.mark.once

# Seconds, shares of processors, rates: what a script has to have measured.
MEASURED = re.compile(
    r"[0-9][0-9.,]*\s?(?:s|ms|µs|min|CPU-s|s/GB|[MG]B/s|(?:milli|micro|CPU-|processor )?seconds?|minutes?)\b"
    r"(?!/)|[0-9.]+ times (?:faster|slower|more|less)"
)
# What such a number says without having been measured by a benchmark: settings, limits, examples, and how a test was done.
NOT_MEASURED = {
    "annotations.md": ["within 1 s (`window_s`)", "least 0.5 s"],
    "checks.md": [
        "offsets are found to within 5 ms on a drive with known ground truth",
        "more than `max_gap_s` (1 s)",
        "more than `max_backward_s` (1 s)",
    ],
    "devkit.md": ["more than 1.5 s apart"],
    "install.md": ["recordings of 5 s"],
    "launchers.md": ["`K8sRunLauncher` of `dagster-k8s`"],
    "lerobot.md": [
        "more than `trim_s` (1 s)",
        "one of 1,024 s or more is left out: readers compare times in a file as float32 to 0.1 ms",
    ],
    "operations.md": ["takes the run within 5 minutes"],
    "performance.md": ["scenes of 20 s"],
    "poses.md": ["a pause of more than 20 s"],
    "scenes.md": [
        "with a camera of 1 Hz, 20 s have 20 keyframes",
        "each begins at most 1 s before the one before it ends, and at most 2 s after that",
        "begun within 2 s of the end of the first",
    ],
    "tests.md": [
        "tell 3.6 s after the header stamp, and of three others 1.1 s",
        "tests of 4 seconds",
        "with 15 seconds",
        "the 15 seconds",
        "1.7 s off",
        "ahead by 0.1 s",
        "camera stops after 2 s",
        "after 2 s, `joint_7`",
        "begin after 1 s",
    ],
    "ui.md": ["looks every 30 seconds, that of `bagassets ui` every 2 seconds"],
}
# Measured by a script of its own, and compared with its page by a test of its own.
SHOWN_ELSEWHERE = {"newest_lerobot", "install_size", "project_size"}


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_pages_show_what_was_measured(page):
    text = page.read_text("utf-8")
    assert with_figures(text) == text, f"{page.name}: make docs"


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_no_other_figure_is_typed_in(page):
    assert typed_in(page.read_text("utf-8"), NOT_MEASURED.get(page.name, [])) == []


def typed_in(text, known):
    """The lines with a measured number outside the marks; code blocks show what commands print."""
    text = re.sub(r"^```.*?^```", "", MARK.sub("", text), flags=re.DOTALL | re.MULTILINE)
    for sentence in known:
        text, found = re.subn(r"\s+".join(map(re.escape, sentence.split())), "", text)
        assert found, f"no longer there: {sentence}"
    return [line for line in text.splitlines() if MEASURED.search(line)]


def test_typing_one_in_is_noticed():
    assert typed_in("It takes 3 s.\nBy 2 people.", []) == ["It takes 3 s."]
    assert typed_in("It takes <!-- figures: rq1 -->3 s<!-- end of figures -->.", []) == []
    for text in ("1.5 CPU-s", "143 MB/s", "0.06 seconds", "3.7 times faster", "12 minutes", "4 ms each"):
        assert typed_in(text, []) == [text]


def test_all_that_is_measured_is_shown():
    named = {name for page in pages() for _, name, _, _ in MARK.findall(page.read_text("utf-8"))}
    assert named == FIGURES.keys()
    files = {path.stem for path in RESULTS.glob("*.json")}
    assert files - SHOWN_ELSEWHERE <= {file for file, _ in FIGURES.values()}


def test_marks_are_not_broken():
    for page in pages():
        marks = re.findall(r"<!-- (figures: [a-z0-9 ]+|end of figures) -->", page.read_text("utf-8"))
        assert len(marks) % 2 == 0
        assert all((a == "end of figures") != (b == "end of figures") for a, b in pairwise(marks)), page.name


def test_figures_follow_their_file(tmp_path):
    page = "It takes <!-- figures: launch shipped -->9 s<!-- end of figures -->, or <!-- figures: plan --><!-- end of figures -->."
    assert with_figures(page, tmp_path).count(NOT_YET) == 2
    seconds = {"as shipped": {"click to the first step": [0.5, 0.25, 9.0]}}
    (tmp_path / "launch.json").write_text(json.dumps({"seconds": seconds}))
    shown = with_figures(page, tmp_path)
    assert shown.startswith("It takes <!-- figures: launch shipped -->0.50 s<!-- end of figures -->")
    assert with_figures(shown, tmp_path) == shown
    with pytest.raises(KeyError):
        with_figures("<!-- figures: no such -->1 s<!-- end of figures -->", tmp_path)


def test_tables_printed_with_results_are_those_of_the_pages():
    for file, tell in FIGURES.values():
        printed = RESULTS / f"{file}.md"
        if printed.exists() and "\n" in (
            output := tell(json.loads((RESULTS / f"{file}.json").read_text("utf-8")))
        ):
            assert output.startswith(printed.read_text("utf-8")), file
