"""`bagassets verify`: damage of any kind is found, named and healed; actions give the same bytes again."""

import json
import os
import random
import shutil
import time
from errno import EIO
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from bagassets.assets import calibration
from bagassets.cli.main import root
from bagassets.cli.rebuild_process import other_environment
from bagassets.engine.rebuild import known_actions, rebuild
from bagassets.forkserver.client import Client
from bagassets.formats.assembly import assemble
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.dataset_integrity import find_damage
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.vision.format import VISION
from bagassets.recipe import load_recipe
from bagassets.recordings.discover import find_one
from bagassets.recordings.open import open_recording
from bagassets.store.action import Step
from bagassets.store.integrity import artifact_damage
from bagassets.store.store import Store
from bagassets_tests.formats.test_dataset import content
from bagassets_tests.nuscenes_checks import check_dataset
from bagassets_tests.services import make_project as make_command_project
from bagassets_tests.small_drive import write_drive
from bagassets_tests.store_check import check_store
from bagassets_tests.whole.test_end_to_end import build_all, make_project

pytestmark = pytest.mark.once

VERSION = "v1.0-test"
NAMES = {"ros1": "a.bag", "mcap": "c.mcap"}


def make_dataset(recipe):
    store = Store(recipe.store_path)
    made = build_all(recipe)
    parts = [Part(key, key, assets["nuscenes_tables"].artifact.digest) for key, assets in made.items()]
    assemble(NUSCENES, parts, recipe.nuscenes, store, recipe.nuscenes.output)
    return made


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    recipe = make_project(tmp_path_factory.mktemp("project"), **NAMES)
    make_dataset(recipe)
    return recipe


@pytest.fixture
def project(template, tmp_path):
    """A copy of a built project, so that each test can spoil its own."""
    shutil.copytree(template.bags.root, tmp_path / "bags", copy_function=shutil.copy2)
    recipe = make_project(tmp_path)
    shutil.copytree(template.state, recipe.state)
    make_dataset(recipe)
    return recipe


def store_of(recipe):
    return Store(recipe.store_path)


def artifact_of(recipe, step, channel=""):
    known = next(k for k in known_actions(recording_assets(recipe)) if (k.step, k.channel) == (step, channel))
    return store_of(recipe).artifact(known.artifact)


def overwrite(path, data):
    path.chmod(0o644)
    path.write_bytes(data)


def run(recipe, *args, status=0):
    command = ["verify", "--recipe", str(recipe.state.parent / "recipe.yaml"), *map(str, args)]
    result = CliRunner().invoke(root, command, standalone_mode=False)
    assert result.exception is None, result.exception
    assert (result.return_value or 0) == status, result.output
    return result


def load_recipe_with(recipe, text):
    file = recipe.state.parent / "recipe.yaml"
    file.write_text(file.read_text() + text)
    return load_recipe(file)


