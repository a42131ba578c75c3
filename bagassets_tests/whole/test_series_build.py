"""Drives in several files, built: the truth is the same drive in one file."""

import json
import shutil
from bisect import bisect_right
from contextlib import ExitStack
from types import SimpleNamespace

import dagster as dg
import pytest
from mcap.writer import Writer

from bagassets.base.errors import RecordingError
from bagassets.cli.build import _dry_run
from bagassets.cli.dry_run import dry_run_lines, verdict
from bagassets.cli.summary import print_summary
from bagassets.defs.builds import snapshot
from bagassets.defs.builds.pending_work import expected_moves, open_project
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import _no_such_recording, add_partitions
from bagassets.engine.build_report import BuildOptions, BuildReport
from bagassets.formats.dataset_lock import read_lock
from bagassets.propose.project import write_project
from bagassets.recipe import load_recipe
from bagassets.recipe.load import parse_recipe
from bagassets.recordings.open import open_recording
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets_tests.defs.graph.test_sensor import Project
from bagassets_tests.in_process import QUICK, build, survey
from bagassets_tests.series import write_part, write_parts
from bagassets_tests.small_drive import RECIPE, START_NS
from bagassets_tests.whole.test_end_to_end import build_of, make_project

pytestmark = [pytest.mark.xdist_group("series_build"), pytest.mark.once]

CUTS_S = {3: (0.7, 1.33), 5: (0.4, 0.81, 1.0, 1.5)}
ANGLES = (
    RECIPE.replace("min_length_s: 0.5", "length_s: 1.2, min_length_s: 0.2") + "preview: {{enabled: false}}\n"
)


@pytest.mark.parametrize("number", CUTS_S)
@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_a_cut_drive_gives_all_artifacts_of_the_whole_one_byte_for_byte(tmp_path, suffix, number):
    made = {}
    for name in ("whole", "cut"):
        recipe = make_project(tmp_path / name, text=ANGLES)
        drive = recipe.bags.root / f"drive{suffix}"
        if name == "whole":
            write_part(drive, duration_s=2.0)
        else:
            write_parts(drive, CUTS_S[number], 2.0)
        made[name] = {one.asset: one.artifact for one in build_of(recipe, drive.name).build()}
    # Of the inventory, the size of the files differs.
    inventories = [artifacts.pop("inventory").read_json("inventory.json") for artifacts in made.values()]
    assert {**inventories[0], "size": 0} == {**inventories[1], "size": 0}
    whole, cut = ({name: one.digest for name, one in artifacts.items()} for artifacts in made.values())
    assert len(whole) >= 5
    assert cut == whole
    tables = made["cut"]["nuscenes_tables"]
    assert len(tables.read_json("scene.json")) == 2


# --- in a project ------------------------------------------------------------------------


def project(folder, **bags):
    """Write the project files, with these fields of `bags`; return the recipe file."""
    given = json.dumps({"root": "bags", "settle_s": 0, **bags})
    text = QUICK.replace("{{root: {root}, settle_s: 0}}", given.replace("{", "{{").replace("}", "}}"))
    more = "splits: {{shares: {{train: 0.5, val: 0.5}}, pinned: {{drive_1.bag: val}}}}\n"
    more += "datasets: [{{name: second, recordings: ['drive_2*']}}]\n"
    write_project(folder, (text + more).format(name="test", root="bags"))
    return folder / "recipe.yaml"


def lock_of(folder, name="nuscenes", version="v1.0-test"):
    return read_lock(folder / "dataset" / name / version)


def moves_said(recipe_file):
    return expected_moves(survey(recipe_file), load_recipe(recipe_file))


