"""What a recording names its topics, frames and objects, and how its file is called: shown, never obeyed.

A recording whose every name carries something for each place that shows it, through the real commands:
what they print, what Dagster has on record, the recipe, the pages.
"""

import json
import re
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest
import yaml
from dagster import DagsterEventType, DagsterInstance, MarkdownMetadataValue
from markdown_it import MarkdownIt
from rosbags.rosbag1 import Writer

import bagassets
from bagassets.base.escaping import html, markdown, terminal, visible, yaml_scalar
from bagassets.forkserver.client import Client
from bagassets.recipe import parse_recipe
from bagassets_tests.label_files import box_entries, box_json
from bagassets_tests.services import BIN, bare_environment
from bagassets_tests.small_drive import LATENCY_NS, START_NS, STORE1, messages

pytestmark = pytest.mark.once

PAYLOAD = (
    "![x](/graphql?query=mutation{wipe})<img src=/x onerror=alert(1)></td><script>alert(2)</script>"
    " [link](https:evil.example) `code` | __bold__ *it* & &lt; \"quoted\" 'single' #: {a: b}"
    "\x1b]0;title\x07\x1b[31mred\x1b[2J\x7f\x9b5m\n    urdf: /etc/hostname\r\n6 built in 1.0 s\u2028x: y\x85z: w\u202edesrever"
)
NAMES = {"/cam/image_raw": "/cam/image_raw" + PAYLOAD, "/odom": "/odom\n    urdf: /etc/hostname" + PAYLOAD}
MARKDOWN = MarkdownIt("gfm-like", {"linkify": False})


@pytest.mark.parametrize(
    "text",
    [
        PAYLOAD,
        "/odom",
        "a_b _c_ __d__",
        "\\*",
        "![a](b)",
        "<b>",
        "a|b",
        "http://e.org www.e.org a@e.org",
        "~~s~~",
        "# h",
        "$x$",
    ],
)
def test_markdown_shows_the_text_itself(text):
    shown = MARKDOWN.parse(f"| a |\n|---|\n| {markdown(text)} |\n")
    inline = [token for token in shown if token.type == "inline"][1]
    assert {child.type for child in inline.children} <= {"text", "text_special"}
    assert "".join(child.content for child in inline.children) == visible(text).strip()
    assert [token.type for token in shown].count("td_open") == 1


@pytest.mark.parametrize(
    "text", [PAYLOAD, "", "yes", "a: b", "- x", "null", "1e3", "\ud800", "\U000e0001\U0001f697", "a\tb"]
)
def test_yaml_gives_the_text_back(text):
    assert yaml.safe_load(f"key: {yaml_scalar(text)}\nother: 1\n") == {"key": text, "other": 1}


@pytest.mark.parametrize("text", [PAYLOAD, "\x00\x08\x0b\u200f\u2066\ufeff\udcff"])
def test_what_is_visible_is_one_line_and_comes_back_unchanged(text):
    assert visible(text).isprintable()
    assert visible(visible(text)) == visible(text)
    assert "\n" not in visible(text)
    assert terminal(f"{visible(text)}\nnext") == f"{visible(text)}\nnext"
    assert "\x1b" not in terminal(text)


def test_text_of_any_language_is_left_alone():
    text = "Straße 北京 القاهرة 🚗 \u00a0|"
    assert visible(text) == text


def test_html_shows_the_text_itself():
    page = Page(f'<p title="{html(PAYLOAD)}">{html(PAYLOAD)}</p>')
    assert page.tags == {"p"}
    assert page.text == visible(PAYLOAD)


