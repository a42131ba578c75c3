"""Which recordings hold the same data, from the images and clouds that were made of them."""

import json
import shutil

import pytest

from bagassets.base.cache import Cache
from bagassets.formats.same_data import same_data
from bagassets.store.action import Action
from bagassets.store.store import Store
from bagassets_tests.small_drive import START_NS

ALIKE = (
    "{} hold the same data in different files, so each is in the dataset, perhaps in different splits; keep one, and name the "
    "others in bags.exclude or remove them."
)
PARTS = (
    "{} of what {} holds, so this is in the dataset twice, perhaps in different splits; keep the whole or the parts, and name "
    "the others in bags.exclude or remove them."
)


class Recordings:
    """Recordings of cameras and a lidar, with a file every half a second each, as they stand in a store."""

    def __init__(self, folder):
        self.store, self.state, self.versions = Store(folder / "store"), folder / "state", {}

    def put(self, name, files):
        pending = self.store.begin(Action(name, 1))
        for path, content in files.items():
            pending.out.write(path, content)
        return pending.commit({}).artifact.digest

    def add(
        self,
        key,
        begin_s,
        end_s,
        robot="red",
        *,
        cameras=("FRONT",),
        black=(),
        own_from_s=1e9,
        start_ns=START_NS,
    ):
        def artifact(channel):
            files = {"index.parquet": f"{key} {channel}".encode()}
            for half in range(int(begin_s * 2), int(end_s * 2)):
                of = key if half / 2 >= own_from_s else robot
                seen = "nothing" if channel in black else f"{channel} {of} {half}"
                files[f"{start_ns + half * 500_000_000}.jpg"] = seen.encode()
            return {"artifact": self.put(f"{key} {channel}", files)}

        self.versions[key] = [
            self.put(
                f"{key} {channels}",
                {
                    "channels.json": json.dumps(
                        dict(zip(channels, map(artifact, channels), strict=True))
                    ).encode()
                },
            )
            for channels in (cameras, ("LIDAR",))
        ]

    @property
    def told(self):
        return list(same_data(self.versions, self.store, self.state))


@pytest.fixture
def recordings(tmp_path):
    (tmp_path / "state").mkdir()
    return Recordings(tmp_path)


@pytest.mark.parametrize(("begin_s", "end_s"), [(0, 60), (0, 8), (3, 14.5), (31.5, 60), (20, 30)])
def test_an_excerpt_of_ten_seconds_or_more_is_told_wherever_it_begins(begin_s, end_s, recordings):
    recordings.add("whole", 0, 61)
    recordings.add("part", begin_s, end_s)
    recordings.add("blue", 0, 61, "blue")
    assert recordings.told == [PARTS.format("part holds a part", "whole")]


def test_a_merge_beside_what_it_was_merged_of_is_told_once(recordings):
    recordings.add("all", 0, 60)
    for begin_s in range(0, 60, 10):
        recordings.add(f"minute_{begin_s:02}", begin_s, begin_s + 10)
    names = "minute_00, minute_10, minute_20 and 3 more"
    assert recordings.told == [PARTS.format(f"{names} hold parts", "all")]


def test_of_two_that_share_most_the_shorter_is_the_part(recordings):
    recordings.add("a", 10, 50)
    recordings.add("b", 0, 45)
    assert recordings.told == [PARTS.format("a holds a part", "b")]


def test_an_excerpt_without_some_cameras_is_told(recordings):
    recordings.add("whole", 0, 60, cameras=("BACK", "FRONT"))
    recordings.add("part", 12, 40)
    assert recordings.told == [PARTS.format("part holds a part", "whole")]


def test_what_shares_less_than_half_is_not_told(recordings):
    recordings.add("morning", 0, 60)
    recordings.add("noon", 40, 120)
    assert recordings.told == []


def test_robots_with_the_same_stamps_are_not_told(recordings):
    """Cameras that a clock triggers have them."""
    for robot in ("red", "blue", "green"):
        recordings.add(robot, 0, 30, robot)
    assert recordings.told == []


def test_cameras_that_see_nothing_are_no_reason(recordings):
    """As where a simulator renders no images, or lenses are covered."""
    for key, robot in (("run_1", "red"), ("run_2", "blue"), ("whole", "green"), ("part", "green")):
        seconds = (20, 40) if key == "part" else (0, 60)
        recordings.add(key, *seconds, robot, black=("BACK", "FRONT"), cameras=("BACK", "FRONT"), start_ns=0)
    assert recordings.told == [PARTS.format("part holds a part", "whole")]


def test_simulated_recordings_that_begin_alike_are_not_told(recordings):
    for number in range(5):
        recordings.add(f"run_{number}", 0, 30, "sim", own_from_s=2, start_ns=0)
    assert recordings.told == []


def test_copies_are_one_sentence_and_their_parts_another(recordings):
    for key in ("a.bag", "a.mcap"):
        recordings.add(key, 0, 60)
    recordings.add("part", 20, 40)
    assert recordings.told == [ALIKE.format("a.bag, a.mcap"), PARTS.format("part holds a part", "a.bag")]


def test_what_was_found_once_is_not_read_again(recordings):
    recordings.add("whole", 0, 60)
    recordings.add("part", 20, 40)
    told = recordings.told
    assert told
    shutil.rmtree(recordings.store.root)
    assert recordings.told == told
    recordings.add("new", 20, 40)
    del recordings.versions["whole"]
    assert recordings.told == [ALIKE.format("part, new")]
    assert (
        len(Cache(recordings.state).keys("marks 3")) == 2
    )  # one of each two versions, and not of what is gone


def test_recordings_without_artifacts_are_left_out(recordings):
    recordings.add("whole", 0, 60)
    recordings.versions |= {"none": [], "gone": ["ab" * 32], "gone_too": ["ab" * 32]}
    assert recordings.told == []
