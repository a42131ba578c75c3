"""The graph of one recording and what executes it, with assets made up for it."""

from collections import Counter
from dataclasses import dataclass, replace

import pytest

from bagassets.assets.asset import Asset, Use, uses_of
from bagassets.assets.inventory import INVENTORY
from bagassets.base.errors import CalibrationError, PluginError, RecipeError
from bagassets.engine import execute as execution
from bagassets.engine.execute import BuildFailure, Skipped, execute, run_again
from bagassets.engine.graph import Graph
from bagassets.engine.plan import Recorded
from bagassets.engine.planner import plan_recording, recorded_graph
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from bagassets_tests.small_drive import RECIPE, write_drive

pytestmark = pytest.mark.once


@dataclass(frozen=True)
class Text:
    """What a made-up action writes."""

    text: str


class Made(Counter):
    """Counts what ran, and fails what it has to."""

    failing = frozenset()

    def note(self, name):
        self[name] += 1
        if name in self.failing:
            raise CalibrationError(f"{name} is not to be made")


@pytest.fixture
def ran():
    return Made()


def step(name, ran, *reads, text="text", **fields):
    """An asset that writes a text, and reads the digests of those upstream."""

    def use(params, facts):
        return {"": Use(params, inputs={above.name: facts.artifact(above.name).digest for above in reads})}

    def make(use, inputs, out):
        ran.note(name)
        out.write("text", use.params.text.encode())
        return {}

    options = {"params": lambda recipe, rig: Text(text), "use": use, "make": make} | fields
    return Asset(name=name, version=1, title=name, kinds=frozenset(), reads=reads, **options)


class Extractor:
    """Counts the messages of a topic; a channel that is to fail does so at its first message."""

    def __init__(self, channel, ran, recording, out, topic):
        self.topics, self.channel, self.ran, self.out = (topic,), channel, ran, out
        self.recording, self.number = recording, 0

    def add(self, message):
        self.number += 1
        if self.number == 1:
            self.ran.note(self.channel)

    def finish(self):
        self.out.write("count", str(self.number).encode())
        return {"counts": {"written": self.number}, "bytes": 1}


def channels(name, ran, topics, *reads, refused=(), error=RecipeError, **fields):
    """An asset with a channel for each topic."""

    def use(params, facts):
        def one(channel, topic):
            if channel in refused:
                raise error(f"{channel} cannot be")
            return Use(Text(channel), topics=(topic,))

        return uses_of(topics, one)

    def extract(use, inputs, recording, out, pool):
        return Extractor(use.params.text, ran, recording, out, use.topics[0])

    options = {"params": lambda recipe, rig: None, "use": use, "extract": extract} | fields
    return Asset(name=name, version=1, title=name, kinds=frozenset(), reads=reads, **options)


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("graph")
    write_drive(folder / "bags" / "a.bag", "ros1", duration_s=0.5)
    return folder / "bags"


@pytest.fixture
def project(bags, tmp_path):
    def graph(*assets, fields="", **options):
        text = RECIPE.format(name="test", root=bags).replace("settle_s: 0", f"settle_s: 0{fields}")
        (tmp_path / "recipe.yaml").write_text(text)
        recipe = load_recipe(tmp_path / "recipe.yaml")
        (recording,) = discover(recipe.bags).recordings.values()
        digest, stat = recording_digest(recording).digest, recording_stat(recording)
        known = RecordingAssets(recipe, (INVENTORY, *assets))
        known.store = Store(tmp_path / "store")
        return Graph(known, recording, digest, stat, **options)

    return graph


def executed(graph):
    """Return what was made, in order, and what failed."""
    made = []
    try:
        made.extend(
            result.reason if isinstance(result, Skipped) else result.asset
            for result in execute(graph, threads=1)
        )
    except BuildFailure as failure:
        return made, {name: str(err) for name, err in failure.errors.items()}
    return made, {}


def states(graph):
    return {name: (state.state, state.reason) for name, state in graph.states().items() if name != "bag"}


# --- nodes --------------------------------------------------------------------------------


