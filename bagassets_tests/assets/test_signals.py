"""The asset `signals`: series of numbers from messages of real types, compared with what was recorded."""

import math

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from bagassets.assets.pictures.canvas import colour_of
from bagassets.assets.pictures.plot import signal_plot
from bagassets.assets.quality.evidence import Evidence
from bagassets.assets.quality.topic_rules import channels_present, topic_rates
from bagassets.assets.signal_plots import SIGNAL_PLOTS
from bagassets.assets.signals import SIGNALS
from bagassets.base.errors import BagAssetsError
from bagassets.engine.execute import AssetResult, BuildFailure, execute
from bagassets.engine.graph import Graph
from bagassets.engine.source import MessageSource
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe.load import load_recipe
from bagassets.recipe.model_checks import ChannelsCheck, TopicLimits, TopicsCheck
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from bagassets_tests.recorded_bags import NOON_NS, Message, header, write_mcap, write_ros1, write_ros2

STEP_NS = 10_000_000
JOINT = "sensor_msgs/msg/JointState"
WRITERS = {
    "ros1": ("drive.bag", write_ros1),
    "ros2": ("drive", write_ros2),
    "mcap": ("drive.mcap", write_mcap),
}


def joints(number, names, position, *, stamp_ns=None, log_ns=None, velocity=(), topic="/joint_states"):
    stamp = NOON_NS + number * STEP_NS if stamp_ns is None else stamp_ns

    def make(store):
        return store.types[JOINT](
            header(store, stamp, ""),
            list(names),
            np.array(position, float),
            np.array(velocity, float),
            np.array([]),
        )

    return Message(topic, JOINT, (stamp if log_ns is None else log_ns) + 1_000_000, make)


def other(number, msgtype, topic, fields):
    """A message of a type whose fields are given by the type store."""
    stamp_ns = NOON_NS + number * STEP_NS
    return Message(
        topic, msgtype, stamp_ns + 1_000_000, lambda store: store.types[msgtype](**fields(store, stamp_ns))
    )


class Built:
    """The signals of a recording of these messages."""

    def __init__(self, folder, messages, signals, *, kind="mcap", rig=None, plots=False, **sections):
        name, write = WRITERS[kind]
        (folder / "bags").mkdir(parents=True)
        write(folder / "bags" / name, sorted(messages, key=lambda one: one.log_time_ns))
        recipe = {
            "name": "arm",
            "bags": {"root": "bags", "settle_s": 0},
            "vision": {"output": "out", "trajectories": []},
            "rigs": [{"name": "arm", "signals": signals, **(rig or {})}],
            **sections,
        }
        (folder / "recipe.yaml").write_text(yaml.safe_dump(recipe))
        self.recipe = load_recipe(folder / "recipe.yaml")
        self.store = Store(self.recipe.store_path)
        found = discover(self.recipe.bags).recordings
        self.graph = Graph.of(recording_assets(self.recipe), found[name])
        self.graph.wanted = ("inventory", "signals", *(["signal_plots"] if plots else []))
        self.errors, self.results = {}, {}
        try:
            for one in execute(self.graph, threads=1):
                self.results[one.asset] = one
        except BuildFailure as err:
            self.errors = {name: str(one) for name, one in err.errors.items()}
        if isinstance(self.results.get("signals"), AssetResult):
            self.index = self.results["signals"].artifact
            self.artifacts = {
                name: self.store.artifact(digest) for name, digest in self.results["signals"].channels.items()
            }

    def table(self, name):
        return pq.read_table(self.artifacts[name].path("signal.parquet"))

    def rows(self, name):
        """Stamps since the start in steps, and rows of values."""
        columns = self.table(name).to_pydict()
        steps = [(stamp - NOON_NS) / STEP_NS for stamp in columns.pop("stamp_ns")]
        return steps, list(zip(*columns.values(), strict=True))

    def counts(self, name):
        return self.index.summary()["channels"][name]

    def facts(self, name):
        return self.artifacts[name].read_json("signal.json")

    def finding(self, check, **thresholds):
        current = {"signals": self.index}
        rig = self.recipe.rigs[0]
        recipe = self.recipe
        if thresholds:
            data = recipe.checks.model_dump()
            data["signal_values"] |= thresholds
            recipe = recipe.model_copy(update={"checks": type(recipe.checks).model_validate(data)})
        rule = next(one for one in SIGNALS.checks if one.name == check).rule
        return rule(Evidence(recipe, rig, self.store, current.__getitem__))


