"""The benchmarks: their arithmetic, what they count, and the recordings they make."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from blake3 import blake3
from sample_drives import build_recordings, build_sample

import benchmarks.cold
from bagassets.formats import json_files
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets.recordings.digest_record import ATTRIBUTE
from bagassets.recordings.discover import discover
from bagassets.recordings.open import open_recording
from bagassets.sample.drive import Target, write_recordings
from bagassets.store import artifact
from bagassets.store.store import Store
from bagassets_tests.small_drive import RECIPE as SMALL
from benchmarks.cold import BUILD, FIXED_LOOP, PICTURES, cold_table
from benchmarks.common import Options, Project, converter_command, markdown, project, save, speedup
from benchmarks.drives import LIDAR_TOPIC, write_jpeg_project, write_tas_drive
from benchmarks.patches import PATCHES
from benchmarks.peers import BAGASSETS, BAZEL, LOOP, BazelWorkspace, Peers, params_of, peers_table
from benchmarks.peers import main as peers_main
from benchmarks.plain import convert_plainly
from benchmarks.resources import Used, run_watched
from benchmarks.rq1 import output_lines
from benchmarks.rq2 import fit

pytestmark = pytest.mark.once

ROOT = Path(__file__).parents[2]


def test_speed_up_and_reduction_are_those_of_the_paper():
    assert speedup([40.0, 38.0, 80.0], [10.0]) == (4.0, 75.0)
    assert speedup([10.0], [20.0]) == (0.5, -100.0)


def test_a_line_is_fitted_through_all_trials():
    slope, offset, spread = fit({1.0: [5.1, 4.9], 2.0: [8.0, 8.0], 4.0: [14.05, 13.95]})
    assert (round(slope, 2), round(offset, 2)) == (3.0, 2.0)
    assert 0 < spread < 0.2
    exact = fit({1.0: [5.0], 2.0: [8.0], 4.0: [14.0]})
    assert np.allclose(exact, (3.0, 2.0, 0.0), atol=1e-9)


def test_slopes_that_are_noise_are_within_their_interval():
    dice = np.random.default_rng(4)
    within = 0
    for _ in range(200):
        slope, _, spread = fit({size: dice.normal(0.1, 0.01, 3).tolist() for size in (0.5, 1.0, 2.0)})
        within += abs(slope) <= spread
    assert 180 <= within <= 198  # 95 % of 200


def test_tables_are_markdown():
    assert markdown(["run", "s"], [["a", 1.2345], ["b", 123.4], ["c", 7]]) == (
        "| run | s |\n| --- | --: |\n| a | 1.23 |\n| b | 123 |\n| c | 7 |\n"
    )


def test_results_say_what_they_depend_on(tmp_path, capsys):
    save(Options(tmp_path, tmp_path / "results", 3, 1.0, 4, "other {bag} {out}"), "rq9", {"x": 1}, "table\n")
    content = json.loads((tmp_path / "results" / "rq9.json").read_text())
    assert content["x"] == 1
    assert content["converter"] == "other {bag} {out}"
    assert content["machine"]["processors"] >= 1
    assert content["machine"]["versions"]["dagster"].startswith("1.")
    assert (tmp_path / "results" / "rq9.md").read_text() == capsys.readouterr().out.rstrip("\n") + "\n"


@pytest.fixture
def drives(tmp_path):
    made = project(tmp_path / "project", [], 1)
    for name in ("a.bag", "b.bag"):
        write_recordings([Target(made.bags / name, "ros1")], duration_s=0.3)
    return made


def test_a_converter_that_fails_quietly_does_not_look_fast(drives):
    converter = f'{sys.executable} -c \'import sys, pathlib; bag, out = sys.argv[1:]; \
pathlib.Path(out, "one.jpg").touch() if bag.endswith("a.bag") else print("Error")\' {{bag}} {{out}}'
    done = drives.convert_with(converter)
    assert (done.files, done.failed) == (1, ("b.bag",))
    assert "FAILED on b.bag" in output_lines({"external": {"files": done.files, "failed": done.failed}})
    assert drives.convert_with("false {bag} {out}").failed == ("a.bag", "b.bag")


def test_digests_are_stored_and_taken_away(drives):
    drives.store_digests()
    assert all(ATTRIBUTE in os.listxattr(file) for file in drives.files())
    drives.hash_at_client()
    assert not any(ATTRIBUTE in os.listxattr(file) for file in drives.files())


def test_time_and_memory_of_all_processes_are_seen(tmp_path):
    child = "x = bytearray(150_000_000); t = __import__('time'); e = t.time() + 1.0\nwhile t.time() < e: pass"
    code = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}]); sys.exit(3)"
    used = run_watched([sys.executable, "-c", code], cwd=tmp_path)
    assert used.code == 3
    assert used.seconds >= 1.0
    assert used.cpu_s > 0.15  # the processors are shared
    assert 150 < used.peak_mb < 250


def test_lidar_packets_one_by_one_give_the_points_of_whole_scans(tmp_path, monkeypatch):
    """The benchmark's recordings hold the same drive as those of `bagassets sample`."""
    monkeypatch.setattr("bagassets.sample.throughput._CYCLE", 1)  # the same image again and again
    projects = {name: project(tmp_path / name, [], 1) for name in ("packets", "scans")}
    write_tas_drive(projects["packets"].bags / "drive.bag", "ros1", 5, 0.35)
    write_recordings(
        [Target(projects["scans"].bags / "drive.bag", "ros1")], seed=5, profile="tas", duration_s=0.35
    )
    text = projects["scans"].recipe.read_text().replace("/lidar_top/packets", "/lidar_top/velodyne_packets")
    projects["scans"].recipe.write_text(text)
    clouds = {}
    for name, made in projects.items():
        recipe = load_recipe(made.recipe)
        build_recordings(recipe)
        files = Path(recipe.store_path).rglob("*.pcd.bin")
        clouds[name] = {path.name: path.read_bytes() for path in files}
    assert len(clouds["packets"]) >= 2
    assert clouds["packets"].keys() == clouds["scans"].keys()
    assert clouds["packets"] == clouds["scans"]