def test_nothing_runs_while_a_graph_is_looked_at(project, ran):
    poses = step("poses", ran, INVENTORY)
    graph = project(poses, step("boxes", ran, INVENTORY, poses))
    assert [node.name for node in graph.nodes()] == ["inventory", "poses", "boxes"]
    assert states(graph) == {
        "inventory": ("missing", "never made"),
        "poses": ("unknown", "waits for inventory — never made"),
        "boxes": ("unknown", "waits for inventory — never made"),
    }
    assert graph.node("inventory").action is not None
    assert graph.node("poses").action is None
    assert not graph.store.root.exists()
    assert not ran


def test_a_graph_expands_as_what_is_above_becomes_known(project, ran):
    poses = step("poses", ran, INVENTORY)
    assets = (poses, channels("images", ran, {"CAM": "/cam/image_raw"}, INVENTORY, poses))
    executed(project(*assets, wanted={"inventory"}))
    graph = project(*assets)
    assert states(graph) == {
        "inventory": ("record-only", "the store has it, Dagster has no record"),
        "poses": ("missing", "never made"),
        "images": ("unknown", "waits for poses — never made"),
    }
    assert graph.node("images").parts == ()
    executed(graph)
    assert [part.name for part in graph.node("images").parts] == ["images CAM"]
    assert [node.name for node in graph.nodes()] == ["inventory", "poses", "images CAM", "images"]


def test_as_long_as_its_content_is_not_known_nothing_of_a_recording_is(project, ran):
    graph = project(step("poses", ran, INVENTORY), recorded={"poses": Recorded("1", "1")})
    graph = replace(graph, digest=None, bag=graph.bag._replace(state="stale", reason="size changed"))
    assert states(graph) == {
        "inventory": ("missing", "waits for bag — size changed"),
        "poses": ("unknown", "waits for bag — size changed"),
    }


def test_a_node_depends_on_what_it_needs_under_its_parameters(project, ran):
    poses = step("poses", ran, INVENTORY)
    ran.failing = {"poses"}
    still = channels(
        "clouds", ran, {"LIDAR": "/points"}, INVENTORY, poses, waits_for=lambda *_: frozenset({"inventory"})
    )
    made, failed = executed(project(poses, still))
    assert made == ["inventory", "clouds"]
    assert set(failed) == {"poses"}


@pytest.mark.parametrize(("topic", "waits"), [("/points", True), ("/radar", False)])
def test_what_a_recording_holds_can_decide_what_a_node_depends_on(project, ran, topic, waits):
    def needs(_, inventory):
        moved = {"poses"} if inventory is not None and topic in inventory.topics else set()
        return frozenset({"inventory", *moved})

    poses = step("poses", ran, INVENTORY)
    clouds = channels("clouds", ran, {"LIDAR": "/points"}, INVENTORY, poses, waits_for=needs)
    assert states(project(poses, clouds))["clouds"] == ("unknown", "waits for inventory — never made")
    executed(project(poses, clouds, wanted={"inventory"}))
    state = states(project(poses, clouds))["clouds"]
    assert state == (("unknown", "waits for poses — never made") if waits else ("missing", "never made"))


# --- execution ----------------------------------------------------------------------------


def test_what_is_known_is_not_run_again(project, ran):
    poses = step("poses", ran, INVENTORY)
    images = channels("images", ran, {"CAM": "/cam/image_raw"}, INVENTORY)
    first = list(execute(project(poses, images)))
    again = list(execute(project(poses, images)))
    assert [result.cached for result in first] == [False] * 3
    assert [result.cached for result in again] == [True] * 3
    assert [result.artifact for result in again] == [result.artifact for result in first]
    assert ran == {"poses": 1, "CAM": 1}
    changed = step("poses", ran, INVENTORY, text="other")
    assert [result.cached for result in execute(project(changed, images))] == [True, False, True]


def test_a_failure_costs_what_depends_on_it_and_nothing_else(project, ran):
    poses, places = step("poses", ran, INVENTORY), step("places", ran, INVENTORY)
    boxes = step("boxes", ran, INVENTORY, poses)
    ran.failing = {"poses"}
    graph = project(poses, places, boxes)
    made, failed = executed(graph)
    assert made == ["inventory", "places"]
    assert set(failed) == {"poses"}
    assert "poses is not to be made" in failed["poses"]
    # It is on record: the plan tells, and runs nothing.
    again = project(poses, places, boxes)
    assert states(again)["poses"] == ("failed", "poses is not to be made")
    assert states(again)["boxes"] == ("unknown", "waits for poses — poses is not to be made")
    assert ran["poses"] == 1


