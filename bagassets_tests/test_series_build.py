"""Drives in several files, built: the truth is the same drive in one file."""

import pytest

from bagassets.propose.project import write_project
from bagassets_tests.in_process import QUICK, build
from bagassets_tests.series import write_part, write_parts

pytestmark = pytest.mark.xdist_group("series_build")


def project(folder, text=QUICK):
    write_project(folder, text.format(name="test", root="bags"))
    return folder / "recipe.yaml"


def files_of(folder):
    root = folder / "dataset" / "nuscenes"
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in root.rglob("*")
        if path.is_file() and path.name != "dataset.lock.json" and not path.name.startswith(".")
    }


@pytest.mark.parametrize(
    ("suffix", "cuts_s"), [(".bag", (0.7, 1.33)), (".mcap", (0.4, 0.81, 1.0, 1.5)), (".db3", (0.5, 1.2))]
)
def test_a_cut_drive_gives_the_dataset_of_the_whole_one_byte_for_byte(tmp_path, monkeypatch, suffix, cuts_s):
    write_part(tmp_path / "whole" / "bags" / f"drive{suffix}", duration_s=2.0)
    write_parts(tmp_path / "cut" / "bags" / f"drive{suffix}", cuts_s, 2.0)
    for name in ("whole", "cut"):
        report, _ = build(project(tmp_path / name), monkeypatch)
        assert report.succeeded
        assert list(report.outcomes) == [f"drive{suffix}"]
    whole, cut = (files_of(tmp_path / name) for name in ("whole", "cut"))
    assert len(whole) > 20
    assert cut == whole
