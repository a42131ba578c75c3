"""What many recordings have in common is told once, and nothing that differs is hidden behind it."""

import io
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from bagassets.assets.quality.finding import Finding
from bagassets.base.alike import told_once
from bagassets.cli import check, status
from bagassets.cli.dry_run import dry_run_lines
from bagassets.cli.summary import print_remarks, print_summary
from bagassets.engine.build_report import BuildReport, Remark, SummaryRow
from bagassets.engine.plan import AssetState, BagPlan, Plan
from bagassets.formats.checking import Verdict
from bagassets.report.model import Problem, RecordingFacts, ReportData
from bagassets.report.page import report_page

pytestmark = pytest.mark.once

WARN = ("warn", "scenes_made")


def short(name, length_s, kind=WARN):
    return kind, name, f"its {length_s:g} s are shorter than scenes.min_length_s (1); set that to 0"


def told(found):
    return [(one.title, one.text) for one in told_once(found)]


def test_equal_findings_are_one_with_the_first_few_named():
    found = [short(f"{number:03}.bag", 0.5) for number in range(300)]
    assert told(found) == [
        ("300 recordings (000.bag, 001.bag, 002.bag and 297 more)", found[0][2].replace("its ", "their ", 1)),
    ]
    assert told_once(found)[0].names == tuple(f"{number:03}.bag" for number in range(300))


def test_one_that_differs_is_told_beside_299_that_do_not():
    found = [short(f"{number:03}.bag", 0.5) for number in range(299)]
    other = (WARN, "other.bag", "the readings of LIDAR_TOP have no ego pose")
    assert told([*found[:100], other, *found[100:]]) == [
        ("299 recordings (000.bag, 001.bag, 002.bag and 296 more)", found[0][2].replace("its ", "their ", 1)),
        ("other.bag", other[2]),
    ]


def test_numbers_that_differ_become_their_range():
    lengths_s = (0.84, 0.5, 0.31, 0.7, 10)
    found = [short(f"{number}.bag", length_s) for number, length_s in enumerate(lengths_s)]
    assert told(found[:4]) == [
        (
            "4 recordings (0.bag, 1.bag, 2.bag and 1 more)",
            "their 0.31 to 0.84 s are shorter than scenes.min_length_s (1); set that to 0",
        )
    ]
    assert told(found)[0][1].startswith("their 0.31 to 10 s are")  # as numbers, not as texts


def test_what_is_said_of_each_of_several_is_not_said_of_one():
    found = [(WARN, f"{number}.bag", f"it has no scene: its {number}.5 s are too few") for number in range(4)]
    assert told(found)[0][1] == "each has no scene: its 0.5 to 3.5 s are too few"
    assert told(found[:3])[0] == ("0.bag", "it has no scene: its 0.5 s are too few")
    assert told([(WARN, f"{number}", "items, itself") for number in range(4)])[0][1] == "items, itself"


@pytest.mark.parametrize(
    ("form", "values", "text"),
    [
        ("lost ({}%).", (5, 87, 9, 10), "lost (5 to 87%)."),
        ("off by {} m", (-2.5, 1, 0, 3), "off by -2.5 to 3 m"),
        (
            "at 2023-11-14T22:13:{}.110Z,",
            (21, 20, 23, 22),
            "at 2023-11-14T22:13:20.110Z to 2023-11-14T22:13:23.110Z,",
        ),
    ],
)
def test_brackets_units_and_times_stay_around_a_range(form, values, text):
    found = [(WARN, f"{number}.bag", form.format(value)) for number, value in enumerate(values)]
    assert [one.text for one in told_once(found)] == [text]


def test_channels_topics_and_words_that_differ_are_told_apart():
    for texts in (
        [f"CAM_{number}: topic /cam is not in the recording" for number in range(4)],
        [f"/cam{number}: 50 Hz, at least 60 Hz expected" for number in range(4)],
        [f"{word} was lost" for word in ("one", "another", "a third", "nothing")],
    ):
        found = [(WARN, f"{number}.bag", text) for number, text in enumerate(texts)]
        assert [one.text for one in told_once(found)] == texts


def test_checks_and_severities_are_told_apart():
    found = [short(f"{number}.bag", 0.5, ("warn", "a" if number % 2 else "b")) for number in range(8)]
    assert [(one.kind, len(one.names)) for one in told_once(found)] == [
        (("warn", "b"), 4),
        (("warn", "a"), 4),
    ]


def test_few_are_told_one_by_one_as_they_are():
    found = [short(f"{number}.bag", 0.5 + number / 10) for number in range(3)]
    assert told(found) == [(name, text) for _, name, text in found]
    assert told([]) == []


def test_a_name_that_is_part_of_other_words_does_not_change_them():
    found = [(WARN, name, f"/bags/{name}/x.db3: a camera is cold") for name in "abcd"]
    assert [one.text for one in told_once(found)] == ["/bags/…/x.db3: a camera is cold"]

    found = [short(f"{number}", number + 0.5) for number in range(4)]
    assert told(found)[0][1].startswith("their 0.5 to 3.5 s are")


def test_the_name_of_each_recording_in_its_sentence_makes_no_difference():
    names = ("monday.bag", "tuesday.bag", "a/b.bag", "x.bag")
    found = [(("failed",), name, f"/bags/{name}: no messages on /odom\n{name}: none") for name in names]
    [one] = told_once(found)
    assert one.names == names
    assert one.text == "/bags/…: no messages on /odom\n…: none"


