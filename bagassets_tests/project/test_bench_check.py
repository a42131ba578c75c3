"""`make bench-check` counts how many commits to the product are newer than a result."""

import json
import subprocess

import pytest

from benchmarks.check import ages_table, main

pytestmark = pytest.mark.once


@pytest.fixture
def checkout(tmp_path):
    def commit(*files):
        for file in files:
            path = tmp_path / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(path.read_text() + "{}" if path.exists() else "{}")
            git("add", file)
        git("commit", "-m", "a change")

    def git(*words):
        who = ("-c", "user.name=x", "-c", "user.email=x@example.org")
        subprocess.run(["git", *who, "-C", tmp_path, *words], check=True, capture_output=True)

    git("init")
    commit("bagassets/one.py", "benchmarks/results/old.json")
    commit("bagassets/one.py")
    commit("docs/page.md")
    commit("bagassets/one.py", "bagassets/two.py")
    commit("benchmarks/results/new.json")
    return tmp_path


def test_commits_to_the_product_are_counted(checkout, capsys):
    assert main([], checkout) == 0
    found = json.loads((checkout / "benchmarks/results/measured.json").read_text())
    assert [(one["result"], one["commits_since"]) for one in found["results"]] == [("old", 2), ("new", 0)]
    assert ages_table(found) in capsys.readouterr().out
    assert main([], checkout) == 0, "its own file is no result"


def test_results_that_are_too_old_are_refused_by_name(checkout, capsys):
    assert main(["--most", "1"], checkout) == 1
    assert "more than 1 commits old: old; measure again" in capsys.readouterr().err


def test_without_history_there_is_one_sentence(tmp_path):
    with pytest.raises(SystemExit, match="no age without git and its history"):
        main([], tmp_path)