def test_what_nobody_thought_of_costs_one_asset_and_is_not_on_record(project, ran):
    def make(use, inputs, out):
        raise ZeroDivisionError("by nought")

    odd = step("odd", ran, INVENTORY, make=make)
    made, failed = executed(project(odd, step("poses", ran, INVENTORY)))
    assert made == ["inventory", "poses"]
    assert "bagassets was not made for (ZeroDivisionError: by nought" in failed["odd"]
    assert states(project(odd))["odd"] == ("missing", "never made")


def test_what_raises_while_planned_fails_alone(project, ran):
    def use(params, facts):
        raise KeyError("/nowhere")

    odd = step("odd", ran, INVENTORY, use=use)
    graph = project(odd, step("poses", ran, INVENTORY))
    made, failed = executed(graph)
    assert made == ["inventory", "poses"]
    assert set(failed) == {"odd"}
    state, reason = states(graph)["odd"]
    assert state == "failed"
    assert "KeyError: '/nowhere'" in reason


def test_a_recording_that_takes_no_part_has_an_inventory_only(project, ran):
    poses = step("poses", ran, INVENTORY)
    graph = project(poses, step("boxes", ran, poses), fields=", min_duration_s: 100")
    made, failed = executed(graph)
    assert failed == {}
    reason = graph.node("selection").skipped
    assert reason.endswith("bags.min_duration_s asks for 100 s")
    assert made == ["inventory", reason, reason]
    assert states(graph)["boxes"] == states(graph)["poses"] == ("skipped", reason)
    assert not ran


def test_what_is_made_along_is_made_with_one_that_is_there_already(project, ran):
    # Without boxes, the annotations of all recordings are one artifact; their tracks differ.
    executed(project(step("boxes", ran, INVENTORY)))
    boxes = step("boxes", ran, INVENTORY, along=(step("track", ran, INVENTORY),))
    executed(project(boxes))
    assert ran == {"boxes": 1, "track": 1}


def test_what_is_made_along_is_made_once_and_never_shown(project, ran):
    track = step("track", ran, INVENTORY)
    pictures = step("pictures", ran, INVENTORY, along=(track,))
    graph = project(pictures)
    assert executed(graph) == (["inventory", "pictures"], {})
    assert ran == {"pictures": 1, "track": 1}
    assert "track" not in states(graph)
    assert [node.name for node in graph.nodes()] == ["inventory", "pictures", "track"]
    executed(project(pictures))
    assert ran == {"pictures": 1, "track": 1}
    # It is nobody's upstream: that it fails costs nothing here.
    ran.failing = {"way"}
    other = step("pictures", ran, INVENTORY, text="new", along=(step("way", ran, INVENTORY),))
    assert executed(project(other)) == (["inventory", "pictures"], {})
    assert ran["way"] == 1


# --- passes -------------------------------------------------------------------------------

TOPICS = {"CAM": "/cam/image_raw", "LIDAR": "/points", "ODOM": "/odom"}


@pytest.fixture
def passes(monkeypatch):
    """The channels of each pass over the recording."""
    made, run_pass = [], execution.run_pass

    def note(graph, recording, nodes, *rest):
        made.append([node.channel for node in nodes])
        return run_pass(graph, recording, nodes, *rest)

    monkeypatch.setattr(execution, "run_pass", note)
    return made


def test_channels_of_all_assets_share_a_pass(project, ran, passes):
    images = channels("images", ran, {"CAM": TOPICS["CAM"]}, INVENTORY)
    poses = step("poses", ran, INVENTORY)
    clouds = channels("clouds", ran, {"LIDAR": TOPICS["LIDAR"]}, INVENTORY, poses)
    made, _ = executed(project(images, poses, clouds))
    # The pass waits for what can be made before it.
    assert made == ["inventory", "poses", "images", "clouds"]
    assert passes == [["CAM", "LIDAR"]]


