"""The episodes of one recording: against the truth of its messages, and what becomes of recordings that break a rule."""

from importlib.metadata import PackageNotFoundError

import av
import numpy as np
import pytest

from bagassets.assets.asset import Use
from bagassets.base.errors import RecipeError
from bagassets.decode import video
from bagassets.engine.execute import BuildFailure
from bagassets.formats.lerobot.cuts import pieces
from bagassets.formats.lerobot.frames import time_text
from bagassets.formats.lerobot.parameters import EpisodesParams, EpisodesUse
from bagassets.formats.lerobot.ranges import Span
from bagassets.formats.lerobot.recording_part import LEROBOT_EPISODES, _all_kept
from bagassets_tests.arm_recordings import (
    RECIPE,
    arm_messages,
    joint_state,
    joints_at,
    make_project,
    picture,
    write_arm,
)
from bagassets_tests.painted_numbers import number_in, painted
from bagassets_tests.recorded_bags import NOON_NS, SECOND, text, write_ros1
from bagassets_tests.sample_drives import build_recordings


def build(folder, recipe=RECIPE, **options):
    """Build one recording; return the artifact of its episodes."""
    write_arm(folder, "drive", **options)
    (made,) = build_recordings(make_project(folder, recipe)).values()
    return made["lerobot_episodes"].artifact


def rows(artifact, name):
    return np.array(artifact.read_table("rows.parquet").column(name).to_pylist())


