"""`bagassets digest`, as users call it."""

import json
import os

import pytest
from blake3 import blake3
from click.testing import CliRunner

from bagassets.cli.main import root
from bagassets.recordings.digest_record import DigestIndex, read_attribute
from bagassets_tests.recordings.test_digest import rewrite_in_place

pytestmark = pytest.mark.once

RECIPE = """
name: test
bags: {root: bags}
rigs:
  - name: car
    ego_pose: {source: odometry, topic: /odom}
    channels: {CAM_FRONT: {modality: camera, topic: /cam}}
"""


def hex_of(content):
    return blake3(content).hexdigest()


@pytest.fixture
def bags(tmp_path, monkeypatch):
    (tmp_path / "bags" / "sub").mkdir(parents=True)
    (tmp_path / "bags" / "a.bag").write_bytes(b"a")
    (tmp_path / "bags" / "sub" / "b.mcap").write_bytes(b"b")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "bags"


@pytest.fixture
def no_attributes(monkeypatch):
    def refuse(*args):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(os, "setxattr", refuse)
    monkeypatch.setattr(os, "getxattr", refuse)


def run(*args, status=0):
    result = CliRunner().invoke(root, ["digest", *map(str, args)], standalone_mode=False)
    assert result.exception is None, result.exception
    assert (result.return_value or 0) == status, result.output
    return result


def test_digests_are_printed_like_b3sum_and_stored(bags):
    result = run(bags / "a.bag", bags / "sub" / "b.mcap")
    assert result.stdout == f"{hex_of(b'a')}  {bags}/a.bag\n{hex_of(b'b')}  {bags}/sub/b.mcap\n"
    assert "2 recordings, 2 B" in result.stderr
    path = bags / "a.bag"
    assert read_attribute(path, path.stat()) == hex_of(b"a")


def test_a_folder_stands_for_the_recordings_below_it(bags):
    made = json.loads(run(bags, "--json").stdout)
    assert [entry["digest"] for entry in made["recordings"]] == [hex_of(b"a"), hex_of(b"b")]
    assert [entry["hashed_bytes"] for entry in made["recordings"]] == [1, 1]
    again = json.loads(run(bags, "--json").stdout)
    assert [entry["hashed_bytes"] for entry in again["recordings"]] == [0, 0]
    assert again["recordings"][0]["files"] == [{"name": "a.bag", "digest": hex_of(b"a"), "kept": "attribute"}]


def test_without_a_bag_the_recipe_here_says_which(bags, tmp_path):
    (tmp_path / "recipe.yaml").write_text(RECIPE.replace("root: bags", "root: bags, exclude: [sub/**]"))
    made = json.loads(run("--json").stdout)
    assert [entry["path"] for entry in made["recordings"]] == [str(bags / "a.bag")]


def test_without_bag_and_recipe_it_says_what_to_name(bags):
    result = CliRunner().invoke(root, ["digest"])
    assert result.exit_code == 2
    assert "name a BAG, or a recipe with --recipe" in result.output


def test_where_files_take_no_attributes_the_index_of_the_recipe_does(bags, tmp_path, no_attributes):
    alone = run(bags / "a.bag")
    assert "1 digest could not be stored" in alone.stderr
    (tmp_path / "recipe.yaml").write_text(RECIPE)
    made = json.loads(run(bags / "a.bag", "--json").stdout)
    assert made["recordings"][0]["files"][0]["kept"] == "index"
    path = bags / "a.bag"
    assert DigestIndex(tmp_path / ".bagassets").get(path, path.stat()) == hex_of(b"a")


def test_one_unreadable_recording_stops_no_other(bags):
    result = run(bags / "no.bag", bags, "--json", status=1)
    made = json.loads(result.stdout)
    assert len(made["recordings"]) == 2
    assert made["errors"] == [f"{bags}/no.bag: no such file or folder."]
    assert "no.bag: no such file" in result.stderr


def test_an_empty_folder_is_reported(tmp_path):
    (tmp_path / "none").mkdir()
    assert "no recording found; expected .bag" in run(tmp_path / "none", status=1).stderr


def test_verify_reports_every_disagreement_and_changes_nothing(bags, tmp_path):
    (tmp_path / "recipe.yaml").write_text(RECIPE)
    run()
    assert "2 recordings, 2 B hashed again: no disagreements." in run("--verify").stderr
    for name, content in (("a.bag", b"A"), ("sub/b.mcap", b"B")):
        rewrite_in_place(bags / name, content)
    for _ in range(2):
        result = run("--verify", "--json", status=3)
        found = [d for entry in json.loads(result.stdout)["recordings"] for d in entry["disagreements"]]
        assert [(d["path"], d["where"], d["recorded"], d["actual"]) for d in found] == [
            (str(bags / "a.bag"), "attribute", hex_of(b"a"), hex_of(b"A")),
            (str(bags / "sub" / "b.mcap"), "attribute", hex_of(b"b"), hex_of(b"B")),
        ]
        assert "edited in place or its disk is failing" in found[0]["message"]
    run("--rehash")
    run("--verify")


def test_verify_reports_an_index_that_is_wrong(bags, tmp_path, no_attributes):
    (tmp_path / "recipe.yaml").write_text(RECIPE)
    path = bags / "a.bag"
    DigestIndex(tmp_path / ".bagassets").put(path, path.stat(), "0" * 64)
    result = run("--verify", status=3)
    assert f"{path}: the digest on record (index, for this size and time) is {'0' * 16}" in result.stdout


def test_verify_does_not_report_records_that_nobody_trusts(bags):
    run(bags)
    (bags / "a.bag").write_bytes(b"longer")
    assert "no disagreements" in run(bags, "--verify").stderr
