"""README and first steps: the commands of that page are run in their order in an empty folder, and print what it shows."""

import doctest
import json
import os
import re
import shlex
import signal
import subprocess
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import dagster as dg
import pytest

from bagassets.cli.main import COMMANDS
from bagassets.defs.records.instances import open_instance
from bagassets_tests.services import BIN, bare_environment, eventually, free_port, running

pytestmark = pytest.mark.once

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text("utf-8")
STEPS = (ROOT / "docs" / "first-steps.md").read_text("utf-8")
HOME = "/home/me/bagassets"  # the checkout, as the page shows it

# Commands of both that the test does not run as they are, and why.
NOT_RUN = {
    "make demo": "it makes an environment; its last line is run in the one there is",
    "make test": "it runs this",
    "pip install dist/bagassets-*.whl": "test_wheel installs into a new environment",
    "pip wheel --no-deps --wheel-dir dist .": "test_wheel makes the wheel",
    "pip install .": "it makes and installs that wheel",
    "pip install '.[dg]'": "it is tried by hand, with each release of Dagster",
    "bagassets demo --robot arm build/arm": "test_demo runs it in a folder of its own",
    "pip uninstall llvmlite": "test_kernels runs without it",
    "export PATH=$PWD/.venv/bin:$PATH": "the environment of the tests is on the PATH",
}
# Rows of the table of further commands, and what is run for each, in the project folder.
MORE = {
    "bagassets inspect BAG": ["inspect ../recordings/drive_1.bag"],
    "bagassets explain BAG ASSET, explain DATASET": [
        "explain drive_1.bag frames",
        "explain nuscenes_dataset",
    ],
    "bagassets build --dry-run, --check": ["build", "build --dry-run", "build --check"],
    "bagassets check, report, view SCENE": ["check", "report", "view --list", "view drive_3_000"],
    "bagassets digest, watch": ["digest ../recordings/drive_1.bag", "watch --once ../recordings"],
    # The service wrote attributes, so files may have been edited in place: only a build hashes them again.
    "bagassets verify, gc": ["build", "verify", "verify --recordings", "verify --rebuild 1", "gc"],
    "bagassets dataset diff, restore": [
        "dataset diff dataset/nuscenes/v1.0-van/dataset.lock.json dataset/nuscenes",
        "dataset restore dataset/nuscenes/v1.0-van/dataset.lock.json",
    ],
    "bagassets sample": ["sample drive.mcap --duration 0.5"],
}


@dataclass(frozen=True)
class Command:
    """A command that a page shows, and the lines that it shows below it."""

    text: str
    shown: tuple[str, ...]


def blocks(page=STEPS):
    return re.findall(r"^```\w*\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)


def commands(page=STEPS):
    """Yield the commands at a prompt in the order of a page."""
    for block in blocks(page):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, *shown = part.splitlines()
            yield Command(re.sub(r"\s+# .*", "", command), tuple(filter(None, map(str.rstrip, shown))))


def more_rows():
    table = STEPS.partition("## More commands\n")[2]
    return [row.replace("`", "") for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)]


def in_text():
    """Return the commands that the text names between backticks, without blocks."""
    prose = re.sub(r"^```.*?^```$", "", README + STEPS, flags=re.MULTILINE | re.DOTALL)
    return re.findall(r"`((?:bagassets|make|pip|dagster) [^`]*)`", prose)


def test_every_command_is_run_or_listed_with_the_reason_why_not():
    assert more_rows() == list(MORE)
    texts = [command.text for command in commands()]
    assert len(texts) > 10
    run = {text.split()[1] for text in texts if text.startswith("bagassets")}
    run |= {call.split()[0] for calls in MORE.values() for call in calls}
    assert run <= COMMANDS.keys()
    for text in in_text():
        if text in NOT_RUN or text in MORE:
            continue
        program, name, *_ = text.split()
        if program == "bagassets":
            assert name in run, text
        elif program == "make":
            assert re.search(rf"^{name}:", (ROOT / "Makefile").read_text(), re.MULTILINE), text
        else:
            assert any(shown.startswith(text) for shown in texts), text
    page = [
        *texts,
        *in_text(),
        *(line.split("#")[0].strip() for block in blocks(README + STEPS) for line in block.splitlines()),
    ]
    assert NOT_RUN.keys() <= set(page), "what is not on the page needs no reason"