def test_parts_that_were_built_alone_are_joined_by_an_upgrade_and_their_old_keys_go_on_working(
    tmp_path, monkeypatch, capsys
):
    write_parts(tmp_path / "bags" / "drive.bag", CUTS_S[3], 2.0)
    write_part(tmp_path / "bags" / "other.bag", duration_s=1.0)
    # Without its transforms a later part fails: that is why they are to be joined.
    build(project(tmp_path, series={"drive": False}), monkeypatch)
    recipe_file, events = project(tmp_path), []
    pending = survey(recipe_file)
    assert pending.plan.removed == ("drive_0.bag", "drive_1.bag", "drive_2.bag")
    assert pending.todo.keys() == {"drive.bag"}
    targets = {name: {"": one} for name, one in pending.dataset_states.items()}
    own = SimpleNamespace(problem="", targets=targets, left_out={})
    lines = list(dry_run_lines(pending, own))
    assert "drive_0.bag, drive_1.bag, drive_2.bag\n  would be joined into drive.bag, as its parts" in lines
    assert verdict(pending, own).startswith("to do: build 1 recording, join 3 parts, update ")
    report, runs = build(recipe_file, monkeypatch, on_event=events.append)
    assert report.succeeded
    assert not report.removed
    assert {key for key, _ in runs if key} == {"drive.bag"}
    told = [event.message for event in events if "joined" in event.message]
    assert [event.kind for event in events].index("planned") < [event.kind for event in events].index(
        "started"
    )
    assert [text.splitlines()[0] for text in told] == [
        "drive_0.bag, drive_1.bag, drive_2.bag: joined into drive.bag, as its parts."
    ]
    lock = lock_of(tmp_path)
    assert dict(lock.splits) == {"drive.bag": "val", "other.bag": "train"}
    assert list(lock_of(tmp_path, "second").bags) == ["drive.bag"]
    with open_project(recipe_file) as workspace:
        with pytest.raises(
            RecordingError, match=r"drive_1.bag: no such recording below .*; it is part of drive.bag now"
        ):
            workspace.recording("drive_1.bag")
        found = workspace.discover()
        asked = _no_such_recording("drive_1.bag", workspace.recipe.bags, found)
        assert asked.endswith("; it is part of drive.bag, which is one recording.")
    _, runs = build(recipe_file, monkeypatch, on_event=events.append)
    assert not runs
    assert len([event for event in events if "joined" in event.message]) == 1
    assert survey(recipe_file, bags=("drive_1.bag",)).asked.chosen == {"drive.bag"}
    assert moves_said(recipe_file) == {}
    text = recipe_file.read_text()
    recipe_file.write_text(text.replace("drive_1.bag: val", "drive_1.bag: train, other.bag: train"))
    said = moves_said(recipe_file)
    assert said == {"drive.bag": ("val", "train")}
    _dry_run(recipe_file, BuildOptions(), check=True, as_json=False)
    told = "from val to train, as `splits.pinned` says"
    assert f"drive.bag would move {told}.\n" in capsys.readouterr().out
    report, _ = build(recipe_file, monkeypatch)
    assert report.moved == said
    print_summary(BuildReport.from_json(report.as_json()), [], recipe_file)
    assert f"moved drive.bag: {told}\n" in capsys.readouterr().out


def why_stale(folder):
    return survey(project(folder)).plan.bags["drive.bag"].assets["bag"].reason


def test_a_changed_part_makes_what_depends_on_its_topics_and_a_later_one_extends_the_drive(
    tmp_path, monkeypatch
):
    parts = write_parts(tmp_path / "bags" / "drive.bag", CUTS_S[3], 2.0)
    late = tmp_path / parts[2].name
    shutil.move(parts[2], late)
    report, _ = build(project(tmp_path), monkeypatch)
    assert report.succeeded
    before = {asset: state.data_version for asset, state in report.plan.bags["drive.bag"].assets.items()}
    second = tmp_path / "second.bag"
    shutil.move(parts[1], second)
    lost_ns = START_NS + 1_010_000_000
    write_part(parts[1], *CUTS_S[3], 2.0, keep=lambda *of: of != ("/cam/image_raw", lost_ns))
    assert why_stale(tmp_path) == "drive_1.bag changed; its content has to be read"
    report, _ = build(project(tmp_path), monkeypatch)
    after = {asset: state.data_version for asset, state in report.plan.bags["drive.bag"].assets.items()}
    same = {asset for asset in after if after[asset] == before[asset]}
    assert {"sweeps", "ego_poses", "calibration"} <= same
    assert not same & {"bag", "inventory"}
    shutil.move(second, parts[1])
    shutil.move(late, parts[2])
    assert why_stale(tmp_path) == "drive_1.bag changed, drive_2.bag is new; its content has to be read"
    report, _ = build(project(tmp_path), monkeypatch)
    assert report.succeeded
    assert list(report.outcomes) == ["drive.bag"]
    shutil.move(parts[0], late)
    assert why_stale(tmp_path) == "content changed: drive_0.bag is gone"
    shutil.move(late, parts[0])
    write_part(tmp_path / "whole" / "bags" / "drive.bag", duration_s=2.0)
    build(project(tmp_path / "whole"), monkeypatch)
    assert lock_of(tmp_path).files == lock_of(tmp_path / "whole").files