# --- wherever rows repeat: 299 that are alike, and one that is not ------------------------------

KEYS = [f"d{number:03}.bag" for number in range(300)]
TITLE = "299 recordings (d000.bag, d001.bag, d002.bag and 296 more)"


def sentence(key):
    return "something else" if key == KEYS[-1] else short(key, 0.5 + KEYS.index(key) / 1000)[2]


TOLD = (TITLE, sentence(KEYS[0]).replace("its 0.5", "their 0.5 to 0.798"))


def printed(show):
    stream = io.StringIO()
    show(Console(file=stream, width=200))
    return stream.getvalue().splitlines()


def test_a_build_tells_findings_once():
    remarks = [Remark(key, "warn", "scenes_made", sentence(key)) for key in KEYS]
    assert printed(lambda console: print_remarks(remarks, console)) == [
        f"warn {TOLD[0]}: {TOLD[1]} (scenes_made)",
        f"warn {KEYS[-1]}: something else (scenes_made)",
    ]
    different = [Remark(key, "warn", "x", f"CAM_{number} is dark") for number, key in enumerate(KEYS)]
    assert printed(lambda console: print_remarks(different, console))[12:] == [
        "288 more; `bagassets check` lists all."
    ]


def test_a_build_tells_failures_once():
    rows = [SummaryRow(key, "ros1", None, {}, "failed", f"/bags/{key}: {sentence(key)}.") for key in KEYS]
    lines = printed(lambda console: print_summary(BuildReport(), rows, Path("/p/recipe.yaml"), console))
    assert [line for line in lines if line.startswith("failed ")] == [
        f"failed {TOLD[0]}: /bags/…: {TOLD[1]}.",
        f"failed {KEYS[-1]}: /bags/{KEYS[-1]}: something else.",
    ]


def test_parts_of_a_drive_that_is_left_out_share_a_line():
    why = "part of d.bag, of which d_1.bag cannot be read for now (it is empty)"
    excluded = {"d.bag": "look again later"} | {f"d_{number}.bag": why for number in range(5)}
    report = BuildReport(excluded=excluded | {"x.bag": "not matched by bags.include"})
    lines = printed(lambda console: print_summary(report, [], Path("/p/recipe.yaml"), console))
    parts = "5 recordings (d_0.bag, d_1.bag, d_2.bag and 2 more)"
    assert lines[:2] == ["left out d.bag: look again later", f"left out {parts}: {why}"]
    assert not [line for line in lines if "not matched" in line]
    pending = SimpleNamespace(plan=Plan({}, report.excluded, ()))
    assert list(status._reasons(pending, {})) == [
        "d.bag: left out: look again later", f"{parts}: left out: {why}",
    ]  # fmt: skip


def test_check_tells_findings_once(capsys):
    problems = {key: [sentence(key), *(f"no. {number}" for number in range(6))] for key in KEYS}
    check._print([Verdict(key, "t", "scenes_made", "warn", Finding(problems[key])) for key in KEYS])
    lines = capsys.readouterr().out.splitlines()
    more = [f"      no. {number}" for number in range(4)] + ["      and 2 more"]
    assert lines == [
        f"warn  {TOLD[0]}: scenes_made", f"      {TOLD[1]}", *more,
        f"warn  {KEYS[-1]}: scenes_made", "      something else", *more,
        "300 checks: 300 warn.",
    ]  # fmt: skip


def test_status_and_dry_run_tell_reasons_once():
    bags = {
        key: BagPlan(key, {"frames": AssetState("stale", sentence(key)), "sweeps": AssetState("fresh", "")})
        for key in KEYS
    }
    pending = SimpleNamespace(plan=Plan(bags, {}, ()), todo=dict.fromkeys(KEYS, ("frames",)), failed={})
    assert list(status._reasons(pending, bags)) == [
        f"{TOLD[0]}: frames stale: {TOLD[1]}",
        f"{KEYS[-1]}: frames stale: something else",
    ]
    own = SimpleNamespace(problem="", targets={}, left_out={})
    lines = "\n".join(dry_run_lines(pending, own)).splitlines()
    assert [" ".join(line.split()) for line in lines] == [
        TOLD[0], f"run frames {TOLD[1]}", KEYS[-1], "run frames something else",
    ]  # fmt: skip


class Cells(HTMLParser):
    """The texts of a page's table cells."""

    def __init__(self, page):
        super().__init__()
        self.rows, self.is_in_cell = [], False
        self.feed(page)

    def handle_starttag(self, tag, _attributes):
        if tag == "tr":
            self.rows.append([])
        elif tag == "td":
            self.is_in_cell = True
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        self.is_in_cell &= tag != "td"

    def handle_data(self, data):
        if self.is_in_cell:
            self.rows[-1][-1] += data


def test_the_report_tells_findings_and_failures_once_and_names_all():
    facts = [
        RecordingFacts(key, "failed", sentence(key), problems=(Problem("rates", "warn", sentence(key), 2),))
        for key in KEYS
    ]
    rows = Cells(report_page(ReportData("name", Path("/d"), facts))).rows
    found = [row for row in rows if row and row[1] in {"rates", "failed"} and len(row) < 5]
    names = TITLE + "".join(KEYS[:-1])
    assert found == [
        [names, "failed", TOLD[1]],
        [KEYS[-1], "failed", "something else"],
        [names, "rates", "warn", f"{TOLD[1]} (and 2 more)"],
        [KEYS[-1], "rates", "warn", "something else (and 2 more)"],
    ]