class TestStore:
    def test_a_store_as_it_was_written_is_whole(self, project):
        assert list(check_store(store_of(project))) == []
        assert list(find_damage(project, store_of(project))) == []

    @pytest.mark.parametrize("is_torn", [True, False])
    def test_a_folder_that_a_killed_build_left_is_no_damaged_dataset(self, project, is_torn):
        current = project.nuscenes.output / VERSION
        left = current.with_name(f"{VERSION}.tmp-0123")
        shutil.copytree(current, left)
        (left / ("dataset.lock.json" if is_torn else "sample.json")).write_bytes(b"")
        assert list(find_damage(project, store_of(project))) == []
        make_dataset(project)
        assert not left.exists()

    def test_an_empty_store_is_whole(self, tmp_path):
        assert list(check_store(Store(tmp_path / "none"))) == []

    def test_files_of_artifacts_cannot_be_overwritten_by_accident(self, project):
        image = next(artifact_of(project, "frames", "CAM_FRONT").files.glob("*.jpg"))
        assert image.stat().st_mode & 0o222 == 0
        linked = next((project.nuscenes.output / "samples" / "CAM_FRONT").iterdir())
        assert linked.stat().st_mode & 0o222 == 0

    @pytest.mark.parametrize("of", ["record", "manifest", "file"])
    def test_a_read_that_fails_once_is_no_damage(self, project, monkeypatch, of):
        store, artifact = store_of(project), artifact_of(project, "calibration")
        chosen = {
            "record": next(store.root.glob("actions/*/*.json")),
            "manifest": artifact.folder / "manifest.json",
            "file": next(path for path in artifact.files.rglob("*") if path.is_file()),
        }[of]
        usual, failed = Path.read_bytes, []

        def read_bytes(path):
            if path == chosen and not failed:
                failed.append(path)
                raise OSError(EIO, "Input/output error", str(path))
            return usual(path)

        monkeypatch.setattr(Path, "read_bytes", read_bytes)
        run(project)
        assert failed == [chosen]
        assert chosen.exists()

    @pytest.mark.parametrize(
        ("spoil", "reason"),
        [
            (lambda path: path.unlink(), "is missing"),
            (lambda path: overwrite(path, path.read_bytes()[:-1]), "bytes instead of"),
            (lambda path: overwrite(path, path.read_bytes()[:-1] + b"?"), "was changed"),
            (lambda path: path.with_name("more").write_bytes(b""), "more does not belong to it"),
            (
                lambda path: (path.parents[1] / "manifest.json").write_bytes(b"{}"),
                "manifest.json was changed",
            ),
            (lambda path: (path.parents[1] / "manifest.json").unlink(), "manifest.json cannot be read"),
        ],
    )
    def test_each_kind_of_damage_is_reported(self, project, spoil, reason):
        artifact = artifact_of(project, "calibration")
        spoil(artifact.path("calibration.json"))
        assert reason in artifact_damage(artifact)[0]
        (damage,) = check_store(store_of(project))
        assert (damage.kind, damage.digest) == ("artifact", artifact.digest)
        assert damage.step == "calibration" or "manifest" in reason
        assert reason in str(damage)

    def test_an_artifact_that_is_gone_is_reported_by_the_action_that_made_it(self, project):
        artifact = artifact_of(project, "calibration")
        shutil.rmtree(artifact.folder)
        damages = list(check_store(store_of(project)))
        assert {(d.kind, d.step) for d in damages} == {("action", "calibration")}
        assert artifact.digest[:16] in str(damages[0])

    @pytest.mark.parametrize("content", [b"", b"{", b"{}", b'{"action": {"step": "x"}, "artifact": "0"}'])
    def test_a_torn_record_is_reported_and_forgotten(self, project, content):
        store = store_of(project)
        path = next((project.store_path / "actions").glob("*/*.json"))
        overwrite(path, content)
        (damage,) = check_store(store)
        assert (damage.kind, damage.digest) == ("action", path.stem)
        store.forget(damage.digest)
        assert list(check_store(store)) == []

    def test_what_is_just_being_written_is_no_damage(self, project):
        store = store_of(project)
        pending = store.begin(Step("slow", 1).action({}, {}))
        pending.out.write("half", b"half")
        actions = next((project.store_path / "actions").iterdir())
        (actions / ".abc.json.123").write_bytes(b"{")
        assert list(check_store(store)) == []
        pending.discard()