POSITION = {"topic": "/joint_states", "field": "position"}
ABC = ("elbow", "wrist", "hand")


@pytest.mark.parametrize("kind", WRITERS)
def test_a_joint_is_found_by_its_name_wherever_it_is_in_the_message(tmp_path, kind):
    orders = [(0, 1, 2), (2, 0, 1), (1, 2, 0)]
    values = {name: [math.sin(0.1 * n + i) for n in range(30)] for i, name in enumerate(ABC)}
    messages = []
    for n in range(30):
        names = [ABC[i] for i in orders[n % 3]]
        messages.append(joints(n, names, [values[name][n] for name in names]))
    built = Built(
        tmp_path, messages, {"arm": {**POSITION, "names": ["hand", "elbow"]}, "all": POSITION}, kind=kind
    )
    table = built.table("arm")
    assert [(field.name, str(field.type)) for field in table.schema] == [
        ("stamp_ns", "int64"),
        ("hand", "double"),
        ("elbow", "double"),
    ]
    assert table.column("stamp_ns").to_pylist() == [NOON_NS + n * STEP_NS for n in range(30)]
    assert table.column("hand").to_pylist() == values["hand"]
    assert table.column("elbow").to_pylist() == values["elbow"]
    assert built.table("all").column_names == ["stamp_ns", *ABC]
    assert built.table("all").column("wrist").to_pylist() == values["wrist"]
    assert built.counts("arm") == {
        "read": 30, "written": 30, "merged": 0, "lost": {},
        "missing": 0, "not_finite": 0, "backward": 0, "others": 0, "changes": 0,
    }  # fmt: skip


def test_a_joint_that_vanishes_is_a_gap_and_one_that_is_new_changes_nothing(tmp_path):
    messages = [
        joints(0, ABC, [1, 2, 3]),
        joints(1, ABC[:2], [4, 5]),
        joints(2, (*ABC, "tool"), [6, 7, 8, 9]),
    ]
    built = Built(tmp_path, messages, {"arm": POSITION})
    assert built.rows("arm") == ([0, 1, 2], [(1, 2, 3), (4, 5, None), (6, 7, 8)])
    counts, facts = built.counts("arm"), built.facts("arm")
    assert (counts["written"], counts["missing"], counts["changes"]) == (3, 1, 2)
    assert facts["first_change_ns"] == NOON_NS + STEP_NS
    assert [element["missing"] for element in facts["elements"]] == [0, 0, 1]
    assert "hand has no value in 1 of 3 messages (1 lack it" in built.finding("signal_values").problems[0]


def test_two_drivers_may_share_a_topic(tmp_path):
    gripper = ("left_finger", "right_finger")
    messages = [
        joints(n, gripper, [n, -n]) if n % 2 else joints(n, ABC, [n, n + 1, n + 2]) for n in range(10)
    ]
    signals = {
        "arm": {**POSITION, "names": ABC},
        "first": POSITION,
        "gripper": {**POSITION, "names": gripper},
    }
    built = Built(tmp_path, messages, signals)
    assert built.rows("arm")[0] == [0, 2, 4, 6, 8] == built.rows("first")[0]
    assert built.rows("gripper") == ([1, 3, 5, 7, 9], [(n, -n) for n in (1, 3, 5, 7, 9)])
    assert built.counts("arm")["others"] == built.counts("gripper")["others"] == 5
    assert built.counts("arm")["changes"] == 0
    assert not built.finding("signals_complete").problems


def test_a_name_that_no_message_has_is_an_error_that_names_those_they_have(tmp_path):
    messages = [joints(n, ABC, [1, 2, 3]) for n in range(3)]
    for names, error in (
        (["elbow", "wirst"], "arm (/joint_states): no message has wirst; they have elbow, hand, wrist."),
        (["wirst"], "arm (/joint_states): no message has wirst; they have elbow, hand, wrist."),
    ):
        built = Built(tmp_path / names[0], messages, {"arm": {**POSITION, "names": names}})
        assert error in built.errors["signals"]


