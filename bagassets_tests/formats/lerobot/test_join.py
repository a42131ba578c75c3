"""The joined dataset against the specification of LeRobot v3.0, read with pyarrow and PyAV alone."""

import json
from fractions import Fraction

import av
import numpy as np
import pyarrow.parquet as pq
import pytest

from bagassets.formats.lerobot import frames
from bagassets.formats.lerobot import join as joining
from bagassets.formats.lerobot.groups import Limits
from bagassets_tests.arm_recordings import (
    RECIPE,
    join,
    joints_at,
    make_project,
    parts_of,
    write_arm,
)
from bagassets_tests.painted_numbers import number_in

TWO = (
    RECIPE.replace(
        "      CAM_WRIST: ",
        "      CAM_TOP: {modality: camera, topic: /wrist, undistort: false, quality: 60, output: jpeg}\n      CAM_WRIST: ",
    ).replace(
        "    observation.images.wrist",
        "    observation.images.top: {camera: CAM_TOP}\n    observation.images.wrist",
    )
    + "  episodes: {max_length_s: 1.0}\n"
)
CAMERAS = ("observation.images.top", "observation.images.wrist")
SECONDS = {"a": 2.0, "b": 3.0, "c": 1.0}
FPS = 30


class Dataset:
    """A dataset on disk as the specification says where things are."""

    def __init__(self, root):
        self.root = root
        self.info = json.loads((root / "meta/info.json").read_text())
        self.stats = json.loads((root / "meta/stats.json").read_text())
        self.episodes = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
        tables = [
            pq.read_table(path, partitioning=None) for path in sorted((root / "data").glob("*/*.parquet"))
        ]
        self.rows = [row for table in tables for row in table.to_pylist()]
        self.schema = tables[0].schema

    def video(self, episode, key):
        return self.root / self.info["video_path"].format(
            video_key=key,
            chunk_index=episode[f"videos/{key}/chunk_index"],
            file_index=episode[f"videos/{key}/file_index"],
        )

    def numbers(self, episode, key):
        """The numbers that the frames of an episode show, sought by its timestamps."""
        first = round(episode[f"videos/{key}/from_timestamp"] * FPS)
        with av.open(str(self.video(episode, key))) as container:
            frames = [number_in(frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]
        return frames[first : first + episode["length"]]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("joined")
    for number, (name, seconds) in enumerate(SECONDS.items()):
        write_arm(folder, name, seconds=seconds, first=1000 * (number + 1))
    recipe = make_project(folder, TWO)
    parts, _ = parts_of(recipe)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(joining, "_USUAL_S", 2)  # several files
        patched.setattr(joining, "_USUAL_DATA", 2000)
        join(recipe, parts)
    return Dataset(recipe.lerobot.output / "v3.0")


class TestEpisodes:
    def test_numbers_are_dense_and_lengths_add_up(self, dataset):
        first = 0
        for index, episode in enumerate(dataset.episodes):
            assert episode["episode_index"] == index
            assert (episode["dataset_from_index"], episode["dataset_to_index"]) == (
                first,
                first + episode["length"],
            )
            first += episode["length"]
        assert first == dataset.info["total_frames"] == len(dataset.rows)
        assert dataset.info["total_episodes"] == len(dataset.episodes) == 2 + 3 + 1
        assert dataset.info["splits"] == {"train": "0:6"}

    def test_every_image_is_found_by_its_pointer_and_timestamp(self, dataset):
        shown = {key: [dataset.numbers(one, key) for one in dataset.episodes] for key in CAMERAS}
        truth = [
            1000 * (n + 1) + frame
            for n, s in enumerate(SECONDS.values())
            for frame in range(int(s * FPS) - 1)
        ]
        for key in CAMERAS:
            assert [number for numbers in shown[key] for number in numbers] == truth

    def test_from_timestamp_is_of_a_whole_number_of_frames(self, dataset):
        for key in CAMERAS:
            before = {}
            for episode in dataset.episodes:
                file = dataset.video(episode, key)
                frames = before.get(file, 0)
                assert episode[f"videos/{key}/from_timestamp"] == frames / FPS
                before[file] = frames + episode["length"]
                assert episode[f"videos/{key}/to_timestamp"] == before[file] / FPS
            for file, frames in before.items():
                with av.open(str(file)) as container:
                    times = [frame.pts * frame.time_base for frame in container.decode(video=0)]
                assert times == [Fraction(n, FPS) for n in range(frames)]

    def test_each_camera_has_pointers_of_its_own(self, dataset):
        """Files end by size, too, and the cameras differ in that."""
        places = {key: [dataset.video(one, key).name for one in dataset.episodes] for key in CAMERAS}
        assert len(set(places[CAMERAS[0]])) > 1
        data = [(one["data/chunk_index"], one["data/file_index"]) for one in dataset.episodes]
        assert len(set(data)) > 1

    def test_no_statistic_is_missing(self, dataset):
        for feature, one in dataset.info["features"].items():
            for what in ("min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"):
                values = [episode[f"stats/{feature}/{what}"] for episode in dataset.episodes]
                shape = (
                    (1,) if what == "count" else (3, 1, 1) if one["dtype"] == "video" else tuple(one["shape"])
                )
                assert all(np.shape(value) == shape for value in values), (feature, what)
                assert np.shape(dataset.stats[feature][what]) == shape, (feature, what)


class TestRows:
    def test_columns_are_those_of_the_features(self, dataset):
        numeric = {name for name, one in dataset.info["features"].items() if one["dtype"] != "video"}
        assert set(dataset.schema.names) == numeric
        assert str(dataset.schema.field("timestamp").type) == "float"
        assert str(dataset.schema.field("index").type) == "int64"

    def test_they_count_and_point_to_their_episode(self, dataset):
        assert [row["index"] for row in dataset.rows] == list(range(len(dataset.rows)))
        for episode in dataset.episodes:
            rows = dataset.rows[episode["dataset_from_index"] : episode["dataset_to_index"]]
            assert [row["frame_index"] for row in rows] == list(range(episode["length"]))
            assert {row["episode_index"] for row in rows} == {episode["episode_index"]}
            assert [row["timestamp"] for row in rows] == [
                float(np.float32(n / FPS)) for n in range(len(rows))
            ]

    def test_they_have_the_values_of_their_times(self, dataset):
        times = np.concatenate([np.arange(int(seconds * FPS) - 1) / FPS for seconds in SECONDS.values()])
        truth = np.stack([joints_at(time) for time in times])
        assert np.array([row["observation.state"] for row in dataset.rows]) == pytest.approx(truth, abs=2e-4)

    def test_statistics_are_those_of_all_rows(self, dataset):
        for feature, one in dataset.info["features"].items():
            if one["dtype"] == "video":
                continue
            values = np.array([row[feature] for row in dataset.rows], float).reshape(len(dataset.rows), -1)
            found = dataset.stats[feature]
            assert found["mean"] == pytest.approx(values.mean(axis=0), abs=1e-9), feature
            assert found["std"] == pytest.approx(values.std(axis=0), abs=1e-9), feature
            for name, share in (("q01", 0.01), ("q50", 0.5), ("q99", 0.99)):
                assert found[name] == pytest.approx(np.quantile(values, share, axis=0), abs=1e-9), feature


class TestMetadata:
    def test_tasks_are_an_index_called_task_in_the_order_of_their_numbers(self, dataset):
        table = pq.read_table(dataset.root / "meta/tasks.parquet")
        pandas = json.loads(table.schema.metadata[b"pandas"])
        assert pandas["index_columns"] == ["task"]
        assert table.column("task_index").to_pylist() == list(range(table.num_rows))
        assert table.column("task").to_pylist() == ["Lift the cube."]
        assert {row["task_index"] for row in dataset.rows} == {0}

    def test_info(self, dataset):
        info = dataset.info
        assert (info["codebase_version"], info["fps"], info["robot_type"]) == ("v3.0", 30, "arm")
        for key in CAMERAS:
            feature = info["features"][key]
            assert feature["dtype"] == "video"
            assert feature["shape"] == [64, 64, 3]
            assert feature["names"][-1] == "channels"
        assert info["features"]["action"] == {"dtype": "float32", "shape": [2], "names": ["elbow", "wrist"]}

    def test_where_episodes_are_from(self, dataset):
        sources = json.loads((dataset.root / "meta/bagassets.json").read_text())["episodes"]
        assert [(one["recording"], one["number"]) for one in sources] == [
            ("a.mcap", 0), ("a.mcap", 1), ("b.mcap", 0), ("b.mcap", 1), ("b.mcap", 2), ("c.mcap", 0)
        ]  # fmt: skip


class TestLimits:
    def test_no_file_reaches_the_time_from_which_readers_cannot_tell_frames_apart(self):
        """Times are compared as float32 within 0.1 ms."""
        limit = joining.MOST_S
        late = np.float32(limit - 1 / FPS)
        assert abs(float(late) - (limit - 1 / FPS)) < 1e-4 / 2
        assert np.spacing(np.float32(limit)) > 1e-4

    def test_a_long_episode_is_refused_or_cut(self, tmp_path, monkeypatch):
        monkeypatch.setattr(frames, "MOST_S", 2)
        write_arm(tmp_path, "long", seconds=3.0)
        recipe = make_project(tmp_path)
        _, facts = parts_of(recipe)
        assert [one["why"] for one in facts["long.mcap"]["left_out"]] == [
            "it is 3 s long, and a video ends before 2 s; set lerobot.episodes.max_length_s"
        ]

    def test_limits_of_a_file_hold_for_the_joined_one(self, dataset):
        assert isinstance(Limits(1, 1, 1, 1), Limits)
        for key in CAMERAS:
            lengths = {}
            for episode in dataset.episodes:
                lengths[dataset.video(episode, key)] = episode[f"videos/{key}/to_timestamp"]
            assert max(lengths.values()) < joining.MOST_S