def test_the_readme_shows_commands_of_the_first_steps():
    shown = [command.text for command in commands(README)]
    assert len(shown) > 5
    assert set(shown) <= {command.text for command in commands()}


def test_the_readme_is_short():
    assert len(README.encode()) < 7_500


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no git checkout")
def test_what_it_makes_in_a_checkout_is_ignored_by_git_and_so_by_linters():
    made = [
        re.search(pattern, STEPS)[1]
        for pattern in (r"\$ cp -r \S+ (\S+)", r"\$ bagassets convert \S+ (\S+)", r"\$ bagassets init (\S+)")
    ]
    assert made == ["recordings", "drive_1", "van"]
    for name in ("build", *made):
        ignored = subprocess.run(["git", "check-ignore", "--quiet", f"{name}/"], cwd=ROOT, check=False)
        assert ignored.returncode == 0, name


def plain(text, folder):
    """Return the lines of an output as the page shows them: without what differs between runs and machines."""
    text = text.replace(str(folder), HOME)
    text = re.sub(r"\d+(\.\d+)? s\b(?! of drive)", "# s", text)
    text = re.sub(r"[\d.]+ [KMGT]B free", "# free", text)
    text = re.sub(r"/\.drive_1\.\w+/", "/.drive_1/", text)
    text = re.sub(r"127\.0\.0\.1:\d+", "127.0.0.1", text)
    return [line.rstrip() for line in text.splitlines() if line.strip()]


def differences(shown, printed, beside):
    """Compare what is shown with what was printed; both as `plain` returns them.

    Args:
        shown: lines of the page; `(and N more)` stands for N lines, any other line in brackets for any number.
        printed: lines of the standard output: all of them must be shown.
        beside: lines of the standard error: they may be.
    """
    left, found = list(printed), []
    rest = iter([line for line in shown if line in printed or line not in beside])
    skip = False
    for line in rest:
        if (more := re.fullmatch(r" *\(and (\d+) more\)", line)) is not None:
            del left[: int(more[1])]
        elif re.fullmatch(r" *\(.*\)", line):
            skip = True
        else:
            while skip and left and left[0] != line:
                left.pop(0)
            skip = False
            if not left or left.pop(0) != line:
                return [f"shown, but not printed there: {line}"]
    return found + [f"printed, but not shown: {line}" for line in left]


def test_outputs_are_compared_line_by_line():
    shown = ["one", "  (and 2 more)", "four", "(the table above)", "six", "aside"]
    assert differences(shown, ["one", "2", "3", "four", "5", "5b", "six"], ["aside"]) == []
    assert differences(shown, ["one", "2", "four", "six"], ["aside"]) == [
        "shown, but not printed there: four"
    ]
    assert differences(["one"], ["one", "two"], []) == ["printed, but not shown: two"]
    assert differences(["one", "two"], ["one"], []) == ["shown, but not printed there: two"]


# Executes what is typed at Python's prompt, one after another, and prints what each prints.
SESSION = """
import contextlib, io, json, sys
names, printed = {"__name__": "__main__"}, []
for source in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(compile(source, "<stdin>", "single"), names)
    printed.append(out.getvalue())
print(json.dumps(printed))
"""