class TestHealing:
    @pytest.mark.parametrize("seed", range(4))
    def test_whatever_is_damaged_the_next_build_makes_it_again(self, project, seed):
        store = store_of(project)
        before = {
            path: path.read_bytes()
            for path in sorted(project.store_path.rglob("files/**/*"))
            if path.is_file()
        }
        tables = {path: path.read_bytes() for path in (project.nuscenes.output / VERSION).iterdir()}
        dice = random.Random(seed)
        for path in dice.sample(sorted(before), 12):
            if not path.exists():
                continue
            kind = dice.choice(["remove", "change", "folder", "manifest"])
            if kind == "remove":
                path.unlink()
            elif kind == "change":
                overwrite(path, b"?" * path.stat().st_size)
            else:
                folder = next(p for p in path.parents if p.name == "files").parent
                shutil.rmtree(folder) if kind == "folder" else (folder / "manifest.json").unlink(
                    missing_ok=True
                )
        assert run(project, status=3).stdout.count("damaged") >= 1
        make_dataset(project)
        assert list(check_store(store)) == []
        # Files of artifacts that were gone altogether could not be checked the first time.
        if list(find_damage(project, store)):
            run(project, status=3)
        make_dataset(project)
        assert {path: path.read_bytes() for path in before} == before
        assert {path: path.read_bytes() for path in tables} == tables
        assert check_dataset(project.nuscenes.output, VERSION) == []
        assert run(project).stdout == "Store and datasets are intact.\n"

    def test_a_dataset_outlives_its_store(self, project):
        files = {path: path.read_bytes() for path in project.nuscenes.output.rglob("*.jpg")}
        shutil.rmtree(project.store_path / "artifacts")
        assert "is gone" in run(project, status=3).stdout
        assert {path: path.read_bytes() for path in files} == files

    def test_it_names_recording_step_and_file(self, project):
        artifact = artifact_of(project, "frames", "CAM_FRONT")
        image = next(artifact.files.glob("*.jpg"))
        image.unlink()
        found = json.loads(run(project, "--json", status=3).stdout)
        (damaged,) = found["damaged"]
        assert damaged["step"] == "frames"
        assert damaged["what"] in {"frames CAM_FRONT of a.bag", "frames CAM_FRONT of c.mcap"}
        assert damaged["reasons"] == [f"{image.name} is missing"]
        assert found["taken_out"] is True
        assert not artifact.folder.exists()

    def test_what_was_taken_out_is_no_damage_the_next_time(self, project):
        artifact = artifact_of(project, "inventory")
        overwrite(artifact.path("inventory.json"), b"?")
        others = sum(1 for _ in (project.store_path / "actions").glob("*/*.json"))
        assert run(project, status=3).stdout.count("damaged") == 1
        assert run(project).stdout == "Store and datasets are intact.\n"
        records = [
            json.loads(path.read_bytes()) for path in (project.store_path / "actions").glob("*/*.json")
        ]
        assert artifact.digest not in {record["artifact"] for record in records}
        assert others > len(records) >= others - 2, "of each recording at most one made it"
        make_dataset(project)
        assert artifact_damage(artifact) == []

    def test_report_only_changes_nothing(self, project):
        artifact = artifact_of(project, "calibration")
        overwrite(artifact.path("calibration.json"), b"?")
        for _ in range(2):
            assert "Nothing was changed" in run(project, "--report-only", status=3).stderr
        assert artifact.path("calibration.json").read_bytes() == b"?"

    def test_a_damaged_artifact_is_not_in_the_way_of_a_new_one(self, project):
        store = store_of(project)
        artifact = artifact_of(project, "calibration")
        digest, text = artifact.digest, artifact.path("calibration.json").read_bytes()
        artifact.path("calibration.json").unlink()
        for path in (project.store_path / "actions").glob("*/*.json"):
            if json.loads(path.read_bytes()).get("artifact") == digest:
                path.unlink()
        build_all(project)
        assert store.artifact(digest).path("calibration.json").read_bytes() == text