def test_jpeg_recordings_are_passed_through(tmp_path):
    recipe = load_recipe(write_jpeg_project(tmp_path, 5e6))
    (results,) = build_recordings(recipe).values()
    counts = results["frames"].artifact.read_json("channels.json")
    assert len(counts) == 4
    store = Store(recipe.store_path)
    written = {
        path.read_bytes()
        for channel in counts.values()
        for path in store.artifact(channel["artifact"]).files.rglob("*.jpg")
    }
    assert len(written) == min(5, counts["CAM_BACK"]["counts"]["written"])


@pytest.fixture
def hashed_sizes(monkeypatch):
    """The size of everything that is hashed from here on, whichever module of the package does it."""
    sizes = []

    class Counting:
        def __init__(self, data=b"", **options):
            sizes.append(len(data))
            self._hasher = blake3(data, **options)
            self.digest, self.hexdigest = self._hasher.digest, self._hasher.hexdigest

        def update(self, data):
            sizes.append(len(data))
            self._hasher.update(data)

    Counting.AUTO = blake3.AUTO
    for name, module in list(sys.modules.items()):
        if name.startswith("bagassets.") and getattr(module, "blake3", None) is blake3:
            monkeypatch.setattr(module, "blake3", Counting)
    for module in (artifact, json_files):
        monkeypatch.setattr(module, "digest_bytes", module.digest_bytes)  # the conversion replaces it
    return sizes


def test_a_plain_conversion_hashes_and_keeps_nothing(tmp_path, hashed_sizes):
    built = build_sample(tmp_path, targets=[("drive.bag", "ros1")], duration_s=1.2)
    assert max(hashed_sizes) > 100_000
    hashed_sizes.clear()
    out = tmp_path / "out"
    out.mkdir()
    before = set(tmp_path.iterdir())
    convert_plainly(tmp_path / "recipe.yaml", tmp_path / "recordings", out)
    assert max(hashed_sizes) < 10_000  # names of rows, of actions; the lock
    assert set(tmp_path.iterdir()) == before
    assert contents_below(out / "samples") == contents_below(built.dataroot / "samples")
    assert contents_below(out / "sweeps") == contents_below(built.dataroot / "sweeps")


def contents_below(folder):
    """The content of all files; their names hold digests, which the plain conversion numbers instead."""
    found = sorted(path.read_bytes() for path in folder.rglob("*") if path.is_file())
    assert found
    return found