class Reader:
    """Types what the page shows, in a folder."""

    def __init__(self, folder, stack):
        self.root = self.folder = folder
        self.stack = stack
        self.ui = None

    def call(self, text, timeout=600):
        return subprocess.run(
            ["bash", "-c", text], cwd=self.folder, capture_output=True, text=True, timeout=timeout, check=False,
            env={**bare_environment(), "COLUMNS": "120", "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"},
        )  # fmt: skip

    def type(self, command):
        """Run a command and compare its output."""
        if command.text in NOT_RUN:
            return
        if command.text.startswith("cd "):
            self.folder = self.folder / command.text.removeprefix("cd ")
        elif command.text == "python":
            self.type_at_python(command)
        elif command.text == "bagassets ui":
            self.start_ui(command)
        else:
            if command.text.startswith("bagassets status") and self.ui is not None:
                eventually(
                    lambda: "nuscenes_dataset: fresh" in self.call(command.text).stdout, "it is built", 300
                )
            done = self.call(command.text)
            assert done.returncode == 0, f"{command.text}\n{done.stdout}\n{done.stderr}"
            self.compare(command, done.stdout, done.stderr)
            if command.text.startswith("bagassets status"):
                self.end_ui()  # the next section begins with Ctrl-C

    def compare(self, command, stdout, stderr):
        shown = plain("\n".join(command.shown), self.root)
        found = differences(shown, plain(stdout, self.root), plain(stderr, self.root))
        assert found == [], f"{command.text}\n{stdout}\n{stderr}"

    def type_at_python(self, command):
        examples = doctest.DocTestParser().get_examples("\n".join([*command.shown, ""]))
        assert len(examples) >= 5
        sources = json.dumps([example.source for example in examples])
        done = self.call(f"python -c {shlex.quote(SESSION)} {shlex.quote(sources)}")
        assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
        for example, printed in zip(examples, json.loads(done.stdout), strict=True):
            assert plain(printed, self.root) == plain(example.want, self.root), example.source

    def start_ui(self, command):
        log = self.root / "ui.log"
        call = [BIN / "bagassets", "ui", "--no-browser", "--port", free_port()]
        self.ui = self.stack.enter_context(running(call, self.folder, log))
        eventually(lambda: "http" in log.read_text(), "it prints its address", 180)
        self.compare(command, log.read_text(), "")

    def end_ui(self):
        if self.ui is not None:
            self.ui.send_signal(signal.SIGINT)
            assert self.ui.wait(120) == 0
            self.ui = None


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """The project that the page makes, after all its commands at a prompt."""
    folder = tmp_path_factory.mktemp("readme")
    with ExitStack() as stack:
        reader = Reader(folder, stack)
        # What `make demo` runs in the end.
        recipe = re.search(r"^demo:.*\n\t@\$\(BIN\)/(.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)[1]
        done = reader.call(recipe)
        assert done.returncode == 0, done.stderr
        [table] = [block for block in blocks() if block.startswith(" recording ")]
        # It "ends like this".
        found = differences(["(before)", *plain(table, folder)], plain(done.stdout, folder), [])
        assert found == [], done.stdout
        for command in commands():
            reader.type(command)
        yield reader


# Half of the time goes into six drives of the length that the page shows.
@pytest.mark.long
@pytest.mark.xdist_group("readme")
class TestAsTyped:
    def test_commands_print_what_is_shown(self, project):
        lock = json.loads((project.folder / "dataset/nuscenes/v1.0-van/dataset.lock.json").read_text())
        drives = {1: ".bag", 2: ".bag", 3: "", 4: "", 5: ".mcap", 6: ".mcap", 7: ".mcap", 8: ".bag"}
        assert [bag["key"] for bag in lock["bags"]] == [f"drive_{n}{end}" for n, end in drives.items()]

    def test_a_second_time_everything_is_a_hit(self, project):
        command = next(one for one in commands() if "--partition" in one.text)
        done = project.call(command.text)
        assert done.stdout.splitlines() == list(command.shown)
        with open_instance(str(project.folder)) as instance:
            for name in ("inventory", "frames", "sweeps", "nuscenes_tables"):
                only = dg.AssetRecordsFilter(asset_key=dg.AssetKey(name), asset_partitions=["drive_8.bag"])
                second, first = instance.fetch_materializations(only, limit=2).records
                assert first.asset_materialization.metadata["cached"].value is False
                assert second.asset_materialization.metadata["cached"].value is True

    @pytest.mark.parametrize("row", MORE)
    def test_further_commands_run(self, project, row):
        for call in MORE[row]:
            done = project.call(f"bagassets {call}")
            assert done.returncode == 0, f"{call}\n{done.stdout}\n{done.stderr}"
            assert (done.stdout + done.stderr).strip(), call