class TestDatasets:
    def spoil_first(self, project, channel="CAM_FRONT"):
        return next((project.nuscenes.output / "samples" / channel).iterdir())

    def test_a_file_that_is_gone(self, project):
        path = self.spoil_first(project)
        path.unlink()
        assert f"dataset  {path}: is missing" in run(project, status=3).stdout
        assert not path.exists()
        make_dataset(project)
        assert run(project).stderr.endswith("artifacts checked\n")

    def test_a_copy_that_was_changed(self, project):
        path = self.spoil_first(project)
        content = path.read_bytes()
        path.unlink()
        path.write_bytes(b"?" * len(content))
        (project.nuscenes.output / VERSION / "dataset.lock.json").touch()  # nobody saw it
        assert f"{path}: was changed" in run(project, status=3).stdout
        make_dataset(project)
        assert path.read_bytes() == content

    def test_a_link_that_was_written_through_damages_both_and_both_heal(self, project):
        path = self.spoil_first(project)
        content = path.read_bytes()
        overwrite(path, b"?" * len(content))
        found = json.loads(run(project, "--json", status=3).stdout)
        # Both recordings have these very images: one artifact, linked under two names.
        assert {entry["path"][-25:] for entry in found["datasets"]} == {str(path)[-25:]}
        assert str(path) in [entry["path"] for entry in found["datasets"]]
        assert [entry["step"] for entry in found["damaged"]] == ["frames"]
        make_dataset(project)
        assert path.read_bytes() == content
        run(project)

    def test_files_of_other_versions_are_looked_at_too(self, project):
        store, other = store_of(project), project.nuscenes.model_copy(update={"version": "v1.0-other"})
        made = build_all(project)["a.bag"]["nuscenes_tables"].artifact.digest
        assemble(NUSCENES, [Part("a.bag", "c", made)], other, store, other.output)
        (other.output / "v1.0-other" / "log.json").write_bytes(b"[]")
        assert f"{other.output}/v1.0-other/log.json: was changed" in run(project, status=3).stdout

    def test_a_vision_dataset(self, project):
        recipe = load_recipe_with(project, "vision: {output: dataset/vision}\n")
        made = build_all(recipe)
        parts = [Part(k, k, assets["vision_sequences"].artifact.digest) for k, assets in made.items()]
        store, output = store_of(recipe), recipe.vision.output
        assemble(VISION, parts, recipe.vision, store, recipe.vision.output, splits=recipe.splits)
        assert list(find_damage(recipe, store)) == []
        before = content(output)
        image = next(output.rglob("*.jpg"))
        image.unlink()
        (output / "annotations" / "train.manifest.json").write_bytes(b"{}")
        run(recipe, status=3)
        assemble(VISION, parts, recipe.vision, store, recipe.vision.output, splits=recipe.splits)
        assert content(output) == before
        run(recipe)

    def test_a_table_that_was_changed(self, project):
        path = project.nuscenes.output / VERSION / "sample.json"
        content = path.read_bytes()
        path.write_bytes(content.replace(b"0", b"1", 1))
        assert f"{path}: was changed" in run(project, status=3).stdout
        make_dataset(project)
        assert path.read_bytes() == content