def test_converters_are_given_the_file_of_a_ros2_folder(tmp_path):
    made = project(tmp_path / "project", [], 1)
    write_recordings([Target(made.bags / "a.bag", "ros1"), Target(made.bags / "b", "ros2")], duration_s=0.3)
    recordings = discover(load_recipe(made.recipe).bags).recordings
    given = [converter_command("convert {bag} {out}", one, tmp_path) for one in recordings.values()]
    assert given == [
        ["convert", str(made.bags / "a.bag"), str(tmp_path)],
        ["convert", str(next((made.bags / "b").glob("*.db3"))), str(tmp_path)],
    ]


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["rq9"], "no such part: rq9"),
        (["--size", "0"], "must be positive"),
        (["--converter", "convert {bag}"], "must say where {bag} and {out} go"),
        (["--tiny"], "--tiny needs --results"),
    ],
)
def test_wrong_use_is_refused(arguments, error):
    command = [sys.executable, "-m", "benchmarks", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 2
    assert error in done.stderr


def test_bazel_runs_the_converter_once_per_recording(tmp_path):
    made = project(tmp_path / "project", [], 1)
    for name in ("a.bag", "b.bag"):
        (made.bags / name).touch()
    params = tmp_path / "params.json"
    params.write_text("{}")
    converter = f"{sys.executable} -c 'import sys; print(sys.argv[1:])' --in={{bag}} 'a b' {{out}} {{params}}"
    for bagzel in (None, tmp_path / "bagzel"):
        BazelWorkspace(tmp_path / "w", made, Peers("bazel", converter, bagzel), params)
        root = tmp_path / "w" / "workspace"
        targets = (root / "BUILD").read_text()
        assert all(targets.count(f'"bags/{name}"') == 1 for name in ("a.bag", "b.bag"))
        assert ("single_rosbag_to_nuscenes(" in targets) == (bagzel is not None)
        assert (str(bagzel) in (root / "WORKSPACE").read_text()) == (bagzel is not None)
        words = ["--input_bag", "x y.bag", "--output_dir", "out", "--param_file", "p.json"]
        done = subprocess.run(["./convert.sh", *words], cwd=root, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == str(["--in=x y.bag", "a b", "out", "p.json"])


def test_settings_of_the_converter_name_what_the_drives_have(tmp_path, monkeypatch):
    monkeypatch.setattr("bagassets.sample.throughput._CYCLE", 1)  # the same image again and again
    made = project(tmp_path / "project", [], 1)
    write_recordings([Target(made.bags / "a.bag", "ros1")], profile="tas", duration_s=0.2)
    [recording] = discover(load_recipe(made.recipe).bags).recordings.values()
    with open_recording(recording) as opened:
        topics = set(opened.topics)
    params = params_of(2.7)
    sensors = params["SENSOR_INFO"].values()
    assert {one["TOPIC"] for one in sensors} - topics == {
        LIDAR_TOPIC
    }  # the benchmark splits its scans into packets
    assert params["BAG_INFO"]["ODOM_TOPIC"] in topics
    assert len({one["TOKEN"] for one in sensors}) == len(sensors) == 5
    assert params["EXTRACTION"]["scene_length_sec"] == 2.43
    assert params_of(60.0)["EXTRACTION"]["scene_length_sec"] == 20.0


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--bazel", "bazel"], "--bazel needs --converter"),
        (["--converter", "convert {out}"], "must say where {bag} and {out} go"),
        (["--bazel", "no-such-program", "--converter", "convert {bag} {out}"], "there is no program"),
        (["--tiny"], "--tiny needs --results"),
    ],
)
def test_wrong_use_of_peers_is_refused(arguments, error, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["peers", *arguments])
    with pytest.raises(SystemExit) as ended:
        peers_main()
    assert ended.value.code == 2
    assert error in capsys.readouterr().err


def test_rows_without_a_figure_say_what_happens():
    rows = {"cold": {BAGASSETS: [{"seconds": 2.0}, {"seconds": 4.0}], LOOP: [{"seconds": 9.0}]},
            "nothing changed": {BAGASSETS: [{"seconds": 0.1}]}}  # fmt: skip
    found = {
        "bazel": "",
        "rule": "",
        "rows": rows,
        "files": {BAGASSETS: 5, LOOP: 6},
        "trials": 2,
        "hashing_s": [0.2],
    }
    assert peers_table(found) == (
        "| | bagassets | Bagzel's converter in a loop |\n|---|--:|--:|\n"
        "| cold | 3.00 s | 9.00 s |\n| nothing changed | 0.10 s | everything again |\n\n"
        "Medians of 2; percentages are medians of the ratio within each turn. Hashing the touched recordings alone: 0.20 s. Cold, of all recordings: bagassets: 5 files; converter in a loop: 6 files.\n"
    )