def numbers(artifact, file):
    with av.open(str(artifact.path(file))) as container:
        return [number_in(frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]


def left_out(artifact):
    return [one["why"] for one in artifact.read_json("facts.json")["left_out"]]


def changed(old, new):
    assert old in RECIPE
    return RECIPE.replace(old, new)


class TestTruth:
    def test_every_frame_has_the_values_and_the_image_of_its_time(self, tmp_path):
        artifact = build(tmp_path, seconds=2.0, first=700)
        (episode,) = artifact.read_json("episodes.json")
        assert episode["start_ns"] == NOON_NS
        times = np.arange(episode["length"]) / 30
        assert rows(artifact, "observation.state") == pytest.approx(
            np.stack([joints_at(time) for time in times]), abs=2e-4
        )
        before = np.floor(times * 100 + 1e-6) / 100
        assert rows(artifact, "action") == pytest.approx(
            np.stack([joints_at(time) for time in before]) + 0.25, abs=1e-6
        )
        film = episode["videos"]["observation.images.wrist"]
        assert numbers(artifact, film["file"]) == [700 + n for n in range(episode["length"])]
        assert (film["height"], film["width"]) == (64, 64)

    def test_half_the_rate_drops_every_other_image_and_counts_them(self, tmp_path):
        artifact = build(tmp_path, changed("fps: 30", "fps: 15"), seconds=2.0)
        (episode,) = artifact.read_json("episodes.json")
        film = episode["videos"]["observation.images.wrist"]
        assert numbers(artifact, film["file"]) == list(range(0, 2 * episode["length"], 2))
        assert episode["dropped"]["observation.images.wrist"] == episode["length"] - 1
        assert not episode["repeated"].get("observation.images.wrist")

    def test_double_the_rate_repeats_images_if_the_recipe_tolerates_it(self, tmp_path):
        recipe = changed("fps: 30", "fps: 60").replace(
            "{camera: CAM_WRIST}", "{camera: CAM_WRIST, tolerance_s: 0.05}"
        )
        artifact = build(tmp_path, recipe, seconds=1.0)
        (episode,) = artifact.read_json("episodes.json")
        film = episode["videos"]["observation.images.wrist"]
        shown = numbers(artifact, film["file"])
        assert shown == [n // 2 for n in range(len(shown))]
        assert episode["repeated"]["observation.images.wrist"] == len(shown) // 2

    def test_the_next_state_is_the_action_and_the_last_frame_is_dropped(self, tmp_path):
        recipe = changed("action: {signals: [command]}", "action: {next_of: observation.state}")
        artifact = build(tmp_path, recipe, seconds=1.0)
        (episode,) = artifact.read_json("episodes.json")
        state, action = rows(artifact, "observation.state"), rows(artifact, "action")
        assert len(state) == len(action) == episode["length"]
        assert (action[:-1] == state[1:]).all()
        assert action[-1] == pytest.approx(joints_at(episode["length"] / 30), abs=2e-4)
        film = episode["videos"]["observation.images.wrist"]
        assert numbers(artifact, film["file"]) == list(range(episode["length"]))

    def test_several_signals_make_one_feature(self, tmp_path):
        artifact = build(tmp_path, changed("{signals: [joints], at: linear}", "{signals: [joints, command]}"))
        names = artifact.read_json("facts.json")["features"]["observation.state"]["names"]
        assert names == ["joints.elbow", "joints.wrist", "command.elbow", "command.wrist"]
        state = rows(artifact, "observation.state")
        assert state[:, 2:] == pytest.approx(state[:, :2] + 0.25)

    def test_a_feature_of_one_element_is_a_column_of_numbers(self, tmp_path):
        recipe = changed(
            "command: {topic: /command, field: position, names: [elbow, wrist]}",
            "command: {topic: /command, field: position, names: [wrist]}",
        )
        artifact = build(tmp_path, recipe, seconds=1.0)
        assert str(artifact.read_table("rows.parquet").schema.field("action").type) == "float"
        assert artifact.read_json("facts.json")["features"]["action"]["shape"] == [1]

    def test_the_recordings_name_shapes_no_byte(self, tmp_path):
        one = build(tmp_path / "one")
        write_arm(tmp_path / "other", "another_name")
        (made,) = build_recordings(make_project(tmp_path / "other")).values()
        assert made["lerobot_episodes"].artifact.digest == one.digest


def cut(section):
    return RECIPE + f"  episodes: {section}\n"


class TestCuts:
    def spans(self, artifact):
        return [
            (round((one["start_ns"] - NOON_NS) / 1e9, 2), one["length"])
            for one in artifact.read_json("episodes.json")
        ]

    def test_by_an_event_topic(self, tmp_path):
        words = [(1.0, "go"), (2.0, "stop"), (3.0, "go"), (3.5, "go"), (4.0, "noise")]
        messages = arm_messages(5.0) + [
            text(NOON_NS + int(time * SECOND), word, "/event") for time, word in words
        ]
        recipe = cut("{topic: /event, start: [go], end: [stop]}")
        artifact = build(tmp_path, recipe, messages=sorted(messages, key=lambda one: one.log_time_ns))
        assert [start for start, _ in self.spans(artifact)] == [1.0, 3.0, 3.5]
        assert [length for _, length in self.spans(artifact)] == [30, 15, pytest.approx(44, abs=1)]
        assert left_out(artifact) == []

    def test_by_a_signal(self, tmp_path):
        flags = [
            joint_state(NOON_NS + n * SECOND // 10, "/flag", ["on"], [float(10 <= n < 20)]) for n in range(40)
        ]
        messages = sorted(arm_messages(4.0) + flags, key=lambda one: one.log_time_ns)
        recipe = cut("{signal: flag}").replace(
            "    signals:\n", "    signals:\n      flag: {topic: /flag, field: position}\n"
        )
        artifact = build(tmp_path, recipe, messages=messages)
        assert self.spans(artifact) == [(1.0, 30)]

    def test_by_a_file_with_tasks(self, tmp_path):
        (tmp_path / "ranges.csv").write_text(
            "recording,start_s,end_s,task\ndrive.mcap,2,2.5,Turn it.\nother,0,1,No.\ndrive.mcap,0.5,1.5,\n"
        )
        artifact = build(tmp_path, cut("{ranges: ranges.csv}"), seconds=3.0)
        assert self.spans(artifact) == [(0.5, 30), (2.0, 15)]
        assert [one["task"] for one in artifact.read_json("episodes.json")] == [None, "Turn it."]

    def test_ranges_that_adjoin_share_no_frame(self, tmp_path):
        rows = "drive.mcap,0,0.5\ndrive.mcap,0.5,1\n"
        (tmp_path / "ranges.csv").write_text(f"recording,start_s,end_s\n{rows}")
        artifact = build(tmp_path, cut("{ranges: ranges.csv}"), seconds=2.0)
        assert self.spans(artifact) == [(0.0, 15), (0.5, 15)]

    @pytest.mark.parametrize(
        ("section", "why"),
        [
            (
                "{topic: /event, field: message, start: [go]}",
                "no message of /event has a field message; they have data: correct `field`",
            ),
            (
                "{topic: /event, field: [message, data], start: [begin]}",
                "no message of /event begins one: they say 'go', 'stop'; correct `start`",
            ),
            ("{topic: /other, start: [go]}", "/other has no messages"),
        ],
    )
    def test_a_recording_without_episodes_says_why(self, tmp_path, section, why):
        events = [text(NOON_NS + n * SECOND // 2, said, "/event") for n, said in ((0, "go"), (1, "stop"))]
        messages = sorted([*arm_messages(1.0), *events], key=lambda one: one.log_time_ns)
        summary = build(tmp_path, cut(section), messages=messages).summary()
        assert (summary["episodes"], summary["why_none"]) == (0, why)

    def test_the_first_of_several_fields_that_messages_have_counts(self, tmp_path):
        events = [text(NOON_NS, "go", "/event"), text(NOON_NS + SECOND // 2, "stop", "/event")]
        messages = sorted([*arm_messages(1.0), *events], key=lambda one: one.log_time_ns)
        section = cut("{topic: /event, field: [message, data], start: [go], end: [stop]}")
        assert self.spans(build(tmp_path, section, messages=messages)) == [(0.0, 15)]

    def test_a_task_without_its_field_says_which_there_are(self, tmp_path):
        messages = sorted(
            [*arm_messages(1.0), text(NOON_NS, "Push it.", "/task")], key=lambda one: one.log_time_ns
        )
        recipe = changed("task: Lift the cube.", "task: {topic: /task, field: message}")
        assert left_out(build(tmp_path, recipe, messages=messages)) == [
            "no message of /task has a field message; they have data: correct `field`"
        ]

    def test_a_text_in_another_encoding_is_named_with_its_topic(self, tmp_path):
        (tmp_path / "bags").mkdir()
        messages = [*arm_messages(0.5), text(NOON_NS + 1, "Push it.", "/task")]
        path = write_ros1(tmp_path / "bags/drive.bag", sorted(messages, key=lambda one: one.log_time_ns))
        path.write_bytes(path.read_bytes().replace(b"Push it.", "推红方块".encode("gbk")))
        recipe = changed("task: Lift the cube.", "task: {topic: /task}")
        with pytest.raises(
            BuildFailure, match=r"/task, message 1: .* name another topic in lerobot, or repair"
        ):
            build_recordings(make_project(tmp_path, recipe))

    def test_a_file_that_does_not_name_the_recording_makes_no_episode(self, tmp_path):
        (tmp_path / "ranges.csv").write_text("recording,start_s,end_s\nother,0,1\n")
        artifact = build(tmp_path, cut("{ranges: ranges.csv}"), seconds=1.0)
        assert artifact.read_json("facts.json")["episodes"] == 0

    @pytest.mark.parametrize(
        ("content", "sentence"),
        [
            ("recording,begin\ndrive.mcap,1\n", "maybe task; it has recording, begin"),
            ("recording,begin\n", "expected the columns recording, start_s and end_s"),
            ("", "maybe task; it has none"),
            (
                "recording,start_s,end_s\n\ndrive.mcap,2,1\n",
                r"ranges\.csv:3: the episode ends before it begins",
            ),
            (
                "recording,start_s,end_s\ndrive.mcap,2,1\n",
                r"ranges\.csv:2: the episode ends before it begins",
            ),
            (
                "recording,start_s,end_s\ndrive.mcap,x,1\n",
                r"ranges\.csv:2: start_s and end_s must be numbers",
            ),
        ],
    )
    def test_a_wrong_file_is_named_with_its_line(self, tmp_path, content, sentence):
        (tmp_path / "ranges.csv").write_text(content)
        with pytest.raises(BuildFailure, match=sentence):
            build(tmp_path, cut("{ranges: ranges.csv}"), seconds=1.0)

    def test_long_episodes_are_cut(self, tmp_path):
        artifact = build(tmp_path, cut("{max_length_s: 0.5}"), seconds=2.0)
        assert [length for _, length in self.spans(artifact)] == [15, 15, 15, 14]
        film = [
            one["videos"]["observation.images.wrist"]["file"] for one in artifact.read_json("episodes.json")
        ]
        assert [n for file in film for n in numbers(artifact, file)] == list(range(59))

    def test_short_ones_are_left_out(self, tmp_path):
        artifact = build(tmp_path, cut("{min_length_s: 3}"), seconds=2.0)
        assert left_out(artifact) == ["it has 59 frames, and must have 90"]

    def test_lengths_are_those_of_whole_frames_though_they_are_rounded_in_binary(self, tmp_path):
        """4.1 s at 30 Hz are 122.99... frames in binary, and 0.14 s at 50 Hz are 7.00...1."""
        longest = Span(0, 122 * SECOND // 30)
        assert list(pieces(longest, 4.1, 30)) == [longest]
        recipe = cut("{min_length_s: 0.14}").replace("fps: 30", "fps: 50")
        artifact = build(tmp_path, recipe, messages=arm_messages(0.15, camera_hz=50))
        assert (left_out(artifact), [length for _, length in self.spans(artifact)]) == ([], [7])

    def test_one_frame_is_in_the_singular(self, tmp_path):
        artifact = build(tmp_path, cut("{max_length_s: 0.04}"), seconds=0.1)
        assert set(left_out(artifact)) == {"it has 1 frame, and must have 2"}

    def test_a_time_before_the_first_message_is_said_so(self):
        assert time_text(1.0) == "1.000 s"
        assert time_text(-0.001) == "0.001 s before its first message"
        assert time_text(-0.0001) == "0.000 s"

    def test_a_task_from_a_topic_holds_for_the_episodes_after_it(self, tmp_path):
        messages = [*arm_messages(2.0), text(NOON_NS - SECOND // 2, "Push it.", "/task")]
        recipe = changed("task: Lift the cube.", "task: {topic: /task}")
        artifact = build(tmp_path, recipe, messages=sorted(messages, key=lambda one: one.log_time_ns))
        assert [one["task"] for one in artifact.read_json("episodes.json")] == ["Push it."]


class TestBrokenRules:
    """Each leaves its episode out, with a clause that names feature and time."""

    def test_a_camera_that_stops(self, tmp_path):
        artifact = build(tmp_path, seconds=4.0, skip=lambda topic, time: topic == "/wrist" and time > 2)
        assert left_out(artifact) == [
            "observation.images.wrist (CAM_WRIST) ends at 2.000 s already, more than 1 s before it"
        ]
        facts = artifact.read_json("facts.json")
        assert facts["episodes"] == 0
        (said,) = _all_kept(facts, []).problems
        assert said.endswith(", more than 1 s before it (lerobot.episodes.trim_s)")

    def test_a_camera_that_pauses(self, tmp_path):
        artifact = build(tmp_path, seconds=3.0, skip=lambda topic, time: topic == "/wrist" and 1 < time < 1.5)
        assert left_out(artifact) == [
            "observation.images.wrist (CAM_WRIST) has no value within 0.05 s of its frame at 1.067 s"
        ]

    @pytest.mark.parametrize(("gap", "length"), [("hold", 90), ("end", 32)])
    def test_a_pause_that_the_recipe_provides_for(self, tmp_path, gap, length):
        recipe = changed("{camera: CAM_WRIST}", f"{{camera: CAM_WRIST, gap: {gap}}}")
        artifact = build(
            tmp_path, recipe, seconds=3.0, skip=lambda topic, time: topic == "/wrist" and 1 < time < 1.5
        )
        (episode,) = artifact.read_json("episodes.json")
        assert episode["length"] == length
        shown = numbers(artifact, episode["videos"]["observation.images.wrist"]["file"])
        assert shown[:32] == [min(n, 30) for n in range(32)]
        if gap == "hold":
            assert shown[32:46] == [30] * 13 + [45]
            assert episode["held"] == {"observation.images.wrist": 13}
        else:
            (said,) = _all_kept(artifact.read_json("facts.json"), []).warnings
            assert (
                said
                == "observation.images.wrist: 58 frames behind a gap left out, by its `gap: end`; 32 are kept"
            )

    def test_what_is_held_is_the_image_before_even_if_the_next_is_nearer(self, tmp_path):
        recipe = changed("{camera: CAM_WRIST}", "{camera: CAM_WRIST, at: nearest, gap: hold}")
        artifact = build(
            tmp_path, recipe, seconds=3.0, skip=lambda topic, time: topic == "/wrist" and 1 < time < 1.5
        )
        (episode,) = artifact.read_json("episodes.json")
        shown = numbers(artifact, episode["videos"]["observation.images.wrist"]["file"])
        assert shown[30:47] == [30] * 14 + [45, 45, 46]

    def test_frames_are_held_once_however_many_signals_a_feature_has(self, tmp_path):
        recipe = changed(
            "{signals: [joints], at: linear}", "{signals: [joints, command], gap: hold}"
        ).replace("{signals: [command]}", "{next_of: observation.state}")
        artifact = build(
            tmp_path,
            recipe,
            seconds=2.0,
            skip=lambda topic, time: (
                (topic == "/joint_states" and 0.5 < time < 0.8) or (topic == "/command" and 0.6 < time < 0.9)
            ),
        )
        (episode,) = artifact.read_json("episodes.json")
        assert episode["held"] == {"observation.state": 10}

    def test_frames_behind_the_end_are_not_held(self, tmp_path):
        recipe = changed("{camera: CAM_WRIST}", "{camera: CAM_WRIST, gap: hold}").replace(
            "{signals: [command]}", "{signals: [command], gap: end}"
        )
        artifact = build(
            tmp_path,
            recipe,
            seconds=3.0,
            skip=lambda topic, time: (
                (topic == "/wrist" and (0.4 < time < 0.6 or 1.5 < time < 2.5))
                or (topic == "/command" and 1.2 < time < 1.4)
            ),
        )
        (episode,) = artifact.read_json("episodes.json")
        assert episode["held"] == {"observation.images.wrist": 4}

    @pytest.mark.parametrize(
        ("rule", "version"),
        [
            ("at: nearest, gap: hold", 3),
            ("at: nearest", 2),
            ("gap: hold", 2),
            ("at: linear, gap: hold", 2),
            ("gap: end", 4),
            ("gap: end}\n    other: {signals: [joints], gap: hold", 6),
            ("gap: hold}\n    other: {signals: [joints, command], gap: hold", 6),
        ],
    )
    def test_only_what_has_other_bytes_is_made_again_after_the_upgrade(self, tmp_path, rule, version):
        recipe = changed("{signals: [command]}", f"{{signals: [command], {rule}}}")
        self.check_version(tmp_path, recipe, version)

    @pytest.mark.parametrize(("length_s", "version"), [(4.1, 5), (4, 2)])
    def test_of_lengths_those_that_are_not_whole_frames_in_binary(self, tmp_path, length_s, version):
        self.check_version(tmp_path, cut(f"{{max_length_s: {length_s}}}"), version)

    def check_version(self, tmp_path, recipe, version):
        settings = make_project(tmp_path, recipe)
        params = EpisodesUse(params=EpisodesParams.of(settings, settings.rigs[0]), start_ns=0, end_ns=1)
        assert LEROBOT_EPISODES.action(Use(params), None).version == version

    def test_an_action_that_begins_late(self, tmp_path):
        artifact = build(tmp_path, seconds=4.0, skip=lambda topic, time: topic == "/command" and time < 2)
        assert left_out(artifact) == ["action (command) begins at 2.000 s only, more than 1 s after it"]

    def test_an_action_that_begins_a_little_late_trims_the_episode(self, tmp_path):
        artifact = build(tmp_path, seconds=2.0, skip=lambda topic, time: topic == "/command" and time < 0.5)
        (episode,) = artifact.read_json("episodes.json")
        assert episode["start_ns"] == NOON_NS + SECOND // 2

    def test_more_frames_a_second_than_the_camera_has(self, tmp_path):
        artifact = build(tmp_path, seconds=2.0, camera_hz=10)
        (why,) = left_out(artifact)
        assert why.startswith(
            "observation.images.wrist (CAM_WRIST) has no value within 0.05 s of its frame at 0.067 s"
        )
        assert why.endswith("it comes at 10 Hz and fps is 30; lower fps, or raise its tolerance_s")

    def test_a_value_beyond_single_precision_is_none(self, tmp_path):
        """Rows have float32, in which 1e39 would be infinite, and so would be all that is computed from it."""

        def edited(one, time_s):
            if one.topic != "/command" or not 1.0 < time_s < 1.5:
                return one
            return joint_state(one.log_time_ns, "/command", ["elbow", "wrist"], [0.0, -1e39])

        messages = [edited(one, (one.log_time_ns - NOON_NS) / SECOND) for one in arm_messages(2.0)]
        assert left_out(build(tmp_path, messages=messages)) == [
            "action (command) has no value within 0.05 s of its frame at 1.067 s"
        ]

    def test_joints_that_vanish(self, tmp_path):
        messages = [
            one
            for one in arm_messages(2.0)
            if not (one.topic == "/joint_states" and one.log_time_ns > NOON_NS + SECOND)
        ]
        messages += [
            joint_state(NOON_NS + SECOND + n * SECOND // 100, "/joint_states", ["elbow"], [0.0])
            for n in range(1, 100)
        ]
        artifact = build(tmp_path, messages=sorted(messages, key=lambda one: one.log_time_ns))
        (episode,) = artifact.read_json("episodes.json")
        assert episode["length"] == 31  # it ends with them, within trim_s

    def test_images_that_change_their_size(self, tmp_path):
        messages = [
            one
            for one in arm_messages(2.0)
            if not (one.topic == "/wrist" and one.log_time_ns >= NOON_NS + SECOND)
        ]
        messages += [
            picture(NOON_NS + SECOND + n * SECOND // 30, "/wrist", painted(n, (96, 64))) for n in range(30)
        ]
        artifact = build(tmp_path, messages=sorted(messages, key=lambda one: one.log_time_ns))
        assert left_out(artifact) == [
            "the images of observation.images.wrist are 64 x 96 from 1.000 s on, and 64 x 64 before"
        ]

    def test_a_task_that_changes(self, tmp_path):
        messages = arm_messages(2.0) + [
            text(NOON_NS + int(at * SECOND), said, "/task") for at, said in ((0, "Push it."), (1, "Pull it."))
        ]
        recipe = changed("task: Lift the cube.", "task: {topic: /task}")
        artifact = build(tmp_path, recipe, messages=sorted(messages, key=lambda one: one.log_time_ns))
        assert left_out(artifact) == ["its task changes at 1.000 s, from 'Push it.' to 'Pull it.'"]

    def test_a_rig_of_other_sensors_has_no_episodes_and_does_not_fail(self, tmp_path):
        """Arms and vehicles in one folder: all recordings of vehicles failed."""
        van = "  - name: van\n    match: ['van*']\n    channels:\n      CAM_WRIST: {modality: camera, topic: /wrist, undistort: false}\n"
        recipe = changed("preview:", f"{van}preview:").replace(
            "- name: arm\n", "- name: arm\n    match: ['drive*']\n"
        )
        for name in ("drive", "van"):
            write_arm(tmp_path, name, seconds=1.0)
        made = build_recordings(make_project(tmp_path, recipe))
        facts = {key: one["lerobot_episodes"].artifact.read_json("facts.json") for key, one in made.items()}
        assert {key: one["episodes"] for key, one in facts.items()} == {"drive.mcap": 1, "van.mcap": 0}
        assert facts["van.mcap"]["why_none"] == "rig van has not all signals and cameras of lerobot.features"

    def test_a_recording_without_the_signal_fails_with_its_name(self, tmp_path):
        with pytest.raises(
            BuildFailure,
            match=r"drive\.mcap: action needs command, of which this recording has no messages; name it in bags.exclude, and give",
        ):
            build(tmp_path, seconds=1.0, skip=lambda topic, _: topic == "/command")

    @pytest.mark.parametrize(
        ("video", "found"),
        [
            (
                "preset: placido",
                "of h264 must be one of ultrafast, .*; found 'placido'; did you mean placebo",
            ),
            ("crf: 52", "of h264 must be 1 to 51; found 52"),
            ("codec: av1, preset: veryfast", "of av1 must be one of -2, -1, 0, .*, 13; found 'veryfast'"),
        ],
    )
    def test_what_the_encoder_lacks_is_refused_with_the_recipe(self, tmp_path, video, found):
        with pytest.raises(RecipeError, match=rf"recipe\.yaml:19: lerobot\.video\.(preset|crf): {found}"):
            make_project(tmp_path, RECIPE + f"  video: {{{video}}}\n")

    @pytest.mark.parametrize("preset", ["Fast", "0"])
    def test_presets_that_the_encoder_reads_are_kept(self, tmp_path, preset):
        assert make_project(tmp_path, RECIPE + f"  video: {{preset: '{preset}'}}\n").name

    def test_images_that_the_encoder_refuses_are_named_with_the_settings(self, tmp_path):
        def tiny(number, _size):
            return np.full((2, 2, 3), number, np.uint8)

        with pytest.raises(
            BuildFailure,
            match=r"observation\.images\.wrist: its video cannot be encoded as av1 with preset 9 .*lerobot\.video",
        ):
            build(tmp_path, RECIPE + "  video: {codec: av1, preset: '9'}\n", seconds=0.2, draw=tiny)

    def test_without_pyav_a_sentence_says_what_to_install(self, tmp_path, monkeypatch):
        def nothing(_name):
            raise PackageNotFoundError

        monkeypatch.setattr(video, "version", nothing)
        with pytest.raises(
            BuildFailure, match=r"lerobot\.features: video needs PyAV.*`pip install 'bagassets\[video\]'`"
        ):
            build(tmp_path, seconds=1.0)

    def test_what_was_lost_is_counted(self, tmp_path):
        artifact = build(
            tmp_path,
            cut("{max_length_s: 1}"),
            seconds=3.0,
            skip=lambda topic, time: topic == "/wrist" and 1.2 < time < 1.5,
        )
        facts = artifact.read_json("facts.json")
        assert facts["episodes"] == 2
        assert [one["at_s"] for one in facts["left_out"]] == [1.0]
        assert artifact.summary()["left_out"] == facts["left_out"]