def test_a_channel_that_fails_does_not_stop_the_others(project, ran, passes):
    images = channels("images", ran, {"CAM": TOPICS["CAM"], "ODOM": TOPICS["ODOM"]}, INVENTORY)
    clouds = channels("clouds", ran, {"LIDAR": TOPICS["LIDAR"]}, INVENTORY)
    ran.failing = {"ODOM"}
    made, failed = executed(project(images, clouds))
    assert made == ["inventory", "clouds"]
    assert failed.keys() == {"images"}
    graph = project(images, clouds)
    parts = {part.channel: part for part in graph.node("images").parts}
    assert parts["CAM"].outcome is not None
    assert states(graph)["images"] == ("failed", "ODOM is not to be made")
    ran.failing = frozenset()
    del passes[:]
    assert executed(graph) == (["inventory", "images", "clouds"], {})
    assert passes == [["ODOM"]]
    assert ran == {"CAM": 1, "LIDAR": 1, "ODOM": 2}


def test_a_channel_that_cannot_be_as_the_recipe_asks_does_not_stop_the_others(project, ran):
    images = channels(
        "images", ran, {"CAM": TOPICS["CAM"], "ODOM": TOPICS["ODOM"]}, INVENTORY, refused=["ODOM"]
    )
    graph = project(images)
    made, failed = executed(graph)
    assert made == ["inventory"]
    assert "ODOM cannot be" in failed["images"]
    assert ran == {"CAM": 1}
    assert states(graph)["images"] == ("failed", "ODOM cannot be")


def test_whatever_is_raised_while_a_channel_is_planned_costs_that_channel_alone(project, ran):
    topics = {name: TOPICS[name] for name in ("CAM", "ODOM")}
    images = channels("images", ran, topics, INVENTORY, refused=["ODOM"], error=ValueError)
    graph = project(images)
    made, failed = executed(graph)
    assert made == ["inventory"]
    assert ran == {"CAM": 1}
    assert "a.bag: ODOM met something in this recording" in failed["images"]
    assert "(ValueError: ODOM cannot be; " in failed["images"]
    assert states(graph)["images"] == ("failed", failed["images"])


def test_a_recording_that_changes_fails_all_of_the_pass_and_leaves_no_record(project, ran):
    images = channels("images", ran, {"CAM": TOPICS["CAM"]}, INVENTORY)
    clouds = channels("clouds", ran, {"LIDAR": TOPICS["LIDAR"]}, INVENTORY)
    executed(project(wanted={"inventory"}))
    graph = project(images, clouds)
    path = graph.recording.path
    finish = Extractor.finish

    def change(self):
        path.touch()
        return finish(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Extractor, "finish", change)
        made, failed = executed(graph)
    assert made == ["inventory"]
    assert failed.keys() == {"images", "clouds"}
    assert all("changed while it was read" in output for output in failed.values())
    assert list(graph.store.root.glob("tmp/*")) == []
    assert {state for state, _ in states(project(images, clouds)).values()} == {"record-only", "missing"}


# --- partial runs -------------------------------------------------------------------------


def test_a_run_of_some_assets_goes_by_what_is_given(project, ran):
    poses = step("poses", ran, INVENTORY)
    boxes = step("boxes", ran, INVENTORY, poses)
    given = {
        result.asset: result.artifact for result in execute(project(poses, wanted={"inventory", "poses"}))
    }
    other = step("poses", ran, INVENTORY, text="other")
    (result,) = execute(project(other, step("boxes", ran, INVENTORY, other), wanted={"boxes"}, given=given))
    assert result.asset == "boxes"
    action = Store(result.artifact.folder.parents[2]).action(result.action_digest)
    assert action["inputs"]["poses"] == given["poses"].digest
    assert ran == {"poses": 1, "boxes": 1}
    made, failed = executed(project(poses, boxes, wanted={"boxes"}, given={"inventory": given["inventory"]}))
    assert made == []
    assert "poses is not materialized for this recording; materialize poses first" in failed["boxes"]


# --- plan ---------------------------------------------------------------------------------


def recorded_assets(graph):
    """What Dagster would have recorded of a graph that was executed."""
    return {
        name: Recorded(node.artifact.digest, graph.assets.versions[name], action=node.outcome.action_digest)
        for name in graph.assets.names
        if (node := graph.node(name)).outcome is not None
    }