class TestMinutes:
    """`verify --minutes`: each run goes on where the last one stopped."""

    MOMENT = 1e-9  # one thing is verified nevertheless

    @pytest.fixture(autouse=True)
    def one_thread(self, monkeypatch):
        monkeypatch.setattr("bagassets.engine.verified._THREADS", 1)

    def times(self, project):
        return json.loads((project.store_path / "verified.json").read_text())

    def set_times(self, project, change):
        times = {name: change(name, at) for name, at in self.times(project).items()}
        (project.store_path / "verified.json").write_text(json.dumps(times))

    def verified(self, project, *args, minutes=10, status=0):
        return json.loads(run(project, "--minutes", minutes, "--json", *args, status=status).stdout)[
            "verified"
        ]

    def test_runs_that_are_stopped_come_to_the_end_together(self, project):
        names = {path.name for path in (project.store_path / "artifacts").glob("*/*")}
        folders = {path.name for path in (project.store_path / "actions").iterdir()}
        seen = set()
        for number in range(len(names) + len(folders) + 2):
            share = self.verified(project, minutes=self.MOMENT)
            now = set(self.times(project)) if (project.store_path / "verified.json").exists() else set()
            assert seen <= now
            assert len(now) + share["recordings"] <= number + 1
            seen = now
        assert seen == names | folders
        assert (share["artifacts"], share["of_artifacts"]) == (len(names), len(names))

    def test_what_was_verified_longest_ago_comes_first(self, project):
        self.verified(project)
        names = sorted(self.times(project), reverse=True)
        began_s = int(time.time())
        self.set_times(project, lambda name, _: began_s - 1000 - names.index(name))
        for oldest in reversed(names[-3:]):
            self.verified(project, minutes=self.MOMENT)
            assert self.times(project)[oldest] >= began_s
        assert sum(at >= began_s for at in self.times(project).values()) == 3

    def test_of_what_was_verified_only_thirty_days_count(self, project):
        assert self.verified(project)["artifacts"] == self.verified(project)["of_artifacts"] > 3
        day_s = 86_400
        some = set(sorted(path.name for path in (project.store_path / "artifacts").glob("*/*"))[:2])
        late = next(iter(set(self.times(project)) - some))
        ago = {name: 31 * day_s if name in some else 29 * day_s for name in self.times(project)} | {
            late: -day_s
        }
        self.set_times(project, lambda name, at: at - ago[name])
        share = self.verified(
            project, minutes=self.MOMENT
        )  # of what has a time to come nobody knows when it was
        assert share["of_artifacts"] - share["artifacts"] == 2
        assert self.times(project)[late] <= time.time()
        text = run(project, "--minutes", self.MOMENT).stdout
        assert text.startswith("Verified within 30 days: ")
        assert f" of {share['of_artifacts']} artifacts, " in text

    def test_of_recordings_alone_it_says_nothing_of_artifacts(self, project):
        done = run(project, "--minutes", 10, "--recordings")
        share, _, _ = done.stdout.partition(" recordings (")
        assert share == "Verified within 30 days: 2 of 2"

    def test_what_is_gone_is_forgotten_and_what_is_new_comes_first(self, project):
        self.verified(project)
        gone = artifact_of(project, "calibration")
        shutil.rmtree(gone.folder)
        self.set_times(project, lambda _, at: at - 100)  # something in the store is the oldest, no recording
        self.verified(project, minutes=self.MOMENT)
        assert gone.digest not in self.times(project)
        build_all(project)
        began_s = int(time.time())
        self.set_times(project, lambda _, __: began_s - 100)
        self.verified(project, minutes=self.MOMENT)
        assert self.times(project)[gone.digest] >= began_s

    def test_damage_is_taken_out_with_what_datasets_have_of_it_and_heals(self, project):
        path = next((project.nuscenes.output / "samples" / "CAM_FRONT").iterdir())
        content = path.read_bytes()
        overwrite(path, b"?" * len(content))
        (project.nuscenes.output / VERSION / "log.json").unlink()  # of the dataset nothing else is looked at
        done = run(project, "--minutes", 10, status=3)
        assert done.stdout.count("damaged  artifact") == 1
        assert f"{path}: was changed" in done.stdout
        assert "log.json" not in done.stdout
        assert not path.exists()
        make_dataset(project)
        assert path.read_bytes() == content
        run(project, "--minutes", 10)

    def test_damage_that_stays_is_found_again_first(self, project):
        artifact = artifact_of(project, "frames", "CAM_FRONT")
        overwrite(next(artifact.files.glob("*.jpg")), b"?")
        torn = next((project.store_path / "actions").glob("*/*.json"))
        overwrite(
            torn,
            torn.read_bytes()
            .replace(b'"step":', b'"stop":', 1)
            .replace(b'"action":{', b'"action":{"step":"x",', 1),
        )
        for _ in range(2):
            done = run(project, "--minutes", 10, "--report-only", status=3)
            assert done.stdout.count("damaged") == 2
            assert not {artifact.digest, torn.stem[:2]} & set(self.times(project))

    def test_a_whole_check_counts_too(self, project):
        self.verified(project, "--recordings")  # they are not what is verified next
        overwrite(artifact_of(project, "calibration").path("calibration.json"), b"?")
        run(project, "--report-only", status=3)
        share = self.verified(project, "--report-only", minutes=self.MOMENT, status=3)
        assert share["of_artifacts"] - share["artifacts"] == 1

    @pytest.mark.parametrize("args", [(), ("--report-only",)])
    def test_what_was_whole_before_and_is_damaged_now_does_not_count(self, project, args):
        before = self.verified(project)
        assert before["artifacts"] == before["of_artifacts"]
        overwrite(artifact_of(project, "inventory").path("inventory.json"), b"?")
        share = self.verified(project, *args, status=3)
        assert share["artifacts"] == before["artifacts"] - 1
        assert share["of_artifacts"] == before["artifacts"] - (not args), "what was removed is no more"

    def test_an_interrupt_keeps_what_was_verified(self, project, monkeypatch):
        looked_at = []

        def interrupted(artifact, _step):
            if len(looked_at) == 3:
                raise KeyboardInterrupt
            looked_at.append(artifact.digest)
            return []

        monkeypatch.setattr("bagassets.engine.verified.check_artifact", interrupted)
        command = ["verify", "--minutes", "10", "--recipe", str(project.state.parent / "recipe.yaml")]
        with pytest.raises(click.Abort):
            CliRunner().invoke(root, command, standalone_mode=False, catch_exceptions=False)
        assert set(looked_at) <= set(self.times(project))

    @pytest.mark.parametrize("text", ["", "[]", '{"a": null}', '{"a"'])
    def test_a_torn_note_costs_time_only(self, project, text):
        (project.store_path / "verified.json").write_text(text)
        share = self.verified(project)
        assert share["artifacts"] == share["of_artifacts"]

    def test_where_it_cannot_be_noted_that_is_said(self, project):
        (project.store_path / "verified.json").mkdir()
        done = run(project, "--minutes", 10)
        assert "verified.json: it cannot be noted what was verified (Is a directory)" in done.stderr
        assert "the next run begins where this one did" in done.stderr

    def test_two_ways_at_once_are_refused(self, project):
        command = [
            "verify",
            "--minutes",
            "1",
            "--rebuild",
            "1",
            "--recipe",
            str(project.state.parent / "recipe.yaml"),
        ]
        assert "--minutes and --rebuild" in CliRunner().invoke(root, command).output