def test_stamps_are_sorted_and_repeated_ones_are_lost(tmp_path):
    steps = [0, 1, 3, 2, 4, 4, 5]
    messages = [
        joints(step, ABC[:1], [float(n)], log_ns=NOON_NS + n * STEP_NS) for n, step in enumerate(steps)
    ]
    built = Built(tmp_path, messages, {"arm": POSITION, "logged": {**POSITION, "clock": "log"}})
    assert built.rows("arm") == ([0, 1, 2, 3, 4, 5], [(0,), (1,), (3,), (2,), (4,), (6,)])
    counts = built.counts("arm")
    assert (counts["read"], counts["written"], counts["lost"], counts["backward"]) == (
        7,
        6,
        {"repeated stamp": 1},
        1,
    )
    assert built.facts("arm")["most_backward_s"] == STEP_NS / 1e9
    assert built.rows("logged") == ([n + 0.1 for n in range(7)], [(float(n),) for n in range(7)])
    assert (
        "1 of 7 messages (14%) was lost because of repeated stamps"
        in built.finding("signals_complete").problems[0]
    )
    assert not built.finding("signal_values").problems
    backward = built.finding("signal_values", max_backward_s=0.001).problems
    assert backward == [
        "arm: stamps go back in time by up to 0.01 s, at most 0.001 s expected; its values are sorted by stamp"
    ]


def test_values_that_are_not_finite_are_null_and_counted(tmp_path):
    values = [1.0, math.nan, math.inf, -math.inf, 5.0]
    built = Built(
        tmp_path, [joints(n, ABC[:1], [value]) for n, value in enumerate(values)], {"arm": POSITION}
    )
    assert built.table("arm").column("elbow").to_pylist() == [1.0, None, None, None, 5.0]
    assert built.counts("arm")["not_finite"] == 3
    element = built.facts("arm")["elements"][0]
    assert (element["min"], element["max"]) == (1.0, 5.0)
    (problem,) = built.finding("signal_values").problems
    assert (
        problem == "arm: elbow has no value in 3 of 5 messages (0 lack it, 3 hold a value that is not finite)"
    )


def twist(number):
    def fields(store, _):
        vector = store.types["geometry_msgs/msg/Vector3"]
        return {"linear": vector(number, 0.5, 0.0), "angular": vector(0.0, 0.0, -number)}

    return other(number, "geometry_msgs/msg/Twist", "/cmd_vel", fields)


def joy(number):
    def fields(store, stamp_ns):
        axes, buttons = np.array([0.25, number, -1], np.float32), np.array([0, 1, number], np.int32)
        return {"header": header(store, stamp_ns, ""), "axes": axes, "buttons": buttons}

    return other(number, "sensor_msgs/msg/Joy", "/joy", fields)


def flag(number):
    return other(number, "std_msgs/msg/Bool", "/moving", lambda _, __: {"data": number % 2 == 0})


def pose(number):
    def fields(store, stamp_ns):
        point, quaternion = (
            store.types["geometry_msgs/msg/Point"],
            store.types["geometry_msgs/msg/Quaternion"],
        )
        value = store.types["geometry_msgs/msg/Pose"](point(number, 2.0, 3.0), quaternion(0.0, 0.0, 0.0, 1.0))
        return {"header": header(store, stamp_ns, "base"), "pose": value}

    return other(number, "geometry_msgs/msg/PoseStamped", "/tool", fields)


def plan(number):
    def fields(store, stamp_ns):
        time = store.types["builtin_interfaces/msg/Duration"](0, 0)
        none = np.array([])
        point = store.types["trajectory_msgs/msg/JointTrajectoryPoint"](
            np.array([number, 10.0 + number]), none, none, none, time
        )
        return {"header": header(store, stamp_ns, ""), "joint_names": ["b", "a"], "points": [point]}

    return other(number, "trajectory_msgs/msg/JointTrajectory", "/plan", fields)


