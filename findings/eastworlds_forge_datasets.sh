#!/usr/bin/env bash
# eastworlds-forge converts MCAP recordings to LeRobot 2.1, and lowers the rate of any such dataset. Two arms publish on one /joint_states, as they do with a
# joint_state_broadcaster each; another recording is split into 12 files, as rosbag2 splits; and a dataset at 30 Hz, of which each episode first picks up a cup
# and then shelves it, is brought to 10 Hz. Guess: columns of both arms, or an error; pictures of the time of their row; tasks, rewards and statistics of the
# rows that are kept. Seen with eastworlds-forge 0.7.0 on 2026-11-30, which says a word about actions at the lower rate, and none about these:
# - two arms: two columns, named after the arm that spoke first, which jump between both arms from row to row, by whichever spoke last
# - 12 files: read as _0, _1, _10, _11, _2, so the dataset ends with _9, and the picture stands still for 0.2 s, while the arm moves on
# - 30 to 10 Hz: `task_index` is cut off rather than thinned out, so that it is "pick up the cup" to the end of each episode. `next.reward` is in `info.json`,
#   and in no row. The standard deviation of pictures is the mean of those of episodes: of a dark and a bright one it is 0.00, where it is 0.32
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check eastworlds-forge==0.7.0 av==18.1.0 mcap==1.6.0 mcap-ros2-support==0.6.0 \
  numpy==2.4.6 pillow==13.0.0 pyarrow==26.0.1
cd "$folder"
venv/bin/python - <<'PYTHON'
import io
import json
import subprocess
from pathlib import Path

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap_ros2.writer import Writer
from PIL import Image

NEXT = "\n" + "=" * 80 + "\nMSG: "
END = f"{NEXT}std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id{NEXT}builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
JOINTS = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort" + END
PICTURE = "std_msgs/Header header\nstring format\nuint8[] data" + END
FIRST_NS = 1_750_000_000_000_000_000


def forge(*arguments):
    ran = subprocess.run(["venv/bin/forge", "convert", *arguments], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return ran.stderr


def jpeg(level):
    made = io.BytesIO()
    Image.new("RGB", (64, 48), (level,) * 3).save(made, "JPEG")
    return made.getvalue()


def levels(path):
    """Return the brightness of each picture, which is its number in the recording, nearly."""
    with av.open(str(path)) as film:
        return np.array([frame.to_ndarray(format="rgb24").mean() for frame in film.decode(video=0)])


def record(name, files, arms):
    """Write 4 s of three cameras, whose pictures get brighter by 1 each, and of the joints of arms, as an MCAP split into files of equal length."""
    messages = []
    for number in range(120):
        stamp = FIRST_NS + number * 33_333_333
        for camera in ("head_cam", "wrist_left", "wrist_right"):
            messages.append((stamp, f"/cameras/{camera}/image/compressed", {"format": "jpeg", "data": jpeg(number)}))
    for number in range(400):
        for late_ns, (arm, position) in enumerate(arms.items()):
            stamp = FIRST_NS + number * 10_000_000 + late_ns * 5_000_000
            names = [f"{arm}_shoulder", f"{arm}_elbow"]
            messages.append((stamp, "/joint_states", {"name": names, "position": [position(number)] * 2, "velocity": [], "effort": []}))
    messages.sort(key=lambda message: message[0])
    Path(name, "episode").mkdir(parents=True)
    for part in range(files):
        with open(f"{name}/episode/recording_{part}.mcap", "wb") as file:
            writer = Writer(file)
            joints = writer.register_msgdef("sensor_msgs/msg/JointState", JOINTS)
            pictures = writer.register_msgdef("sensor_msgs/msg/CompressedImage", PICTURE)
            for stamp, topic, message in messages:
                if (stamp - FIRST_NS) * files // 4_000_000_000 == part:
                    header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": ""}
                    kind = pictures if "data" in message else joints
                    writer.write_message(topic, kind, {"header": header, **message}, log_time=stamp, publish_time=stamp)
            writer.finish()


def converted(name):
    """Return the states, the names of their columns and the brightness of pictures that the recording becomes."""
    forge("mcap-to-lerobot", name, "-o", f"{name}_dataset", "-j", "1")
    names = json.loads(Path(f"{name}_dataset/meta/info.json").read_text())["features"]["observation.state"]["names"]
    states = np.array(pq.read_table(f"{name}_dataset/data/chunk-000/episode_000000.parquet")["observation.state"].to_pylist())
    return states, names, levels(f"{name}_dataset/videos/chunk-000/observation.images.head_cam/episode_000000.mp4")


record("arms", 1, {"left": lambda number: 0.5, "right": lambda number: -0.5})
states, names, _ = converted("arms")
of_left, of_right = ((states[:, 0] == position).sum() for position in (0.5, -0.5))
print(f"two arms: columns {names}, of which {of_left} rows are of the left arm, {of_right} of the right one")
assert len(names) == 2 and set(states[:, 0]) == {0.5, -0.5} and (np.diff(states[:, 0]) != 0).sum() > 50

record("split", 12, {"arm": lambda number: number / 100})
states, _, seen = converted("split")
apart = np.abs(states[:, 0] * 30 - seen)
print(f"12 files: {len(states)} rows of 120; pictures {np.arange(20, 30)} show {seen[20:30].round().astype(int)}: up to {apart.max() / 30:.2f} s apart from the arm")
assert len(states) == 101 and apart[:18].max() < 2.5 and apart.max() > 4.5
record("whole", 1, {"arm": lambda number: number / 100})
states, _, seen = converted("whole")
assert len(states) == 120 and np.abs(states[:, 0] * 30 - seen).max() < 3

CAMERA = "observation.images.front"
rows = np.arange(120)
for episode, level in enumerate((40, 200)):
    film = Path(f"fast/videos/chunk-000/{CAMERA}/episode_{episode:06d}.mp4")
    film.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(film), "w") as file:
        stream = file.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for row in rows:
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), level, np.uint8), format="rgb24")
            frame.pts = int(row)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    joints = pa.array([[row / 30] for row in rows], pa.list_(pa.float32()))
    columns = {"observation.state": joints, "action": joints, "next.reward": (rows == 119).astype(np.float32), "timestamp": (rows / 30).astype(np.float32)}
    columns |= {"frame_index": rows, "episode_index": np.full(120, episode), "index": rows + 120 * episode, "task_index": (rows >= 60).astype(int)}
    Path("fast/data/chunk-000").mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), f"fast/data/chunk-000/episode_{episode:06d}.parquet")