def test_undecided_parts_lie_in_one_split_and_two_drives_apart_where_their_keys_say(tmp_path, monkeypatch):
    for number in range(3):  # of the same second, each without another cloud
        lost = ("/points", START_NS + 5_000_000 + number * 100_000_000)
        write_part(
            tmp_path / "bags" / f"near_{number}.mcap", duration_s=1.0, keep=lambda *of, lost=lost: of != lost
        )
    recipe_file = project(tmp_path)
    recipe_file.write_text(recipe_file.read_text().replace("{drive_1.bag: val}", "{}"))
    report, _ = build(recipe_file, monkeypatch)
    (question,) = report.plan.asked.values()
    assert question in [remark.problem for remark in report.remarks]
    assert "near_0.mcap to near_2.mcap (3 files): parts of one drive, or drives of their own?" in question
    assert len(set(lock_of(tmp_path).splits.values())) == 1
    answered = recipe_file.read_text().replace(
        '"settle_s": 0', '"settle_s": 0, "series": {"near.mcap": false}'
    )
    recipe_file.write_text(answered)
    report, _ = build(recipe_file, monkeypatch)
    assert not report.plan.asked
    assert set(lock_of(tmp_path).splits.values()) == {"train", "val"}


def test_the_sensor_makes_one_run_of_the_parts_once_all_are_quiet(tmp_path):
    parts = write_parts(tmp_path / "bags" / "drive.bag", CUTS_S[3], 2.0)
    late = tmp_path / parts[2].name
    shutil.move(parts[2], late)
    with dg.DagsterInstance.ephemeral() as instance:
        scanned = Project(project(tmp_path), instance)
        add_partitions(Records(instance, Naming("test")), ["drive_0.bag"])
        assert list(scanned.scan()) == ["drive.bag"]
        assert "drive_0.bag joined into drive.bag" in scanned.cursor.said
        assert scanned.live == {"drive.bag"}
        # While a part is being copied it cannot be read, so it is none yet.
        parts[2].write_bytes(late.read_bytes()[:5000])
        scanned.scan()
        assert "drive.bag" in scanned.live
        shutil.copy(late, parts[2])
        assert "drive.bag" in scanned.scan()
        assert scanned.live == {"drive.bag"}


def cut_mcap(whole, cuts_s, folder):
    """Write the messages of an MCAP as parts in another folder."""
    folder.mkdir(parents=True)
    with ExitStack() as stack:
        recording = stack.enter_context(open_recording(whole))
        messages = list(recording.messages(list(recording.topics)))
        start_ns, number, writer = messages[0].log_time_ns, -1, None
        for message in messages:
            if bisect_right(cuts_s, (message.log_time_ns - start_ns) / 1e9) != number:
                number += 1
                writer = Writer(stack.enter_context((folder / f"{whole.stem}_{number}.mcap").open("wb")))
                writer.start("ros2", "test")
                stack.callback(writer.finish)
                channels = {}
            if message.topic not in channels:
                text = recording.topics[message.topic].definition.text.encode()
                schema = writer.register_schema(message.msgtype, "ros2msg", text)
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            channel, time_ns = channels[message.topic], message.log_time_ns
            writer.add_message(channel, time_ns, bytes(message.data), time_ns)


@pytest.mark.long
def test_revolutions_of_packets_are_whole_across_the_borders_of_parts(tmp_path):
    cuts_s = (0.37, 0.74)  # within a revolution
    write_recordings([Target(tmp_path / "whole" / "drive.mcap", "mcap")], profile="tas", duration_s=1.2)
    cut_mcap(tmp_path / "whole" / "drive.mcap", cuts_s, tmp_path / "cut")
    made = {}
    for name in ("whole", "cut"):
        text = sample_recipe(root=str(tmp_path / name), throughput=True)
        assert "velodyne_packets, deskew: true" in text
        text = text.replace("length_s: 20", "length_s: 20\n  min_length_s: 0")
        recipe = parse_recipe(text, tmp_path / f"{name}.state" / "recipe.yaml")
        made[name] = {one.asset: one.artifact for one in build_of(recipe, "drive.mcap").build()}
    for asset in ("sweeps", "frames", "nuscenes_tables"):
        assert made["cut"][asset].digest == made["whole"][asset].digest


@pytest.mark.parametrize(
    ("reason", "is_noted"),
    [
        ("drive_1.bag cannot be read for now (its index is damaged); look again later", False),
        ("rename it", True),
    ],
)
def test_a_drive_that_is_left_out_for_now_is_looked_at_again(monkeypatch, reason, is_noted):
    noted = []
    monkeypatch.setattr(snapshot.decide, "note_nothing_to_do", lambda *_, **__: noted.append(True))
    monkeypatch.setattr(snapshot.decide, "forget_note", lambda _: noted.append(False))
    monkeypatch.setattr(snapshot, "dataset_code_versions", lambda _: ())
    monkeypatch.setattr(snapshot, "dataset_folders", lambda _: {})
    saved = snapshot.Snapshot.__new__(snapshot.Snapshot)
    saved._recipe, saved._marks, saved._tree, saved._folders = SimpleNamespace(state=None), {}, [], {}
    saved._places = {"artifacts": ""}
    saved.save(SimpleNamespace(bags={}, excluded={"drive.bag": reason}))
    assert noted == [is_noted]