def test_any_numbers_of_any_message(tmp_path):
    messages = [make(number) for number in range(4) for make in (twist, joy, flag, pose, plan)]
    log = {"clock": "log"}
    signals = {
        "twist": {"topic": "/cmd_vel", "field": ["linear.x", "angular.z"], **log},
        "named": {"topic": "/cmd_vel", "field": ["linear.x", "angular.z"], "names": ["v", "w"], **log},
        "whole": {"topic": "/cmd_vel", "field": "linear", **log},
        "axis": {"topic": "/joy", "field": "axes[1]"},
        "buttons": {"topic": "/joy", "field": "buttons", "names": ["a", "b", "c"]},
        "moving": {"topic": "/moving", "field": "data", **log},
        "tool": {"topic": "/tool", "field": "pose"},
        "plan": {"topic": "/plan", "field": "points[0].positions", "names": ["a", "b"]},
    }
    built = Built(tmp_path, messages, signals)
    columns = {name: built.table(name).column_names[1:] for name in signals}
    assert columns == {
        "twist": ["linear.x", "angular.z"],
        "named": ["v", "w"],
        "whole": ["linear.x", "linear.y", "linear.z"],
        "axis": ["axes[1]"],
        "buttons": ["a", "b", "c"],
        "moving": ["data"],
        "tool": [f"pose.{part}" for part in ("position.x", "position.y", "position.z")]
        + [f"pose.orientation.{axis}" for axis in "xyzw"],
        "plan": ["a", "b"],
    }
    values = {name: built.rows(name)[1] for name in signals}
    assert values["twist"] == values["named"] == [(n, -n) for n in range(4)]
    assert values["whole"] == [(n, 0.5, 0) for n in range(4)]
    assert values["axis"] == [(n,) for n in range(4)]
    assert values["buttons"] == [(0, 1, n) for n in range(4)]
    assert values["moving"] == [(1,), (0,), (1,), (0,)]
    assert values["tool"] == [(n, 2, 3, 0, 0, 0, 1) for n in range(4)]
    assert values["plan"] == [(10 + n, n) for n in range(4)]


def test_several_fields_of_named_joints(tmp_path):
    messages = [joints(n, ("b", "a"), [n, 2 * n], velocity=[3 * n, 4 * n]) for n in range(3)]
    signals = {"arm": {"topic": "/joint_states", "field": ["position", "velocity"], "names": ["a", "b"]}}
    built = Built(tmp_path, messages, signals)
    assert built.table("arm").column_names[1:] == ["position.a", "position.b", "velocity.a", "velocity.b"]
    assert built.rows("arm")[1] == [(2 * n, n, 4 * n, 3 * n) for n in range(3)]


def test_units_are_kept_and_degrees_become_radians(tmp_path):
    angles = [-180.0, 0.0, 30.0, 90.0]
    messages = [joints(n, ABC[:1], [angle]) for n, angle in enumerate(angles)]
    signals = {
        "rad": {**POSITION, "unit": "rad", "recorded_unit": "deg"},
        "plain": {**POSITION, "unit": "deg"},
    }
    built = Built(tmp_path, messages, signals)
    np.testing.assert_allclose(built.table("rad").column("elbow").to_numpy(), np.radians(angles), rtol=1e-15)
    assert built.table("plain").column("elbow").to_pylist() == angles
    assert (built.facts("rad")["unit"], built.facts("plain")["unit"]) == ("rad", "deg")


def numbers(number, values, topic="/command"):
    def fields(store, _):
        layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
        return {"layout": layout, "data": np.array(values, float)}

    return other(number, "std_msgs/msg/Float64MultiArray", topic, fields)


def test_elements_without_names_that_change_number_are_lost(tmp_path):
    messages = [numbers(n, [n, n] if n < 6 else [n, n, n]) for n in range(8)]
    command = {"topic": "/command", "field": "data", "clock": "log"}
    built = Built(tmp_path, messages, {"command": command, "named": {**command, "names": ["a", "b"]}})
    for name, columns in (("command", ["data[0]", "data[1]"]), ("named", ["a", "b"])):
        assert built.table(name).column_names[1:] == columns
        assert built.rows(name)[1] == [(n, n) for n in range(6)]
        assert built.counts(name)["lost"] == {"it has another number of elements than before": 2}


def test_elements_that_are_not_yet_there_cost_their_messages_alone(tmp_path):
    """As those do that are there no more: which come first does not decide whether the signal fails."""
    messages = [numbers(n, [n] if n < 2 else [n, n]) for n in range(8)]
    built = Built(
        tmp_path,
        messages,
        {"named": {"topic": "/command", "field": "data", "clock": "log", "names": ["a", "b"]}},
    )
    assert not built.errors
    assert built.rows("named")[1] == [(n, n) for n in range(2, 8)]
    (reason,) = built.counts("named")["lost"]
    assert reason == "it has another number of elements than `names` in the recipe, and names none"


