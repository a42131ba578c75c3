"""The bytes that each step makes of a small drive are pinned: a change must raise the step's version.

An artifact that is in a store under the same action would otherwise stay there with its old bytes.
If this test fails, either the change of bytes was not meant, or `STEP = Step(name, version, …)` of
the step that is blamed needs a higher version. Then renew the pinned digests:

    python -m bagassets_tests.golden_drive

which refuses while a step changed its bytes and not its version. Digests hold for versions of
libraries; where others are installed, the steps that use them are skipped.
"""

import json
import os
import subprocess
import sys

import pytest

from bagassets_tests.golden_drive import GOLDEN, STEPS, made_digests, record, step_of, unannounced
from bagassets_tests.recording_build import UPSTREAM

# What processors may lack, in the words of numpy (new and old), OpenCV, OpenBLAS and the C library.
OLD_PROCESSOR = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR AVX2 FMA3 AVX512F",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,AVX,FMA3,FP16,SSE4.2,SSE4.1",
    "OPENBLAS_CORETYPE": "Nehalem",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX",
}


@pytest.fixture(scope="module")
def golden():
    return json.loads(GOLDEN.read_text())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("golden") / "drive"


@pytest.fixture(scope="module")
def now(folder):
    return record(made_digests(folder))


def comparable(golden, now):
    """What is made with the libraries that the digests hold for, and from such artifacts only."""
    other = {name for name in STEPS if golden["steps"][name]["libraries"] != now["steps"][name]["libraries"]}
    return {
        name
        for name in now["digests"]
        if step_of(name) not in other and not other & (set(UPSTREAM[step_of(name)]) - {"inventory"})
    }


def test_bytes_change_only_with_the_version_of_their_step(golden, now):
    names = comparable(golden, now)
    blamed = [name for name in unannounced(golden, now) if name in names]
    assert not blamed, f"raise the version of the step, or undo the change: {', '.join(blamed)}"


def test_pinned_digests_are_up_to_date(golden, now):
    names = comparable(golden, now)
    if names != set(now["digests"]):
        pytest.skip("other versions of libraries are installed than the digests hold for")
    assert now == golden, "python -m bagassets_tests.golden_drive"


def test_every_step_of_a_recording_is_pinned(golden):
    assert {step_of(name) for name in golden["digests"]} == set(STEPS)


def test_the_drive_has_something_of_everything(folder, now):
    """A digest of nothing would pin nothing."""
    assert now["digests"]
    summaries = [json.loads(path.read_text())["summary"] for path in folder.rglob("manifest.json")]
    merged = {key: value for summary in summaries for key, value in summary.items()}
    assert (merged["sensors"], merged["cameras"], merged["boxes"], merged["tracks"]) == (4, 2, 36, 2)
    (tables,) = folder.rglob("sample.json")
    assert len(json.loads(tables.read_text())) >= 3
    (boxes,) = folder.rglob("sample_annotation.json")
    rows = json.loads(boxes.read_text())
    assert any(row["num_lidar_pts"] > 0 for row in rows)
    (timeline,) = (path for path in folder.rglob("timeline.jpg") if path.parent.name == "files")
    pictures = json.loads(timeline.with_name("facts.json").read_text())
    assert (len(pictures["pictures"]), pictures["missing"]) == (5, {})


def test_an_older_processor_makes_the_same_bytes(now, tmp_path):
    """Vector instructions round sums and products in another order; nothing that is written may show it."""
    script = (
        "import json, sys, pathlib; from bagassets_tests.golden_drive import made_digests;"
        "print(json.dumps(made_digests(pathlib.Path(sys.argv[1]))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "drive")],
        env={**os.environ, **OLD_PROCESSOR},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout) == now["digests"]


class TestBlame:
    """Which changes are unannounced."""

    def content(self, versions=None, digests=None):
        steps = {name: {"version": 1, "libraries": {}} for name in STEPS}
        for name, number in (versions or {}).items():
            steps[name] = {"version": number, "libraries": {}}
        base = dict.fromkeys(STEPS, "a") | {"frames of CAM": "a"}
        return {"steps": steps, "digests": base | (digests or {})}

    @pytest.mark.parametrize(
        ("versions", "digests", "blamed"),
        [
            ({}, {}, []),
            ({}, {"calibration": "b"}, ["calibration"]),
            ({"calibration": 2}, {"calibration": "b"}, []),
            ({"calibration": 2}, {}, []),
            ({}, {"frames of CAM": "b", "nuscenes_tables": "b"}, ["frames of CAM"]),
            ({"frames": 2}, {"frames of CAM": "b", "nuscenes_tables": "b"}, []),
            ({"inventory": 2}, {"inventory": "b", "ego_poses": "b"}, ["ego_poses"]),
        ],
    )
    def test_what_is_blamed(self, versions, digests, blamed):
        assert unannounced(self.content(), self.content(versions, digests)) == blamed
