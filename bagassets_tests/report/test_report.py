"""The report and the map: complete, small, self-contained, the same bytes again."""

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise

import pytest

from bagassets.base.errors import DatasetError
from bagassets.engine.plan import AssetState, BagPlan, Plan
from bagassets.engine.splits import SplitShare, deal, shares_of
from bagassets.engine.track import track_of
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.dataset_build import DatasetInputs
from bagassets.formats.report_data import build_map, map_path, report_data
from bagassets.recipe import load_recipe
from bagassets.recipe.model_splits import Splits
from bagassets.recordings.discover import discover
from bagassets.report.grid_map import colour_of_split, grid_map, legend
from bagassets.report.map_shell import map_shell
from bagassets.report.model import Gaps, Problem, RecordingFacts, ReportData
from bagassets.report.page import report_json, report_page
from bagassets.report.trajectory_map import MapRoute, trajectory_map_page
from bagassets.report.write import write_page
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.store.store import Store
from bagassets_tests.sample_drives import build_recordings

pytestmark = pytest.mark.once

SPLITS = Splits(pinned={"a": "train", "b": "val"})


class Page(HTMLParser):
    """Text, tags and attributes of a page; complains of tags that are not closed."""

    VOID = frozenset({"meta", "img", "input", "br", "link"})

    def __init__(self, page):
        super().__init__()
        self.open, self.words, self.found = [], [], []
        self.feed(page)
        self.close()
        assert self.open == [], "all tags are closed"

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


COUNTED = ("images", "sweeps", "poses", "boxes", "scenes", "keyframes")


def facts(key, **fields):
    plain = {"state": "ready", "format": "mcap", "size": 5_000_000, "start_ns": 1_700_000_000 * 10**9,
             "duration_s": 20.0, "rig": "car", "split": "train", "daylight": "day", "length_m": 160.0,
             "counts": {"images": 200, "sweeps": 100, "poses": 1000, "boxes": 50, "scenes": 1, "keyframes": 40}}  # fmt: skip
    return RecordingFacts(key, **(plain | fields))


def data_of(tmp_path, recordings, excluded=None):
    durations = [(r.key, r.duration_s) for r in recordings if r.state == "ready"]
    shares = shares_of(durations, SPLITS, deal([key for key, _ in durations], SPLITS))
    return ReportData("yard", tmp_path / "nuscenes", recordings, excluded or {}, shares, counted=COUNTED)