@pytest.mark.parametrize(
    ("signal", "error"),
    [
        ({"topic": "/command", "field": "data"}, "it has no header with a stamp; set `clock: log` in the recipe"),
        ({"topic": "/joint_states", "field": "posit"}, "there is no field posit: posit is not one of header, name, position, velocity, effort"),
        ({"topic": "/joint_states", "field": "name"}, "name does not hold numbers"),
        ({"topic": "/joint_states", "field": "header.frame_id"}, "header.frame_id is not a number"),
        ({"topic": "/joint_states", "field": "position[9]"}, "its array is too short for position[9]"),
        ({"topic": "/joint_states", "field": "effort"}, "effort is empty"),
        ({"topic": "/command", "field": "data", "names": ["a"], "clock": "log"}, "it has another number of elements than `names` in the recipe, and names none"),
        ({"topic": "/big", "field": "data", "clock": "log"}, "data is an array of more than 1000 elements; name single ones"),
    ],
    ids=lambda value: value["field"] if isinstance(value, dict) else "",
)  # fmt: skip
def test_a_signal_without_any_value_is_an_error_that_says_why(tmp_path, signal, error):
    messages = [joints(n, ABC, [1, 2, 3]) for n in range(3)]
    messages += [numbers(n, [1, 2]) for n in range(3)] + [numbers(n, [0] * 1001, "/big") for n in range(3)]
    built = Built(tmp_path, messages, {"bad": signal})
    assert (
        f"bad ({signal['topic']}): none of its 3 messages gives values, most often because {error}."
        in built.errors["signals"]
    )


def test_a_signal_that_fails_leaves_the_others(tmp_path):
    messages = [joints(n, ABC, [1, 2, 3]) for n in range(3)]
    built = Built(tmp_path, messages, {"bad": {**POSITION, "field": "posit"}, "good": POSITION})
    nodes = {node.channel: node for node in built.graph.node("signals").parts}
    assert nodes["good"].artifact is not None
    assert nodes["bad"].artifact is None


def test_signals_are_apart_and_nothing_else_changes_their_actions(tmp_path):
    """A change to one leaves the others, and a recipe without signals has no such asset."""
    messages = [joints(n, ABC, [1, 2, 3]) for n in range(3)]
    one = Built(tmp_path / "one", messages, {"a": POSITION, "b": POSITION})
    two = Built(tmp_path / "two", messages, {"a": POSITION, "b": {**POSITION, "names": ["hand"]}})
    actions = [
        {node.channel: node.known_action.digest for node in built.graph.node("signals").parts}
        for built in (one, two)
    ]
    assert actions[0]["a"] == actions[1]["a"]
    assert actions[0]["b"] != actions[1]["b"]
    assert one.artifacts["a"].digest == two.artifacts["a"].digest
    rigs = [{"name": "car", "channels": {"CAM_FRONT": {"modality": "camera", "topic": "/cam"}}}]
    (tmp_path / "plain.yaml").write_text(
        yaml.safe_dump(
            {"name": "x", "bags": {"root": "."}, "vision": {"output": "o", "trajectories": []}, "rigs": rigs}
        )
    )
    assert "signals" not in recording_assets(load_recipe(tmp_path / "plain.yaml")).names


def test_each_signal_is_drawn(tmp_path):
    """The line is where the values are; a gap of a joint is a gap of its line."""
    messages = [
        joints(n, ABC[:2] if 100 <= n < 200 else ABC, [1.0, n / 300, -1.0][: 2 if 100 <= n < 200 else 3])
        for n in range(300)
    ]
    built = Built(
        tmp_path, messages, {"arm": POSITION, "elbow": {**POSITION, "names": ["elbow"]}}, plots=True
    )
    plots = built.results["signal_plots"].artifact
    pictures = SIGNAL_PLOTS.face.pictures(plots)
    assert [picture.title for picture in pictures] == ["Signal arm", "Signal elbow"]
    assert all(plots.path(picture.small).stat().st_size <= 16 * 1024 for picture in pictures)
    assert cv2.imread(str(plots.path("arm.jpg"))).shape[1] == 1280
    table = built.table("arm")
    elements = {name: table.column(name).to_numpy() for name in ABC}
    stamps_ns = table.column("stamp_ns").to_numpy()
    image = signal_plot("arm", stamps_ns, elements, (int(stamps_ns[0]), int(stamps_ns[-1])), 1280)
    inner = image[40:400, 90:1250]
    colours = [(inner == colour_of(number)).all(axis=2) for number in range(3)]
    elbow, wrist, hand = (np.flatnonzero(one.any(axis=0)) / inner.shape[1] for one in colours)
    assert np.ptp(elbow) > 0.99
    assert np.ptp(wrist) > 0.99
    assert not ((hand > 0.35) & (hand < 0.65)).any()
    assert ((hand > 0.05) & (hand < 0.3)).sum() > 100 < ((hand > 0.7) & (hand < 0.95)).sum()
    middle = [np.flatnonzero(one[:, 580]).mean() for one in colours[:2]]
    assert 0 < middle[0] < middle[1] < 360  # 1.0 is above 0.5


