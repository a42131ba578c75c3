"""A project whose Dagster database is a real PostgreSQL: builds, and the decision that there is nothing to do."""

import subprocess
import sys

import psycopg2
import pytest

from bagassets.base.cache import NAME
from bagassets.base.fingerprints import PlanNeeded, records_fingerprint
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.engine.freshness.decide import nothing_to_do
from bagassets.forkserver.client import Client
from bagassets.recipe import load_recipe
from bagassets_tests.in_process import make_project
from bagassets_tests.postgres_server import PORT, PROGRAMS, running_postgres, use_postgres

KEYS = ["a.bag", "b.mcap"]

pytestmark = pytest.mark.skipif(PROGRAMS is None, reason="PostgreSQL is not installed")


@pytest.fixture(scope="module")
def server():
    with running_postgres() as server:
        yield server


@pytest.fixture(scope="module")
def url(server):
    return server.url


@pytest.fixture(scope="module")
def project(tmp_path_factory, url):
    recipe_file = make_project(tmp_path_factory.mktemp("postgres"), KEYS, duration_s=2.0)
    use_postgres(recipe_file, url)
    yield recipe_file
    for client in Client.all_of(load_recipe(recipe_file).state):
        client.shutdown(grace_s=1.0)


def build(recipe_file, *arguments):
    command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe_file), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def decide(recipe_file):
    return nothing_to_do(["build", "--recipe", str(recipe_file)])


def test_a_build_and_the_next_one_which_has_nothing_to_do(project):
    assert "2 built" in build(project)
    assert "2 fresh: nothing to do" in decide(project)
    assert "nothing to do" in build(project)
    assert not list(project.parent.rglob("index.db")), "no SQLite beside it"
    cache = load_recipe(project).state / NAME
    assert cache.stat().st_mode & 0o077 == 0, "it may hold a password"


@pytest.mark.once
@pytest.mark.parametrize("what", ["an asset wiped", "a run deleted", "a partition removed"])
def test_what_happened_in_the_database_is_noticed(project, what):
    build(project)
    assert decide(project) is not None
    with open_instance(str(project.parent)) as instance:
        if what == "an asset wiped":
            (key,) = (key for key in instance.get_asset_keys() if key.path[-1] == "ego_poses")
            instance.wipe_assets([key])
        elif what == "a run deleted":
            instance.delete_run(instance.get_runs()[-1].run_id)
        else:
            instance.delete_dynamic_partition(Naming(load_recipe(project).name).partitions, KEYS[0])
    assert decide(project) is None
    assert "failed" not in build(project)
    assert decide(project) is not None, "all is as it was"


def test_a_database_that_is_not_there_needs_a_plan(url):
    with pytest.raises(PlanNeeded, match="PostgreSQL"):
        records_fingerprint(url.replace(f"port={PORT}", "port=5440"), "recordings")


def test_connections_are_kept_and_a_restarted_server_gets_new_ones(tmp_path, server, url, monkeypatch):
    home = tmp_path / "home"
    home.mkdir()
    (home / "dagster.yaml").write_text(
        f"telemetry: {{enabled: false}}\nstorage: {{postgres: {{postgres_url: '{url}'}}}}\n", "utf-8"
    )
    opened, connect = [], psycopg2.connect
    monkeypatch.setattr(psycopg2, "connect", lambda *args, **how: opened.append(how) or connect(*args, **how))
    with open_instance(str(home)) as instance:
        instance.get_runs(limit=1)
        before = len(opened)
        assert before > 0
        for _ in range(10):
            instance.get_runs(limit=1)
            instance.get_asset_keys()
        assert len(opened) - before <= 1  # of the event log
        server.stop()
        server.start()
        assert instance.get_runs(limit=1) is not None
