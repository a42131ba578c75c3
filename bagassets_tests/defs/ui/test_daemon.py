"""The sensor under a real `dagster dev`, started in a project folder without any variables set."""

import json
import signal
import time
from datetime import UTC, datetime

import dagster as dg
import pytest

from bagassets.defs.records.instances import open_instance
from bagassets_tests.services import (
    BIN,
    complaints,
    eventually,
    free_port,
    make_project,
    running,
)
from bagassets_tests.small_drive import write_drive

pytestmark = [pytest.mark.xdist_group("daemon"), pytest.mark.long]

PARTITIONS = "test_recordings"
SETTLE_S = 2.0


class Watched:
    """What a project shows to somebody who watches from outside."""

    def __init__(self, project, instance):
        self.bags = project.parent / "bags"
        self.log = project.parent / "dagster.log"
        self.instance = instance
        self._lock = project / "dataset" / "nuscenes" / "v1.0-test" / "dataset.lock.json"
        self._version = self._lock.parent

    @property
    def dataset(self):
        """Key -> content of the recordings in the dataset."""
        return {bag["key"]: bag["content"] for bag in self._read("dataset.lock.json")["bags"]}

    @property
    def scenes(self):
        return len(self._read("scene.json"))

    @property
    def partitions(self):
        return set(self.instance.get_dynamic_partitions(PARTITIONS))

    def runs_of(self, key):
        return self.instance.get_runs(dg.RunsFilter(tags={"dagster/partition": key}))

    def work_s(self, since_s, until_s):
        """Return for how long runs were at work in this time; what launches them is no work."""
        records = self.instance.get_run_records(
            dg.RunsFilter(created_after=datetime.fromtimestamp(since_s, UTC))
        )
        assert {r.dagster_run.tags.get("dagster/partition") for r in records} == {"c.bag", None}, (
            "no other run"
        )
        return sum(min(r.end_time or until_s, until_s) - r.start_time for r in records)

    def _read(self, name):
        try:
            return json.loads((self._version / name).read_text())
        except FileNotFoundError:  # not there yet, or being exchanged
            return {"bags": []} if name == "dataset.lock.json" else []


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    folder = tmp_path_factory.mktemp("daemon")
    write_drive(folder / "bags" / "a.bag", "ros1", duration_s=2.0)
    write_drive(folder / "bags" / "b.mcap", "mcap", duration_s=2.2)
    project = make_project(folder, settle_s=SETTLE_S)
    command = [BIN / "dagster", "dev", "--port", free_port()]
    with (
        # First: two processes that make Dagster's databases at the same moment hinder each other.
        open_instance(str(project)) as instance,
        running(command, project, folder / "dagster.log") as process,
    ):
        watched = Watched(project, instance)
        eventually(lambda: set(watched.dataset) == {"a.bag", "b.mcap"}, "the dataset is made")
        yield watched
        process.send_signal(signal.SIGINT)
        # Dagster gives its code server up to a minute to answer what it was asked.
        assert process.wait(150) == 0


def test_what_is_there_at_first_is_built_once_and_nothing_is_complained_about(watched):
    assert watched.partitions == {"a.bag", "b.mcap"}
    assert watched.scenes == 2
    for key in ("a.bag", "b.mcap"):
        (run,) = watched.runs_of(key)
        assert run.status == dg.DagsterRunStatus.SUCCESS
        assert run.tags["why"] == "new recording"
    assert complaints(watched.log) == []


@pytest.mark.once
def test_a_recording_that_is_copied_in_slowly_is_taken_when_it_is_complete(watched, tmp_path):
    data = write_drive(tmp_path / "c.bag", "ros1", duration_s=2.4).read_bytes()
    with (watched.bags / "c.bag").open("wb") as upload:
        # Longer than it takes to settle, with pauses so short that a busy machine makes none of them that long.
        for part in range(12):
            upload.write(data[len(data) * part // 12 : len(data) * (part + 1) // 12])
            upload.flush()
            assert "c.bag" not in watched.partitions
            time.sleep(SETTLE_S / 9)
    uploaded_s = time.time()
    eventually(lambda: "c.bag" in watched.dataset, "the dataset has the new recording")
    there_s = time.time()
    assert watched.scenes == 3
    assert "c.bag" in watched.partitions
    assert [run.status for run in watched.runs_of("c.bag")] == [dg.DagsterRunStatus.SUCCESS]
    # At most 5 s until a tick, two runs to start: 4 s if the machine is idle, 10 s if it is busy.
    assert there_s - uploaded_s - SETTLE_S - watched.work_s(uploaded_s, there_s) < 14


@pytest.mark.once
def test_a_changed_recording_is_the_only_one_that_runs(watched, tmp_path):
    before, runs = watched.dataset, {key: len(watched.runs_of(key)) for key in watched.partitions}
    (watched.bags / "a.bag").write_bytes(write_drive(tmp_path / "a.bag", "ros1", duration_s=3.0).read_bytes())
    eventually(lambda: watched.dataset["a.bag"] != before["a.bag"], "the dataset has the new content")
    assert {key for key, content in watched.dataset.items() if before.get(key) != content} == {"a.bag"}
    assert {key for key in runs if len(watched.runs_of(key)) != runs[key]} == {"a.bag"}


@pytest.mark.once
def test_a_removed_recording_goes_with_its_partition_and_scenes(watched):
    scenes = watched.scenes
    (watched.bags / "b.mcap").unlink()
    eventually(lambda: "b.mcap" not in watched.dataset, "the dataset has dropped it")
    assert "b.mcap" not in watched.partitions
    assert watched.scenes == scenes - 1
    assert complaints(watched.log) == []
