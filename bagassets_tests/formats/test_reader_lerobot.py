"""`open_dataset` of a LeRobot dataset, written here by its specification: v3.0 with two files of data and of each camera."""

import json
import multiprocessing
import pickle
import subprocess
import sys

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bagassets import open_dataset
from bagassets.base.errors import DatasetError

FPS = 20
LENGTHS = (12, 7, 9)
FILES = ((0, 1), (2,))  # episodes in each file
CAMERAS = {"observation.images.top": (48, 64), "observation.images.wrist": (32, 32)}


def shade(camera, index):
    """The level of all pixels of a frame: no two near ones are alike."""
    return 16 + (index * 37 + 90 * (camera == "observation.images.wrist")) % 220


def state(index):
    return [index + 0.5, -index]


def write_video(path, camera, indices):
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = CAMERAS[camera]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FPS, options={"crf": "1", "g": "4", "bf": "0"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for index in indices:
            image = np.full((height, width, 3), shade(camera, index), np.uint8)
            image[:, : width // 2, 0] = 200  # red on the left
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("lerobot") / "v3.0"
    for folder in ("meta/episodes/chunk-000", "data/chunk-000"):
        (root / folder).mkdir(parents=True)
    features = {
        "observation.state": {"dtype": "float32", "shape": [2], "names": ["a", "b"]},
        "gripper": {"dtype": "float32", "shape": [1], "names": ["gripper"]},
        **{
            name: {"dtype": "video", "shape": [*size, 3], "names": ["height", "width", "channels"]}
            for name, size in CAMERAS.items()
        },
        **{
            name: {"dtype": "int64", "shape": [1], "names": None}
            for name in ("index", "episode_index", "frame_index", "task_index")
        },
    }
    info = {
        "codebase_version": "v3.0", "fps": FPS, "features": features, "splits": {"train": "0:2", "val": "2:3"},
        "total_episodes": 3, "total_frames": sum(LENGTHS), "chunks_size": 1000,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    }  # fmt: skip
    (root / "meta/info.json").write_text(json.dumps(info))
    starts = np.concatenate([[0], np.cumsum(LENGTHS)]).tolist()
    rows = []
    for file, episodes in enumerate(FILES):
        indices = list(range(starts[episodes[0]], starts[episodes[-1] + 1]))
        owner = [next(e for e in episodes if starts[e] <= i < starts[e + 1]) for i in indices]
        table = {
            "observation.state": pa.array([state(i) for i in indices], pa.list_(pa.float32(), 2)),
            "gripper": pa.array([i / 4 for i in indices], pa.float32()),
            "index": indices,
            "episode_index": owner,
            "frame_index": [i - starts[e] for i, e in zip(indices, owner, strict=True)],
            "task_index": [0] * len(indices),
        }
        pq.write_table(pa.table(table), root / f"data/chunk-000/file-{file:03d}.parquet", row_group_size=5)
        for camera in CAMERAS:
            write_video(root / f"videos/{camera}/chunk-000/file-{file:03d}.mp4", camera, indices)
        for episode in episodes:
            row = {
                "episode_index": episode, "tasks": [f"task {episode}"], "length": LENGTHS[episode],
                "dataset_from_index": starts[episode], "dataset_to_index": starts[episode + 1],
                "data/chunk_index": 0, "data/file_index": file, "stats/gripper/min": [0.0],
            }  # fmt: skip
            for camera in CAMERAS:
                row |= {f"videos/{camera}/chunk_index": 0, f"videos/{camera}/file_index": file}
                row[f"videos/{camera}/from_timestamp"] = (starts[episode] - starts[episodes[0]]) / FPS
            rows.append(row)
    pq.write_table(pa.Table.from_pylist(rows), root / "meta/episodes/chunk-000/file-000.parquet")
    return root


def check(sample, index):
    np.testing.assert_array_equal(sample.values["observation.state"], np.array(state(index), np.float32))
    np.testing.assert_array_equal(sample.values["gripper"], [index / 4])
    for camera, (height, width) in CAMERAS.items():
        image = sample.image(camera)
        assert image.shape == (height, width, 3)
        right = image[4:-4, width // 2 + 4 : -4]
        assert np.abs(right.astype(int) - shade(camera, index)).max() <= 3
        red, _, blue = image[4:-4, 4 : width // 2 - 4].reshape(-1, 3).mean(axis=0)
        assert abs(red - 200) < 5
        assert abs(blue - shade(camera, index)) < 5


def test_frames_in_any_order(root):
    dataset = open_dataset(root.parent)
    assert len(dataset) == sum(LENGTHS)
    assert dataset.channels == tuple(CAMERAS)
    for index, sample in enumerate(dataset):
        check(sample, index)
    for index in (27, 0, 11, 12, 5, 19, 18, 4, 26):
        check(open_dataset(root)[index], index)
        check(dataset[index], index)
    assert set(dataset[0].values) == {"observation.state", "gripper"}


def test_episodes_are_scenes(root):
    dataset = open_dataset(root)
    assert [(scene.name, scene.description, len(scene)) for scene in dataset.scenes] == [
        ("episode_000000", "task 0", 12),
        ("episode_000001", "task 1", 7),
        ("episode_000002", "task 2", 9),
    ]
    assert dataset.splits == {"train": ("episode_000000", "episode_000001"), "val": ("episode_000002",)}
    sample = dataset.scene("episode_000001")[3]
    assert (sample.index, sample.token, sample.stamp_ns) == (15, "episode_000001/3", 150_000_000)
    assert dataset.sample("episode_000002/0").index == 19
    check(sample, 15)


def test_what_the_format_lacks_is_said(root):
    sample = open_dataset(root)[0]
    for ask in (sample.global_SE3_ego, sample.ego_SE3_sensor, sample.intrinsics):
        with pytest.raises(DatasetError, match="LeRobot dataset has no"):
            ask("observation.images.top")
    assert len(sample.boxes) == 0
    assert sample.sweeps("observation.images.top", 3) == []


def test_samples_go_to_other_processes(root):
    sample = open_dataset(root)[20]
    check(pickle.loads(pickle.dumps(sample)), 20)
    code = (
        "import pickle, sys; print(pickle.load(sys.stdin.buffer).image('observation.images.top')[10, 50, 1])"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], input=pickle.dumps(sample), capture_output=True, check=True
    )
    assert abs(int(run.stdout) - shade("observation.images.top", 20)) <= 3


def test_a_process_that_was_forked_reads_on(root):
    dataset = open_dataset(root)
    check(dataset[0], 0)
    child = multiprocessing.get_context("fork").Process(target=check, args=(dataset[20], 20))
    child.start()
    child.join(120)
    hangs = child.is_alive()
    child.kill()
    assert (hangs, child.exitcode) == (False, 0)


@pytest.mark.parametrize(
    ("damage", "error"),
    [
        (lambda root: (root / "videos/observation.images.top/chunk-000/file-000.mp4").unlink(), "is missing"),
        (lambda root: (root / "videos/observation.images.top/chunk-000/file-000.mp4").write_bytes(b"x" * 99), "cannot be opened"),
        (lambda root: (root / "data/chunk-000/file-000.parquet").write_bytes(b"x" * 99), "cannot be read"),
        (lambda root: (root / "meta/info.json").write_text("{"), "cannot be read"),
        (lambda root: (root / "meta/info.json").write_text('{"codebase_version": "v2.1", "fps": 1, "features": {}}'), "version v2.1"),
    ],
)  # fmt: skip
def test_damage_is_named(root, tmp_path, damage, error):
    copy = tmp_path / "v3.0"
    subprocess.run(["cp", "-r", str(root), str(copy)], check=True)
    damage(copy)

    def read():
        sample = open_dataset(copy)[0]
        return sample.values, sample.image("observation.images.top")

    with pytest.raises(DatasetError, match=error):
        read()


def test_without_pyav_it_says_what_to_install(root):
    code = (
        "import sys; sys.modules['av'] = None\n"
        "from bagassets import open_dataset\n"
        f"sample = open_dataset({str(root)!r})[0]\n"
        "print(sample.values['gripper'])\n"
        "sample.image('observation.images.top')"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.stdout == "[0.]\n"
    assert "pip install 'bagassets[video]'" in run.stderr