class Page(HTMLParser):
    """Elements and text of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.handlers, self.text, self.script = set(), [], "", ""
        self._in = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        self._in.append(tag)

    def handle_endtag(self, tag):
        while self._in and self._in.pop() != tag:
            pass

    def handle_data(self, data):
        if self._in and self._in[-1] in {"script", "style"}:
            self.script += data
        else:
            self.text += data


def hostile(name):
    return NAMES.get(name, name + PAYLOAD)


def write_hostile(path):
    """The small drive with a payload in every name but those that tie the frames of the rig together."""
    with Writer(path) as writer:
        connections = {}
        for topic, msgtype, stamp_ns, message in messages(STORE1, 2.0, ros1=True):
            if topic == "/cam/image_raw":
                message.header.frame_id = "cam" + PAYLOAD
            if topic == "/tf_static":
                message.transforms[0].child_frame_id = "cam" + PAYLOAD
            if topic == "/points":
                # A sensor that nothing relates to the vehicle: an error that quotes its frame.
                message.header.frame_id = "nowhere" + PAYLOAD
            name = topic if topic == "/tf_static" else hostile(topic)
            if name not in connections:
                connections[name] = writer.add_connection(name, msgtype, typestore=STORE1)
            writer.write(connections[name], stamp_ns + LATENCY_NS, STORE1.serialize_ros1(message, msgtype))
        string = writer.add_connection("/chatter" + PAYLOAD, "std_msgs/msg/String", typestore=STORE1)
        data = STORE1.serialize_ros1(STORE1.types["std_msgs/msg/String"](PAYLOAD), "std_msgs/msg/String")
        writer.write(string, START_NS, data)


def run(folder, *command):
    """Run a command; what it prints is checked for everything a terminal would obey."""
    done = subprocess.run(
        [str(BIN / "bagassets"), *map(str, command)],
        check=False, capture_output=True, text=True, cwd=folder, env=bare_environment(), timeout=300,
    )  # fmt: skip
    for line in (done.stdout + done.stderr).split("\n"):
        assert visible(line) == line, (command, line)
        assert not line.startswith(("    urdf:", "6 built", "x: y", "z: w")), (command, line)
    assert "Traceback" not in done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile")
    bags = folder / "bags"
    bags.mkdir()
    write_hostile(bags / "a.bag")
    # What is on the box: classes, tracks and attributes; one class without counterpart is named.
    boxes = [entry | {"category": entry["category"] + PAYLOAD} for entry in box_entries()]
    (bags / "a.boxes.json").write_text(box_json(boxes))
    # Of file names, what a file system takes.
    (bags / f"torn{PAYLOAD.replace('/', '_')[:90]}\x1b[31m\n6 built.bag").write_bytes(
        b"#ROSBAG V2.0\nnothing"
    )
    made = run(folder, "init", "project", "--bags", bags)
    assert made.returncode == 2, made.stderr  # one sensor is nowhere
    yield folder / "project"
    for client in Client.all_of(folder / "project" / ".bagassets"):
        client.shutdown(grace_s=0.0)


def test_init_quotes_names_and_keeps_comments_comments(project):
    text = (project / "recipe.yaml").read_text("utf-8")
    loaded = yaml.safe_load(text)
    assert set(loaded) <= {"name", "bags", "clock", "rigs", "scenes", "nuscenes", "splits"}
    rig = loaded["rigs"][0]
    assert "urdf" not in json.dumps(sorted(rig))
    assert rig["ego_pose"] == {"source": "odometry", "topic": NAMES["/odom"]}
    assert {channel["topic"] for channel in rig["channels"].values()} == {
        NAMES["/cam/image_raw"],
        hostile("/points"),
    }
    decided = parse_recipe(text.replace("        extrinsics:\n", ""), project / "recipe.yaml")
    assert decided.rigs[0].ego_pose.topic == NAMES["/odom"]
    assert not any(
        line.lstrip().startswith(("urdf:", "6 built", "x: y", "z: w")) for line in text.splitlines()
    )


@pytest.fixture(scope="module")
def built(project):
    """The project, built: once as proposed, where a sensor is nowhere, and once with that sensor placed."""
    recipe = project / "recipe.yaml"
    # Without the open field it would be refused before any run.
    recipe.write_text(recipe.read_text("utf-8").replace("        extrinsics:\n", ""))
    first = run(project, "build")
    assert first.returncode == 1
    assert "nowhere![x]" in first.stderr + first.stdout
    text = recipe.read_text("utf-8")
    topic = f"topic: {yaml_scalar(hostile('/points'))}\n"
    assert topic in text
    placed = "          extrinsics: {translation: [0, 0, 1.8], rotation: [1, 0, 0, 0]}\n"
    boxes = "    annotation_files: [{format: boxes, path: '{stem}.boxes.json'}]\n    channels:\n"
    recipe.write_text(text.replace(topic, topic + placed[2:]).replace("    channels:\n", boxes))
    second = run(project, "build")
    assert "1 built, 1 failed" in second.stdout, second.stdout + second.stderr
    return project


@pytest.mark.parametrize(
    "command",
    [
        ("status", "--all"), ("check",), ("build", "--dry-run"), ("verify",), ("explain", "a.bag", "calibration"),
        ("inspect", "../bags/a.bag"), ("digest", "../bags"), ("report",),
    ],
)  # fmt: skip
def test_commands_print_nothing_that_a_terminal_obeys(built, command):
    done = run(built, *command)
    assert done.stdout + done.stderr


def test_commands_print_through_one_module():
    """What is printed by another way would not be escaped."""
    folder = Path(bagassets.__file__).parent / "cli"
    direct = {
        f"{path.name}: {line.strip()}"
        for path in folder.glob("*.py")
        for line in path.read_text("utf-8").splitlines()
        if re.search(r"\bclick\.echo\(|(?<![\w.])print\(", line) and path.name != "terminal.py"
    }
    assert {line for line in direct if not re.search(r"\} checked\",", line)} == set()


def test_inspect_names_the_topics(built):
    shown = run(built, "inspect", "../bags/a.bag").stdout
    assert visible(NAMES["/odom"]) in shown


def test_dagster_has_text_that_its_web_ui_shows_and_does_not_render(built, monkeypatch):
    monkeypatch.setenv("DAGSTER_HOME", str(built))
    with DagsterInstance.get() as instance:
        kinds = {DagsterEventType.ASSET_MATERIALIZATION, DagsterEventType.ASSET_CHECK_EVALUATION}
        metadata = []
        failures = []
        for run_record in instance.get_runs():
            for entry in instance.all_logs(run_record.run_id):
                event = entry.dagster_event
                if event is None:
                    continue
                if event.event_type in kinds:
                    data = event.event_specific_data
                    found = getattr(data, "materialization", data).metadata
                    metadata += found.values()
                if event.event_type is DagsterEventType.STEP_FAILURE:
                    failures.append(event.step_failure_data.user_failure_data.description)
    texts = [value.value for value in metadata if isinstance(value, MarkdownMetadataValue)]
    assert any("/cam/image\\_raw" in text or "/cam/image_raw" in text for text in texts)
    assert any("Car!" in str(value.value) for value in metadata)
    for text in texts:
        tokens = MARKDOWN.parse(text)
        inner = [child for token in tokens for child in token.children or ()]
        for token in [*tokens, *inner]:
            assert not token.type.startswith(("html", "code", "em_", "strong", "fence")), text
            if token.type == "link_open":  # from one of our pictures to itself, or to one of our pages
                assert re.fullmatch(
                    r"/bagassets/(artifacts/[0-9a-f]{64}/[a-z_]+\.jpg|pages/(map|report))",
                    token.attrs["href"],
                ), text
            if token.type == "image":
                assert re.match(
                    r"data:image/jpeg;base64,|/bagassets/artifacts/[0-9a-f]{64}/inline/[a-z_]+\.jpg$",
                    token.attrs["src"],
                )
    assert any("nowhere![x]" in text for text in failures)
    for text in failures:
        assert terminal(text) == text


def test_the_report_and_the_map_hold_no_element_of_a_name(built):
    pages = [*built.rglob("*.html")]
    assert pages
    for path in pages:
        page = Page(path.read_text("utf-8"))
        assert page.handlers == []
        assert "alert(" not in page.script
        assert visible(page.text.replace("\n", "")) == page.text.replace("\n", "")