def test_small_messages_are_not_read_from_the_recording_again(tmp_path, monkeypatch):
    """A signal that changes does not cost a pass over a large recording."""
    read = []
    monkeypatch.setattr(MessageSource, "whole", _noting(MessageSource.whole, read))
    Built(tmp_path, [joints(n, ABC, [1, 2, 3]) for n in range(3)], {"arm": POSITION})
    assert len(read) == 1  # for the inventory


def _noting(function, calls):
    def noted(*args, **options):
        calls.append(args)
        return function(*args, **options)

    return noted


def test_gaps_and_ranges_are_checked(tmp_path):
    messages = [joints(n, ABC[:1], [float(n)]) for n in (*range(50), *range(250, 300))]
    built = Built(tmp_path, messages, {"arm": POSITION})
    finding = built.finding("signal_values", limits={"arm": {"min": 1, "max": 200}})
    assert [problem.split(" (")[0] for problem in finding.problems] == [
        "arm: elbow has no value for 2.01 s after 2024-06-21T12:00:00.490Z",
        "arm: elbow goes down to 0, at least 1 expected",
        "arm: elbow goes up to 299, at most 200 expected",
    ]
    assert finding.facts == {"rates_hz": {"arm": 33.11}}
    assert not built.finding("signal_values", max_gap_s=3).problems
    rig, inventory = built.recipe.rigs[0], built.graph.inputs.inventory
    limits = {"/joint_states": TopicLimits(min_hz=50)}
    (slow, pause) = topic_rates(rig, inventory, TopicsCheck(limits=limits)).problems
    assert slow == "/joint_states: 33.11 Hz, at least 50 Hz expected"
    assert pause.startswith("/joint_states: a pause of 2.01 s")


def test_a_signal_that_a_recording_lacks_is_named(tmp_path):
    other = {**POSITION, "topic": "/other"}
    built = Built(tmp_path, [joints(0, ABC, [1, 2, 3])], {"arm": POSITION, "more": other})
    rig, inventory = built.recipe.rigs[0], built.graph.inputs.inventory
    missing = "more: topic /other is not in the recording, so it has no such signal"
    assert channels_present(rig, inventory, ChannelsCheck()).problems == [missing]
    assert not channels_present(rig, inventory, ChannelsCheck(optional=("more",))).problems


@pytest.mark.parametrize(
    ("signal", "error"),
    [
        ({"field": "axes[x]"}, "must be the path of a field"),
        ({"field": "position", "names": ["a", "a"]}, "a is listed twice"),
        ({"field": "position", "names": ["stamp_ns"]}, "stamp_ns is the column of the stamps"),
        ({"field": "position", "unit": "V", "recorded_unit": "deg"}, "deg cannot be converted to V"),
    ],
)
def test_mistakes_in_the_recipe(tmp_path, signal, error):
    with pytest.raises(BagAssetsError, match="rigs") as err:
        Built(tmp_path, [joints(0, ABC, [1, 2, 3])], {"arm": {"topic": "/joint_states", **signal}})
    assert error in str(err.value).replace("\n", " ")


def test_a_rig_needs_channels_or_signals(tmp_path):
    with pytest.raises(BagAssetsError, match="needs at least one channel, unless the rig has signals"):
        Built(tmp_path, [joints(0, ABC, [1, 2, 3])], {})


def test_a_recording_without_any_of_the_signals_is_skipped(tmp_path):
    built = Built(tmp_path, [joints(0, ABC, [1, 2, 3])], {"arm": {**POSITION, "topic": "/other"}})
    assert (
        built.results["signals"].reason == "none of the channels or signals of rig arm has readable messages"
    )