class TestRebuild:
    def test_known_actions_are_those_of_the_recordings(self, project):
        known = list(known_actions(recording_assets(project)))
        assert {k.key for k in known} == {"a.bag", "c.mcap"}
        steps = {str(k) for k in known if k.key == "a.bag"}
        assert steps >= {"inventory of a.bag", "frames CAM_FRONT of a.bag", "sweeps LIDAR_TOP of a.bag"}

    def test_every_action_gives_the_same_bytes_in_another_environment(self, project):
        result = run(project, "--rebuild", 1000, "--json")
        made = json.loads(result.stdout)
        assert len(made["actions"]) == len({k.action for k in known_actions(recording_assets(project))})
        assert {entry["result"] for entry in made["actions"]} == {"same"}
        assert made["environment"]["PYTHONHASHSEED"]

    def test_what_a_library_prints_is_not_taken_for_the_answer(self, project, monkeypatch):
        monkeypatch.setenv("OPENCV_LOG_LEVEL", "DEBUG")
        made = json.loads(run(project, "--rebuild", 1000, "--json").stdout)
        assert {entry["result"] for entry in made["actions"]} == {"same"}

    def test_the_environment_is_another(self, monkeypatch):
        monkeypatch.setattr("platform.machine", lambda: "x86_64")
        assert other_environment()["OPENBLAS_CORETYPE"] == "Nehalem"

    def test_a_seed_chooses_the_same_again(self, project):
        one, two = (run(project, "--rebuild", 3, "--seed", 5).stdout for _ in range(2))
        assert one == two
        assert one.count("same ") == 3

    def test_a_step_that_is_not_deterministic_is_caught(self, project, monkeypatch, tmp_path):
        real = calibration.make_calibration

        def odd(use, recording, out):
            out.write("odd.txt", b"other")
            return real(use, recording, out)

        monkeypatch.setattr(calibration, "make_calibration", odd)
        known = [k for k in known_actions(recording_assets(project)) if k.key == "a.bag"]
        digests = {k.action: k for k in known}
        scratch = tmp_path / "scratch"
        made = rebuild(recording_assets(project), "a.bag", set(digests), scratch, threads=2)
        results = {digests[m.action].step: m for m in made}
        assert results["calibration"].differing == ("odd.txt",)
        assert results["inventory"].artifact == next(k.artifact for k in known if k.step == "inventory")
        assert list(check_store(store_of(project))) == []

    def test_nothing_on_record_is_reported(self, tmp_path):
        recipe = make_project(tmp_path, ros1="a.bag")
        command = ["verify", "--rebuild", "3", "--recipe", str(tmp_path / "recipe.yaml")]
        result = CliRunner().invoke(root, command)
        assert "run `bagassets build` first" in str(result.exception)
        assert not recipe.store_path.exists()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings")
    write_drive(folder / "bags" / "a.bag", "ros1", duration_s=2.0)
    write_drive(folder / "bags" / "b.mcap", "mcap", duration_s=2.0)
    write_drive(folder / "bags" / "c", "ros2", duration_s=2.0)
    project = make_command_project(folder, settle_s=0)
    recipe = project / "recipe.yaml"
    assert CliRunner().invoke(root, ["build", "--recipe", str(recipe)]).exit_code == 0
    yield recipe
    for client in Client.all_of(project / ".bagassets"):
        client.shutdown(grace_s=0.0)