class TestPage:
    def test_it_shows_of_every_recording_what_there_is_and_why_not(self, tmp_path):
        recordings = [
            facts(
                "a",
                gaps=[Gaps("/points", 3, 1.25)],
                lost=["CAM: 2 lost, duplicate stamp"],
                notes=["It rained."],
            ),
            facts("b", split="val", duration_s=60.0),
            RecordingFacts("torn", "failed", "torn.bag: it is truncated; copy it again."),
            facts("park", state="skipped", reason="required channel without readable messages: CAM_BACK"),
        ]
        page = Page(
            report_page(data_of(tmp_path, recordings, {"old/x.bag": "excluded by bags.exclude (old/**)"}))
        )
        for words in ("a", "/points: 3 gaps, longest 1.25 s", "CAM: 2 lost, duplicate stamp", "It rained.",
                      "torn.bag: it is truncated; copy it again.", "CAM_BACK", "excluded by bags.exclude (old/**)",
                      "2023-11-14 22:13:20", "val 1 60.0 75.0% 20.0% +55.0%"):  # fmt: skip
            assert words in page.text, words
        rows = [attrs for tag, attrs in page.found if tag == "tr"]
        assert len(rows) == 1 + 2 + 1 + 3 + 1 + 4  # splits, left out, recordings, each with a heading

    def test_numbers_are_said_as_people_say_them(self, tmp_path):
        one = facts("a", length_m=39.6, counts={"images": 1, "boxes": 1, "poses": 2000})
        page = Page(report_page(data_of(tmp_path, [one]))).text
        for words in ("1 recording", "40 m", "1 image", "1 box", "2,000 poses"):
            assert words in page, words
        assert not re.search(r"\b1 (recordings|images|boxes)", page)
        assert "0.0 km" not in page
        far = facts("a", length_m=1_234.0)
        assert "2.5 km" in Page(report_page(data_of(tmp_path, [far, far]))).text

    @pytest.mark.parametrize(
        ("seconds", "said"),
        [(0.4, "0.4 seconds"), (1.0, "1 second"), (12.3, "12 seconds"), (60.0, "1 minute"), (59.9 * 60, "59.9 minutes"),
         (3600.0, "1 hour"), (5.5 * 3600, "5.5 hours")],
    )  # fmt: skip
    def test_time_is_in_a_unit_that_fits(self, tmp_path, seconds, said):
        text = Page(report_page(data_of(tmp_path, [facts("a", duration_s=seconds)]))).text
        assert said in " ".join(text.split())

    def test_a_failed_recording_has_no_time(self, tmp_path):
        page = report_page(data_of(tmp_path, [RecordingFacts("torn", "failed", "it is truncated.")]))
        assert ">0.0<" not in page.partition('id="recordings"')[2]

    def test_what_checks_found_is_listed_errors_first(self, tmp_path):
        evil = "<b>late</b>"
        late = Problem("sweeps_timed", "warn", evil)
        gone = Problem("channels_present", "error", "CAM_BACK has no image.", 2)
        recordings = [
            facts("a", problems=[late], checks_passed=3),
            facts("b", problems=[gone], checks_passed=4),
        ]
        page = Page(report_page(data_of(tmp_path, recordings)))
        assert "7 passed, 2 found something." in page.text
        first = "b channels_present error CAM_BACK has no image. (and 2 more)"
        assert page.text.index(first) < page.text.index(f"a sweeps_timed warn {evil}")
        assert "b" not in [tag for tag, attrs in page.found if tag == "b" and attrs]
        none = Page(report_page(data_of(tmp_path, [facts("a")])))
        assert "Checks" not in none.text

    def test_boxes_are_counted_by_category(self, tmp_path):
        recordings = [facts("a", boxes={"car": 30, "person": 5}), facts("b", boxes={"car": 65})]
        page = Page(report_page(data_of(tmp_path, recordings)))
        assert "car 95 95.0% 2" in page.text
        assert "person 5 5.0% 1" in page.text

    def test_names_cannot_break_out_of_the_page(self, tmp_path):
        evil = '<script>alert("x")</script>'
        recordings = [facts(evil, rig=evil, notes=[evil], gaps=[Gaps(evil, 1, 1.0)], points=[(48.0, 11.0)])]
        recordings.append(RecordingFacts("b", "failed", evil))
        page = Page(report_page(data_of(tmp_path, recordings, {evil: evil})))
        assert [tag for tag, _ in page.found].count("script") == 1
        assert evil in page.text

    def test_it_loads_nothing(self, tmp_path):
        page = report_page(data_of(tmp_path, [facts("a", points=[(48.0, 11.0), (48.1, 11.2)])]))
        sources = [attrs.get("src") or attrs.get("href") for tag, attrs in Page(page).found if tag != "a"]
        assert [source for source in sources if source and not source.startswith("data:")] == []
        assert "http" not in page

    def test_few_recordings_show_all_pictures_and_many_show_a_thumbnail(self, tmp_path):
        for name, size in (("big.jpg", 24_000), ("second.jpg", 24_000), ("thumb.jpg", 2_500)):
            (tmp_path / name).write_bytes(name.encode() * (size // len(name)))
        with_pictures = {"pictures": {"Big": tmp_path / "big.jpg", "Second": tmp_path / "second.jpg"},
                         "thumbnail": tmp_path / "thumb.jpg", "full_pictures": tmp_path}  # fmt: skip

        def images(number):
            recordings = [facts(f"r{n}", **with_pictures) for n in range(number)]
            found = Page(report_page(data_of(tmp_path, recordings))).found
            return [base64.b64decode(a["src"].split(",")[1]) for tag, a in found if tag == "img"]

        assert [picture[:3] for picture in images(1)] == [b"thu", b"big", b"sec"]
        assert images(1)[1] == (tmp_path / "big.jpg").read_bytes()
        assert len(images(80)) == 2 * 80
        assert {picture[:3] for picture in images(800)} == {b"thu"}
        assert images(2000) == []

    def test_without_recordings_there_is_a_page_too(self, tmp_path):
        assert "0 recordings" in Page(report_page(data_of(tmp_path, []))).text

    def test_json_says_the_same(self, tmp_path):
        value = report_json(data_of(tmp_path, [facts("a", gaps=[Gaps("/points", 3, 1.25)])]))
        assert json.loads(json.dumps(value))["recordings"][0]["gaps"] == [
            {"topic": "/points", "number": 3, "longest_s": 1.25}
        ]
        assert value["splits"]["train"]["deviation"] == pytest.approx(0.2)


class TestGridMap:
    def places(self, svg):
        return [(float(x), float(y)) for x, y in re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"', svg)]

    def test_north_is_up_east_is_right_and_metres_are_square(self):
        origin, north, east = (48.0, 11.0), (48.001, 11.0), (48.0, 11.0 + 0.001 / 0.66913)  # cos(48°)
        svg = grid_map(
            [("o", "#000", [origin]), ("n", "#000", [north]), ("e", "#000", [east])], on_earth=True
        )
        (ox, oy), (nx, ny), (ex, ey) = self.places(svg)
        assert (nx, oy) == (ox, ey)
        assert ny < oy
        assert ex > ox
        assert ex - ox == pytest.approx(oy - ny, rel=2e-3)

    def test_the_grid_is_labelled_in_round_metres(self):
        svg = grid_map([("a", "#000", [(0.0, 0.0), (730.0, 90.0)])], on_earth=False)
        assert "grid: 100 m" in svg
        assert len(re.findall(r'class="g"', svg)) >= 8

    def test_long_ways_are_thinned_but_keep_their_end(self):
        way = [(float(x), 0.0) for x in range(50_000)]
        svg = grid_map([("a", "#000", way)], on_earth=False, most_points=1000)
        points = re.search(r'points="([^"]*)"', svg)[1].split()
        assert len(points) <= 1002
        assert float(points[-1].split(",")[0]) == pytest.approx(900 - 34, abs=0.2)

    def names_in(self, svg):
        found = re.findall(r'<text class="name" x="([\d.]+)" y="([\d.]+)"[^>]*>([^<]*)<', svg)
        return {name: (float(x), float(y)) for x, y, name in found}

    def test_every_line_has_its_name_beside_it(self):
        routes = [(f"drive_{n}", "#000", [(0.0, 40.0 * n), (300.0, 40.0 * n)]) for n in range(9)]
        svg = grid_map(routes, on_earth=False)
        names = self.names_in(svg)
        assert names.keys() == {key for key, _, _ in routes}
        starts = dict(zip(names, self.places(svg), strict=True))
        assert all(abs(y - starts[key][1]) <= 16 for key, (_, y) in names.items())

    def test_names_stay_in_the_picture_and_apart(self):
        routes = [
            (f"a_long_name_of_drive_{n:02}", "#000", [(0.0, 1.0 * n), (300.0, 1.0 * n)]) for n in range(40)
        ]
        svg = grid_map(routes, on_earth=False)
        width, height = map(int, re.search(r'viewBox="0 0 (\d+) (\d+)"', svg).groups())
        places = list(self.names_in(svg).values())
        assert 4 < len(places) < 40
        for number, (x, y) in enumerate(places):
            assert 0 <= x <= width - 23 * 6.6
            assert 14 <= y <= height - 20
            assert all(abs(y - b) >= 14 or abs(x - a) >= 23 * 6.6 for a, b in places[:number])
        assert svg.count("<title>") == 40, "the others have theirs when they are pointed at"

    def test_the_legend_has_all_names_by_split(self):
        said = legend(
            [("val", "#111", "c"), ("train", "#222", "<a>"), *[("x", "#333", f"d{n}") for n in range(9)]]
        )
        assert "<a>" not in said
        assert Page(said).text == "■ train (1) <a> ■ val (1) c ■ x (9) " + " ".join(f"d{n}" for n in range(9))
        assert [attrs for tag, attrs in Page(said).found if tag == "details"] == [{"open": None}] * 2 + [{}]

    def test_nothing_to_draw(self):
        assert grid_map([("a", "#000", [])], on_earth=True) == ""
        assert colour_of_split("x", ["train"]) == "#7f7f7f"
        assert colour_of_split("train", ["train", "val"]) != colour_of_split("val", ["train", "val"])


WAYS = [
    MapRoute("monday", "train", "#2f7ed8", "20 s", [(48.0, 11.0), (48.001, 11.001)]),
    MapRoute("<tuesday>", "val", "#d9822b", "30 s", [(48.0, 11.01), (48.002, 11.011)]),
    MapRoute("hall", "val", "#d9822b", "9 s", [], [(0.0, 0.0), (5.0, 5.0)]),
]


@pytest.fixture(scope="module")
def shell():
    return map_shell()


def data_in(page):
    return json.loads(
        re.search(r'<script type="application/json" id="ways">(.*?)</script>', page, re.DOTALL)[1]
    )


class TestTrajectoryMap:
    def test_the_same_ways_give_the_same_bytes(self, shell):
        assert map_shell() == shell
        assert trajectory_map_page(WAYS, shell) == trajectory_map_page(WAYS, shell)

    def test_ways_are_layers_by_split_with_a_heat_layer(self, shell):
        page = trajectory_map_page(WAYS, shell)
        train, val = data_in(page)
        assert (train["name"], val["name"]) == ("train", "val")
        assert train["ways"] == [
            {"key": "monday", "note": "20 s", "points": [[48.0, 11.0], [48.001, 11.001]]}
        ]
        assert [way["key"] for way in val["ways"]] == ["<tuesday>"]
        for part in ("L.heatLayer(", "L.gridLayer(", "L.tileLayer(", "L.control.layers(", ".fitBounds("):
            assert part in page, part
        assert "@@" not in page

    def test_names_cannot_break_out_of_the_data(self, shell):
        evil = '</script><script>alert("x")</script>'
        page = trajectory_map_page([MapRoute(evil, evil, "#000", evil, [(1.0, 2.0)])], shell)
        assert data_in(page)[0]["ways"][0]["key"] == evil
        assert [tag for tag, _ in Page(page).found].count("script") == [
            tag for tag, _ in Page(trajectory_map_page(WAYS[:1], shell)).found
        ].count("script")

    def test_many_long_ways_stay_a_small_page(self, shell):
        way = [(48.0 + n * 1e-5, 11.0) for n in range(3600)]
        page = trajectory_map_page([MapRoute(f"r{n}", "train", "#000", "", way) for n in range(1000)], shell)
        assert len(page) < 4_000_000
        first = data_in(page)[0]["ways"][0]["points"]
        assert (first[0], first[-1]) == ([48.0, 11.0], [48.03599, 11.0])

    def test_scripts_are_leaflet_and_nothing_else(self, shell):
        scripts = [a["src"] for tag, a in Page(shell).found if tag == "script" and "src" in a]
        assert len(scripts) == 2
        assert all("leaflet" in source for source in scripts)

    def test_without_network_the_same_ways_are_on_a_plain_grid(self, shell):
        page = trajectory_map_page(WAYS, shell)
        fallback = page[
            page.index('<div id="nomap">') : page.index("</script>", page.index('<div id="nomap">'))
        ]
        assert fallback.count("<polyline") == 3
        assert fallback.count('<text class="name"') == 3
        assert "train" in fallback[fallback.index('<div class="legend">') :]
        assert 'typeof L !== "undefined"' in fallback

    def test_those_that_are_nowhere_on_earth_are_named(self, shell):
        page = trajectory_map_page(WAYS, shell)
        assert "1 without a position on Earth" in page
        beside = page[page.index('<div id="beside">') : page.index('<div id="nomap">')]
        assert [key in beside for key in ("monday", "&lt;tuesday&gt;", "hall")] == [True] * 3
        only_local = trajectory_map_page(WAYS[2:], shell)
        assert "hall" in only_local
        assert "leaflet" not in only_local
        assert "No recording has a route" in trajectory_map_page([], shell)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    write_recordings([Target(folder / "recordings" / "drive.mcap", "mcap")], seed=2, duration_s=2.2)
    (folder / "recipe.yaml").write_text(sample_recipe())
    recipe = load_recipe(folder / "recipe.yaml")
    return recipe, build_recordings(recipe)["drive.mcap"]


def plan_of(recipe, made, number=1, content="x"):
    """A plan of many recordings that share their artifacts, and their content if its name has no `{}`."""
    states = {
        name: AssetState("fresh", "", made[name].artifact.digest) for name in recording_assets(recipe).names
    }
    bags = {}
    for n in range(number):
        key, bag = f"drive_{n:04d}", AssetState("fresh", "", content.format(n))
        bags[key] = BagPlan(key, {"bag": bag, **states}, "mcap", rig="car")
    return Plan(bags, {}, ())


def made_map(recipe, store, plan):
    assets = recording_assets(recipe)
    assets.store = store
    return build_map(assets, plan, DatasetInputs({}))


class TestGathered:
    def test_facts_are_those_of_the_artifacts(self, built):
        recipe, made = built
        data = report_data(recording_assets(recipe), plan_of(recipe, made))
        (recording,) = data.recordings
        assert recording.state == "ready"
        assert recording.counts["images"] == sum(
            counts["written"] for counts in made["frames"].artifact.summary()["channels"].values()
        )
        assert recording.rig == "car"
        assert recording.daylight == "day"
        assert recording.length_m == made["ego_poses"].artifact.summary()["length_m"]
        assert len(recording.pictures) == 5
        assert recording.points[0][0] == pytest.approx(48.0775, abs=1e-3)
        assert "lidar_over_camera.jpg" in {path.name for path in recording.full_pictures.iterdir()}
        assert sum(recording.boxes.values()) == recording.counts["boxes"] > 0
        assert list(recording.boxes) == made["annotations"].artifact.summary()["categories"]

    def test_checks_are_those_of_the_present_recipe(self, built):
        recipe, made = built
        recorded = {name: made[name].artifact.digest for name in recording_assets(recipe).names}
        (bag,) = plan_of(recipe, made).bags.values()
        bags, discovery = (
            {"drive.mcap": replace(bag, key="drive.mcap", recorded=recorded)},
            discover(recipe.bags),
        )
        plan = Plan(bags, {}, (), discovery=discovery)

        def gathered(checked):
            return report_data(recording_assets(checked), plan, "all").recordings[0]

        strict = recipe.checks.poses_cover_sensors.model_copy(update={"max_speed_mps": 0.5})
        checks = recipe.checks.model_copy(update={"poses_cover_sensors": strict})
        before, after = gathered(recipe), gathered(recipe.model_copy(update={"checks": checks}))
        assert before.checks_passed > 5
        assert after.checks_passed == before.checks_passed - 1
        (new,) = set(after.problems) - set(before.problems)
        assert new.weight == "error"
        assert "m/s" in new.sentence

    def test_reasons_leave_out_the_path_of_what_stands_beside_them(self, tmp_path):
        torn = RecordingFacts(
            "monday__torn.bag", "failed", "/data/monday/torn.bag: it is cut off; copy it again."
        )
        page = Page(report_page(data_of(tmp_path, [torn]))).text
        assert "failed it is cut off; copy it again." in page
        assert "/data/" not in page

    def test_failed_and_skipped_recordings_are_reported_with_reason(self, built):
        recipe, made = built
        plan = plan_of(recipe, made)
        failed = {"bag": AssetState("fresh", ""), "inventory": AssetState("failed", "it is torn")}
        failed |= {name: AssetState("unknown", "waits") for name in recording_assets(recipe).names[1:]}
        skipped = {
            name: AssetState("skipped", "too short") for name in ("bag", *recording_assets(recipe).names)
        }
        bags = dict(plan.bags) | {"torn": BagPlan("torn", failed), "short": BagPlan("short", skipped)}
        data = report_data(recording_assets(recipe), Plan(bags, {}, ()))
        assert {r.key: (r.state, r.reason) for r in data.recordings if r.state != "ready"} == {
            "torn": ("failed", "it is torn"),
            "short": ("skipped", "too short"),
        }
        assert sum(share.recordings for share in data.shares) == 1

    def test_a_copy_is_left_out_of_the_totals_as_it_is_of_the_dataset(self, built):
        recipe, made = built
        data = report_data(recording_assets(recipe), plan_of(recipe, made, 3))
        assert [(r.state, r.reason) for r in data.recordings] == [
            ("ready", ""),
            *[("copy", "the same content as drive_0000")] * 2,
        ]
        assert sum(share.recordings for share in data.shares) == 1
        page = Page(report_page(data)).text
        assert "1 recording 2.1 seconds" in page
        assert "2 recordings" not in page
        assert "drive_0001 copy the same content as drive_0000" in page
        boxes = sum(data.recordings[0].boxes.values())
        table = page.split(" Boxes ")[-1].split(" Recordings ")[0]
        assert sum(int(number) for number in re.findall(r" (\d+) [\d.]+% 1\b", table)) == boxes

    def test_a_deviation_of_nothing_has_no_minus(self, tmp_path):
        share = SplitShare("train", asked=0.8, recordings=3, duration_s=80.1, share=0.7999)
        assert "80.0% 80.0% +0.0%" in Page(report_page(ReportData("yard", tmp_path, [], shares=[share]))).text

    def test_time_is_that_of_scenes_as_in_the_dataset(self, built):
        recipe, made = built
        data = report_data(recording_assets(recipe), plan_of(recipe, made))
        scenes_s = made["nuscenes_tables"].artifact.summary()["counts"]["duration_s"]
        assert data.recordings[0].scenes_s == scenes_s
        assert sum(share.duration_s for share in data.shares) == scenes_s

    def test_a_pin_that_holds_nothing_is_reported(self, built):
        recipe, made = built
        pinned = recipe.model_copy(update={"splits": Splits(pinned={"drive_0000": "val", "dirve": "val"})})
        data = report_data(recording_assets(pinned), plan_of(recipe, made))
        assert data.recordings[0].split == "val"
        assert data.idle_pins == ["dirve"]
        assert "not among the recordings: dirve" in Page(report_page(data)).text

    def test_a_thousand_recordings_make_a_page_below_five_megabytes(self, built):
        recipe, made = built
        page = report_page(report_data(recording_assets(recipe), plan_of(recipe, made, 1000)))
        assert len(page.encode()) < 5_000_000
        assert page.count('class="t"') == 1000, "each with a picture"

    def test_the_map_is_made_once_and_put_in_its_place(self, built):
        recipe, made = built
        store = Store(recipe.store_path)
        three, two = (plan_of(recipe, made, number, "{}") for number in (3, 2))
        first = made_map(recipe, store, three)
        assert not first.cached
        assert made_map(recipe, store, three).cached
        assert "drive_0002" in map_path(recipe).read_text()
        assert made_map(recipe, store, two).artifact.digest != first.artifact.digest
        assert "drive_0002" not in map_path(recipe).read_text()

    def test_a_copy_is_not_on_the_map(self, built):
        recipe, made = built
        outcome = made_map(recipe, Store(recipe.store_path), plan_of(recipe, made, 3))
        assert outcome.artifact.summary()["recordings"] == 1
        assert "drive_0001" not in map_path(recipe).read_text()

    def test_the_track_follows_the_fixes_once_a_second(self, built):
        recipe, made = built
        poses = made["ego_poses"].artifact
        track = track_of(Store(recipe.store_path), made["inventory"].artifact, poses, "header")
        assert track.source == "/gnss/fix"
        stamps = [stamp for stamp, _, _ in track.points]
        assert [round((b - a) / 1e9, 1) for a, b in pairwise(stamps)] == [1.0, 1.0]
        assert track.local[-1][0] > track.local[0][0]


def test_a_page_is_written_whole_or_not_at_all(tmp_path):
    assert write_page(tmp_path / "new" / "a.html", "<p>ä</p>") == 9
    (tmp_path / "file").touch()
    with pytest.raises(DatasetError, match="cannot be written"):
        write_page(tmp_path / "file" / "a.html", "x")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["a.html"]