def test_what_ours_takes_of_bazels_time_is_the_median_over_the_turns():
    ours, bazels = (
        [{"seconds": value} for value in values] for values in ((1.0, 9.0, 3.0), (4.0, 12.0, 3.0))
    )
    found = {"bazel": "4", "rule": "rule", "rows": {"cold": {BAGASSETS: ours, BAZEL: bazels}}}
    table = peers_table(found | {"files": {BAGASSETS: 5, BAZEL: 6}, "trials": 3, "hashing_s": [0.2]})
    assert "| cold | 3.00 s | 4.00 s | 75 % |" in table.splitlines()


def test_cold_tells_medians_and_what_builds_take_beyond_conversions(tmp_path, monkeypatch):
    """With times that are given: a build takes 2 CPU-s to start, and for each recording 0.5, 0.25 for pictures, and half the speed."""

    class Made(Project):
        def stop_server(self):
            pass

    def make(folder, sizes, trials):
        write_project(folder, SMALL.format(name="x", root="recordings"))
        made = Made(folder / "recipe.yaml", trials)
        made.bags.mkdir()
        made.state.mkdir(exist_ok=True)
        for number, size in enumerate(sizes):
            with (made.bags / f"{number}.bag").open("wb") as stream:
                stream.truncate(round(size))
        return made

    def runs(made, _options, _loop):
        number = len(list(made.bags.iterdir()))
        plain = [Used(10 * made.size_gb * slower, number * slower, 100.0, 0.5) for slower in (1.0, 1.2, 0.1)]
        built = [Used(20 * made.size_gb, number * 1.5 + 2, 300.0, 0.9)] * 3
        drawn = [Used(24 * made.size_gb, number * 1.75 + 2, 300.0, 0.9)] * 3
        return {PICTURES: drawn, BUILD: built, FIXED_LOOP: plain}

    monkeypatch.setattr(benchmarks.cold, "project", make)
    monkeypatch.setattr(
        benchmarks.cold, "jpeg_project", lambda folder, size, trials: make(folder, [size], trials)
    )
    monkeypatch.setattr(benchmarks.cold, "_runs", runs)
    monkeypatch.setattr(benchmarks.cold, "_checkout", lambda folder: folder)
    monkeypatch.setattr(
        benchmarks.cold, "stages_of", lambda *_: ({"read": 0.04, "write": 0.06}, {"other": 9.0})
    )
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: {0, 1})
    options = Options(tmp_path, tmp_path / "results", 3, 0.01, 2, None, tiny=True)
    benchmarks.cold.cold(options)
    found = json.loads((tmp_path / "results" / "cold.json").read_text())
    assert len(found["cases"]) == 7
    assert found["beyond"] == pytest.approx({"once": 2.0, "each": 0.5, "pictures": 0.25})
    rates = found["jpeg_mb_per_s"]
    assert (rates[BUILD], rates[FIXED_LOOP]) == (pytest.approx(50.0), pytest.approx(100.0))
    assert "cutting it into files" in rates
    table = (tmp_path / "results" / "cold.md").read_text()
    assert table == cold_table(found)
    assert "| one recording of 0.02 GB: loop | 0.19 | 1 | 1 | 0 | 50 | 100 |" in table
    assert "| one recording of 0.02 GB: bagassets, no pictures | 0.38 | 2 | 3.5 | 2.5 | 90 | 300 |" in table
    assert "| one recording of 0.02 GB: floor | 0.05 | 0.263 | 0.1 |  | 100 |  |" in table


def test_a_project_is_a_bench(drives):
    assert isinstance(drives, Project)
    assert 0.001 < drives.size_gb < 0.1


@pytest.mark.parametrize("patch", PATCHES)
def test_what_a_patch_is_switched_off_by_is_in_the_code_once(patch):
    for name, text, _ in PATCHES[patch].edits:
        assert (ROOT / "bagassets" / name).read_text("utf-8").count(text) == 1
