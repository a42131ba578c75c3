"""Video that was recorded as such, without ROS: frames of episodes are the pictures of their times."""

import av
import pytest

from bagassets.recipe import load_recipe
from bagassets_tests.recorded_bags import NOON_NS
from bagassets_tests.sample_drives import build_recordings
from bagassets_tests.video_streams import encode, number_in
from bagassets_tests.whole.test_foxglove_drive import WRITERS, M, T

RECIPE = """
name: video
bags: {root: bags, settle_s: 0}
rigs:
  - name: arm
    channels:
      CAM_WRIST: {modality: camera, topic: /video, undistort: false}
    signals:
      joints: {topic: /joints, field: joints.position, names: [elbow]}
preview: {enabled: false}
lerobot:
  fps: 20
  features:
    observation.state: {signals: [joints], at: linear}
    observation.images.wrist: {camera: CAM_WRIST, at: nearest}
"""
PERIOD_NS = 50_000_000


def built(folder, lost, said="h264"):
    """Write a recording of 4 s whose video lacks packets, and its episodes; key frames are ten apart."""
    messages = []
    for number, data in encode("libx264", 80):
        if number not in lost:
            stamp_ns = NOON_NS + number * PERIOD_NS
            video = M("CompressedVideo", timestamp=T(stamp_ns), frame_id="cam", data=data, format=said)
            messages.append(("/video", stamp_ns + 1, video))
    for number in range(201):
        stamp_ns = NOON_NS + number * PERIOD_NS * 2 // 5
        joints = M(
            "JointStates", timestamp=T(stamp_ns), joints=[M("JointState", name="elbow", position=number)]
        )
        messages.append(("/joints", stamp_ns, joints))
    (folder / "bags").mkdir()
    WRITERS["protobuf"](folder / "bags/a.mcap", sorted(messages, key=lambda one: one[1]))
    (folder / "recipe.yaml").write_text(RECIPE)
    (made,) = build_recordings(load_recipe(folder / "recipe.yaml")).values()
    return made["lerobot_episodes"]


@pytest.mark.parametrize(("lost", "first"), [((), 0), (range(3), 10)], ids=["whole", "first-packets-lost"])
def test_frames_show_the_pictures_of_their_times(tmp_path, lost, first):
    artifact = built(tmp_path, lost).artifact
    (episode,) = artifact.read_json("episodes.json")
    assert episode["start_ns"] == NOON_NS + first * PERIOD_NS
    film = episode["videos"]["observation.images.wrist"]
    with av.open(str(artifact.path(film["file"]))) as container:
        shown = [number_in(frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]
    assert shown == list(range(first, 80))
    states = artifact.read_table("rows.parquet").column("observation.state").to_pylist()
    assert states == pytest.approx([2.5 * number for number in shown])


def test_packets_lost_in_the_middle_cost_their_episode(tmp_path):
    facts = built(tmp_path, range(33, 36)).artifact.read_json("facts.json")
    (left_out,) = facts["left_out"]
    assert left_out["why"].startswith("observation.images.wrist (CAM_WRIST) has no value within 0.075 s of")
    assert left_out["why"].endswith("its frame at 1.700 s")