@pytest.fixture
def kept(recorded):
    """The recipe; recordings are put back as they were, times included."""
    bags = recorded.parent.parent / "bags"
    files = [path for path in bags.rglob("*") if path.is_file()]
    before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in files}
    yield recorded
    for path, (data, mtime_ns) in before.items():
        write_over(path, data, mtime_ns)


class TestRecordings:
    """`verify --recordings`: bytes that changed under a digest on record."""

    def test_sound_recordings_are_reported_as_sound(self, kept):
        done = CliRunner().invoke(
            root, ["verify", "--recordings", "--recipe", str(kept)], standalone_mode=False
        )
        assert (done.return_value, done.stdout) == (0, "")
        assert "3 recordings, " in done.stderr
        assert "none changed" in done.stderr

    @pytest.mark.parametrize("touched", [False, True])
    @pytest.mark.parametrize(
        ("name", "topic"),
        [
            ("a.bag", "/cam/image_raw"),
            ("a.bag", "/odom"),
            ("c/c.db3", "/points"),
            ("c/c.db3", "/cam/camera_info"),
        ],
    )
    def test_a_flipped_byte_is_named_with_file_and_topic(self, kept, name, topic, touched):
        bags = kept.parent.parent / "bags"
        path = bags / name
        damaged, mtime_ns = flipped(path, bags / name.partition("/")[0], topic), path.stat().st_mtime_ns
        write_over(path, damaged, mtime_ns + (5_000_000_000 if touched else 0))
        done = CliRunner().invoke(
            root, ["verify", "--recordings", "--json", "--recipe", str(kept)], standalone_mode=False
        )
        assert done.return_value == 3
        wrong = [
            entry for entry in json.loads(done.stdout)["recordings"] if entry["files"] or entry["problem"]
        ]
        assert [[file["path"] for file in entry["files"]] for entry in wrong] == [[str(path)]]
        assert wrong[0]["files"][0]["touched"] == touched
        assert [entry["topic"] for entry in wrong[0]["topics"]] == [topic]
        assert wrong[0]["problem"] is None
        reported = CliRunner().invoke(
            root, ["verify", "--recordings", "--recipe", str(kept)], standalone_mode=False
        )
        assert f"changed  {path}: the digest on record is " in reported.stdout
        assert f"topic {topic}: some of its " in reported.stdout
        # Nothing was accepted by looking.
        again = CliRunner().invoke(
            root, ["verify", "--recordings", "--recipe", str(kept)], standalone_mode=False
        )
        assert again.stdout == reported.stdout

    def test_damage_that_a_checksum_finds_is_named_by_file(self, kept):
        path = kept.parent.parent / "bags" / "b.mcap"
        data = bytearray(path.read_bytes())
        data[len(data) // 3] ^= 0x40
        write_over(path, data, path.stat().st_mtime_ns)
        done = CliRunner().invoke(
            root, ["verify", "--recordings", "--recipe", str(kept)], standalone_mode=False
        )
        assert done.return_value == 3
        assert f"changed  {path}" in done.stdout
        assert f"its topics cannot be compared: {path}: it cannot be read" in done.stdout

    def test_what_is_no_message_changes_no_topic(self, kept):
        path = kept.parent.parent / "bags" / "c" / "metadata.yaml"
        write_over(path, path.read_bytes().replace(b"rosbags", b"rosbagx"), path.stat().st_mtime_ns)
        done = CliRunner().invoke(
            root, ["verify", "--recordings", "--recipe", str(kept)], standalone_mode=False
        )
        assert done.return_value == 3, done.stdout
        assert f"changed  {path}" in done.stdout
        assert "no topic: only an index, a header" in done.stdout

    def test_a_recording_without_record_is_reported_and_no_fault(self, kept):
        path = kept.parent.parent / "bags" / "new.bag"
        write_drive(path, "ros1", duration_s=1.0)
        done = CliRunner().invoke(
            root, ["verify", "--recordings", "--recipe", str(kept)], standalone_mode=False
        )
        path.unlink()
        assert done.return_value == 0
        assert f"unknown  {path}: it has no digest on record" in done.stdout

    @pytest.mark.parametrize("later_s", [0, 5])
    def test_in_turn_a_changed_one_is_found_and_not_counted(self, kept, later_s):
        def verify(status):
            command = ["verify", "--minutes", "10", "--recordings", "--json", "--recipe", str(kept)]
            done = CliRunner().invoke(root, command, standalone_mode=False)
            assert (done.return_value or 0) == status, done.output
            return json.loads(done.stdout)

        share = verify(0)["verified"]
        assert (share["recordings"], share["of_recordings"], share["of_artifacts"]) == (3, 3, 0)
        assert share["recording_bytes"] == share["of_recording_bytes"] > 0
        path = kept.parent.parent / "bags" / "a.bag"
        write_over(path, flipped(path, path, "/odom"), path.stat().st_mtime_ns + later_s * 10**9)
        found = verify(3)
        assert [one["key"] for one in found["recordings"] if one["files"]] == ["a.bag"]
        share = found["verified"]
        assert share["recordings"] == 2
        assert share["of_recording_bytes"] - share["recording_bytes"] == path.stat().st_size
        noted = json.loads((kept.parent / ".bagassets" / "verified.json").read_text())
        assert {name.partition(" ")[0] for name in noted} == {"b.mcap", "c"}


def write_over(path, data, mtime_ns):
    """Change bytes in place, and put the time back, as a failing disk does."""
    with path.open("r+b") as file:
        file.write(data)
        file.truncate()
    os.utime(path, ns=(mtime_ns, mtime_ns))


def flipped(path, recording, topic):
    """Return the bytes of a file with one in the middle of the payload of a message of a topic changed."""
    with open_recording(find_one(recording)) as opened:
        payloads = [bytes(message.data) for message in opened.messages([topic])]
    data = bytearray(path.read_bytes())
    at = next(found for payload in payloads if (found := data.find(payload)) >= 0) + len(payloads[0]) // 2
    data[at] ^= 0x01
    return bytes(data)