features = {name: {"dtype": "int64" if "index" in name else "float32", "shape": [1], "names": None} for name in columns}
features[CAMERA] = {"dtype": "video", "shape": [48, 64, 3], "names": ["height", "width", "channel"], "info": {"video.fps": 30, "video.codec": "h264"}}
paths = {"data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"}
paths["video_path"] = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
info = {"codebase_version": "v2.1", "robot_type": "so101", "total_episodes": 2, "total_frames": 240, "total_tasks": 2, "total_videos": 2, "total_chunks": 1}
info |= {"chunks_size": 1000, "fps": 30, "splits": {"train": "0:2"}, **paths, "features": features}
tasks = ["pick up the cup", "put it on the shelf"]
meta = Path("fast/meta")
meta.mkdir()
(meta / "info.json").write_text(json.dumps(info))
(meta / "tasks.jsonl").write_text("".join(json.dumps({"task_index": number, "task": task}) + "\n" for number, task in enumerate(tasks)))
(meta / "episodes.jsonl").write_text("".join(json.dumps({"episode_index": episode, "tasks": tasks, "length": 120}) + "\n" for episode in (0, 1)))

print(forge("resample", "fast", "-o", "slow", "--fps", "10").splitlines()[0])
slow = pq.read_table("slow/data/chunk-000/episode_000000.parquet")
stated = json.loads(Path("slow/meta/info.json").read_text())["features"]
deviation = json.loads(Path("slow/meta/stats.json").read_text())[CAMERA]["std"][0][0][0]
true = np.concatenate([levels(f"slow/videos/chunk-000/{CAMERA}/episode_{episode:06d}.mp4") for episode in (0, 1)]).std() / 255
missing = sorted(set(stated) - set(slow.column_names) - {CAMERA})
last_s, of_tasks = slow["timestamp"][-1].as_py(), np.unique(slow["task_index"].to_numpy())
print(f"30 to 10 Hz: {len(slow)} rows to {last_s:.1f} s, whose tasks are {of_tasks}; {missing} of info.json are in none")
print(f"standard deviation of pictures {deviation:.2f}, of all of them {true:.2f}")
assert len(slow) == 40 and set(slow["task_index"].to_pylist()) == {0} and "next.reward" in stated and "next.reward" not in slow.column_names
assert deviation < 0.01 and true > 0.3
PYTHON
