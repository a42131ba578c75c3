"""The memory of the last plan: what it keeps comes back, what is damaged is forgotten, and nothing changed goes unseen."""

import os
import sqlite3
from dataclasses import replace

import pytest

from bagassets.bags.model import Found
from bagassets.engine.plan_memo import (
    PlanMemo,
    Remembered,
    artifact_signature,
    artifacts_of,
    fingerprint,
    signatures,
)
from bagassets.engine.plan_model import AssetState, BagPlan
from bagassets.store.action import Action
from bagassets.store.store import Store


def plan_of(key, **states):
    assets = {"bag": AssetState("fresh", "as it was", "b" * 64)}
    assets |= {
        name: AssetState(state, f"why {name}", name * 3 if state == "fresh" else None)
        for name, state in states.items()
    }
    return BagPlan(key, assets, "ros2", {"inventory": "i" * 64}, ("c1", "c2"))


ONE = Remembered("f1", plan_of("a.bag", inventory="fresh", frames="skipped"), "s1")
OTHER = Remembered("f2", plan_of("ünder/b.bag", inventory="fresh"), "s2")


class TestMemo:
    def test_what_is_kept_comes_back(self, tmp_path):
        PlanMemo(tmp_path / "state").save([ONE, OTHER], [])
        assert PlanMemo(tmp_path / "state").load() == {"a.bag": ONE, "ünder/b.bag": OTHER}

    def test_the_newest_counts_and_what_is_gone_is_forgotten(self, tmp_path):
        memo = PlanMemo(tmp_path)
        memo.save([ONE, OTHER], [])
        newer = replace(ONE, fingerprint="f3")
        memo.save([newer], ["ünder/b.bag", "never.bag"])
        assert memo.load() == {"a.bag": newer}
        memo.save([], ["a.bag"])
        assert memo.load() == {}

    def test_with_nothing_to_keep_nothing_is_written(self, tmp_path):
        PlanMemo(tmp_path / "state").save([], [])
        assert not (tmp_path / "state").exists()
        assert PlanMemo(tmp_path / "state").load() == {}

    @pytest.mark.parametrize("damage", [b"", b"no database at all, but long enough to be one " * 30])
    def test_a_damaged_one_is_forgotten_and_made_again(self, tmp_path, damage):
        (tmp_path / "plan.sqlite").write_bytes(damage)
        memo = PlanMemo(tmp_path)
        assert memo.load() == {}
        memo.save([ONE], [])
        assert memo.load() == {"a.bag": ONE}

    @pytest.mark.parametrize("body", ["", "[]", "[1]", "{", '[{"bag": 3}, "ros1", {}, [], ""]'])
    def test_an_entry_that_says_something_else_is_forgotten(self, tmp_path, body):
        PlanMemo(tmp_path).save([ONE], [])
        with sqlite3.connect(tmp_path / "plan.sqlite") as connection:
            connection.execute("UPDATE bags SET body = ?", (body,))
        connection.close()
        assert PlanMemo(tmp_path).load() == {}

    def test_a_folder_that_cannot_be_written_is_no_error(self, tmp_path):
        (tmp_path / "file").write_bytes(b"")
        PlanMemo(tmp_path / "file" / "state").save([ONE], [])
        assert PlanMemo(tmp_path / "file" / "state").load() == {}

    def test_a_full_disk_keeps_what_was_known(self, tmp_path, monkeypatch):
        memo = PlanMemo(tmp_path)
        memo.save([ONE], [])

        def full(*_args):
            raise sqlite3.OperationalError("database or disk is full")

        monkeypatch.setattr(memo, "_write", full)
        memo.save([OTHER], [])
        assert memo.load() == {"a.bag": ONE}


class TestFingerprint:
    @pytest.fixture
    def found(self, tmp_path):
        (tmp_path / "a.bag").write_bytes(b"content")
        (tmp_path / "a.json").write_bytes(b"labels")
        return Found("a.bag", "a.bag", tmp_path / "a.bag", "ros1", (tmp_path / "a.bag",), 7, 0)

    def of(self, found, stamp="s", ids=None, beside=()):
        return fingerprint(stamp, found, {"inventory": 3} if ids is None else ids, beside)

    def test_all_that_counts_is_in_it(self, found, tmp_path):
        labels = (tmp_path / "a.json",)
        prints = {
            self.of(found), self.of(found, "t"), self.of(found, ids={"inventory": 4}), self.of(found, ids={}),
            self.of(found, beside=labels), self.of(replace(found, relative="b.bag")), self.of(replace(found, format="mcap")),
        }  # fmt: skip
        assert len(prints) == 7
        before = self.of(found, beside=labels)
        (tmp_path / "a.json").write_bytes(b"other labels")
        assert self.of(found, beside=labels) != before
        assert self.of(found) in prints

    def test_any_change_of_a_file_changes_it(self, found, tmp_path):
        path, prints = tmp_path / "a.bag", [self.of(found)]
        stat = path.stat()
        path.write_bytes(b"longer content")
        prints.append(self.of(found))
        path.write_bytes(b"c0ntent")
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        prints.append(self.of(found))  # size and time as before, another time of change
        os.utime(path, ns=(1, 2))
        prints.append(self.of(found))
        assert len(set(prints)) == 4
        assert self.of(found) == prints[-1]


class TestSignatures:
    @pytest.fixture
    def artifact(self, tmp_path):
        return (
            Store(tmp_path / "store")
            .run(Action("a", 1), lambda out: (out.write("one", b"1"), out.write("two", b"2"), {})[2])
            .artifact
        )

    def test_files_that_come_or_go_are_seen(self, artifact):
        before = artifact_signature(str(artifact.folder))
        assert artifact_signature(str(artifact.folder)) == before
        artifact.path("one").unlink()
        without = artifact_signature(str(artifact.folder))
        artifact.path("one").write_bytes(b"1")
        assert len({before, without, artifact_signature(str(artifact.folder))}) == 3

    def test_another_manifest_is_seen(self, artifact):
        before = artifact_signature(str(artifact.folder))
        (artifact.folder / "manifest.json").write_bytes(b"{}")
        assert artifact_signature(str(artifact.folder)) != before
        (artifact.folder / "manifest.json").unlink()
        assert artifact_signature(str(artifact.folder)) is None

    def test_those_of_a_recording(self, tmp_path, artifact):
        store = Store(tmp_path / "store")
        plan = BagPlan(
            "a.bag",
            {"bag": AssetState("fresh", "", "b" * 64), "frames": AssetState("fresh", "", artifact.digest)},
        )
        before = signatures(store, plan)
        assert signatures(store, plan) == before
        artifact.path("one").unlink()
        assert signatures(store, plan) not in {before, None}
        assert signatures(store, replace(plan, channels=("0" * 64,))) is None

    def test_a_recording_rests_on_its_assets_and_the_channels(self):
        assert artifacts_of(ONE.plan) == ["inventory" * 3, "c1", "c2"]