def test_a_plan_says_what_changed_down_to_the_channel(project, ran):
    poses = step("poses", ran, INVENTORY)
    images = channels("images", ran, {"CAM": TOPICS["CAM"], "ODOM": TOPICS["ODOM"]}, INVENTORY)
    graph = project(poses, images)
    executed(graph)
    recorded = recorded_assets(graph)
    assert {state for state, _ in states(project(poses, images, recorded=recorded)).values()} == {"fresh"}

    changed = step("poses", ran, INVENTORY, text="new")
    wider = channels("images", ran, TOPICS, INVENTORY)
    found = states(project(changed, wider, recorded=recorded))
    assert found["poses"] == ("stale", "text text -> new")
    assert found["images"] == ("stale", "LIDAR is new")
    newer = replace(poses, version=2, make=poses.make)
    assert states(project(newer, images, recorded=recorded))["poses"] == ("stale", "step version 1 -> 2")


def test_what_is_the_same_under_another_code_version_is_only_recorded(project, ran):
    poses = step("poses", ran, INVENTORY)
    graph = project(poses)
    executed(graph)
    recorded = recorded_assets(graph)
    version, digest = recorded["poses"].code_version.split("-")
    for before, changed in {
        f"0-{digest}": "the step version",
        f"{version}-0": "the recipe or a library version",
        f"{version}-{digest}-0": "the installed decoder plug-ins",
        f"0-{digest}-0": "the step version and the installed decoder plug-ins",
    }.items():
        recorded["poses"] = replace(recorded["poses"], code_version=before)
        found = states(project(poses, recorded=recorded))["poses"]
        assert found == ("record-only", f"{changed} changed, the result did not")


def test_a_plan_names_the_artifacts_of_channels(project, ran):
    images = channels("images", ran, {"CAM": TOPICS["CAM"]}, INVENTORY, optional=True)
    graph = project(images)
    executed(graph)
    plan = plan_recording(recorded_graph(graph.assets, graph.recording, {}))
    assert plan.assets.keys() == {"bag", "inventory", "images"}
    assert plan.optional == {"images"}
    assert plan.channels == (graph.node("images").parts[0].artifact.digest,)


# --- again --------------------------------------------------------------------------------


def test_actions_run_again_on_what_is_on_record_and_the_store_stays_as_it_is(project, ran, tmp_path):
    poses = step("poses", ran, INVENTORY)
    images = channels("images", ran, {"CAM": TOPICS["CAM"]}, INVENTORY)
    executed(project(poses, images))
    graph = project(poses, images)
    nodes = list(graph.nodes())
    files = sorted(path for path in graph.store.root.rglob("*"))
    ran.failing = {"poses"}
    made = run_again(graph, nodes, Store(tmp_path / "scratch"), threads=1)
    assert sorted(path for path in graph.store.root.rglob("*")) == files
    assert str(made.pop("poses")) == "poses is not to be made"
    assert {name: outcome.artifact.digest for name, outcome in made.items()} == {
        node.name: node.artifact.digest for node in nodes if node.name != "poses"
    }
    assert all(outcome.artifact.folder.is_relative_to(tmp_path / "scratch") for outcome in made.values())


# --- the list -----------------------------------------------------------------------------


def test_a_list_of_assets_that_cannot_be_is_refused(ran):
    poses = step("poses", ran, INVENTORY)
    with pytest.raises(PluginError, match="asset poses reads inventory, which is not an asset before it"):
        RecordingAssets(None, [poses])
    with pytest.raises(PluginError, match="asset inventory is defined twice"):
        RecordingAssets(None, [INVENTORY, INVENTORY])


def test_what_reads_an_asset_that_the_recipe_leaves_out_is_left_out(ran):
    poses = step("poses", ran, INVENTORY, enabled=lambda _: False)
    boxes = step("boxes", ran, INVENTORY, poses)
    images = channels("images", ran, TOPICS, INVENTORY)
    rows = step("rows", ran, images)
    shown = step("shown", ran, INVENTORY, optional=True)
    assets = RecordingAssets(None, [INVENTORY, poses, boxes, images, rows, shown])
    assert assets.names == ("inventory", "images", "rows", "shown")
    assert assets.with_upstream(["rows", "boxes", "bag"]) == ("bag", "inventory", "images", "rows")
    assert assets.extracted == {"inventory", "images"}
    assert assets.optional == {"shown"}
