"""The wheel, as somebody has it who never saw the checkout: installed elsewhere, with the versions of the lock."""

import json
import os
import re
import shutil
import subprocess
import sys
from email.parser import HeaderParser
from pathlib import Path
from urllib.error import URLError
from urllib.request import Request, urlopen
from zipfile import ZipFile

import pytest

import bagassets
from bagassets_tests.services import bare_environment, eventually, free_port, running

ROOT = Path(__file__).parents[2]
CITED = re.compile(r"`bagassets docs\s+page ([a-z-]+)`")

# It downloads and installs for a minute.
pytestmark = [pytest.mark.long, pytest.mark.xdist_group("wheel")]


def run(*command, cwd, status=0, **environment):
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd, env=bare_environment() | environment, capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == status, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT, cwd=folder)
    [file] = folder.glob("*.whl")
    return file


@pytest.fixture(scope="module")
def away(tmp_path_factory):
    """A folder outside of the checkout, in which all commands run."""
    return tmp_path_factory.mktemp("away")


@pytest.fixture(scope="module")
def programs(wheel, away):
    """The programs of an environment with nothing but the wheel and what it asks for, made by the line of the docs."""
    page = (ROOT / "docs" / "install.md").read_text("utf-8")
    [line] = re.findall(r"^```\n(pip install .*)\n```$", page, re.MULTILINE)
    shutil.copy(wheel, away)
    run(sys.executable, "-m", "venv", "venv", cwd=away)
    folder = away / "venv" / "bin"
    path = f"{folder}{os.pathsep}{os.environ['PATH']}"
    # The versions of the lock, which pip is told here, as with `--constraint`.
    lock = {"PIP_CONSTRAINT": str(ROOT / "requirements.lock"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    run("bash", "-c", line, cwd=away, PATH=path, **lock)
    return folder


@pytest.fixture(scope="module")
def project(programs, away):
    """A project of one sample drive, built."""
    run(programs / "bagassets", "sample", "recordings/drive.mcap", "--duration", "2", cwd=away)
    said = run(programs / "bagassets", "init", "van", "--bags", "recordings", cwd=away)
    assert "Project" in said
    run(programs / "bagassets", "build", cwd=away / "van")
    return away / "van"


def test_tests_that_share_something_dear_are_run_by_one_worker(request):
    """A version of pytest that pytest-xdist does not know hides the groups from it: all would be made twice."""
    if request.config.getoption("loadgroup", False):
        assert request.node.nodeid.endswith("@wheel")


def test_it_holds_the_package_its_licence_and_its_pages_and_nothing_else(wheel):
    with ZipFile(wheel) as archive:
        names = archive.namelist()
    tops = {name.split("/")[0] for name in names}
    version = bagassets.__version__
    assert tops == {"bagassets", f"bagassets-{version}.dist-info", f"bagassets-{version}.data"}
    sources = {path.relative_to(ROOT).as_posix() for path in (ROOT / "bagassets").rglob("*.py")}
    assert {name for name in names if name.endswith(".py") and name.startswith("bagassets/")} == sources
    assert "bagassets/py.typed" in names
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_its_classifiers_name_the_pythons_that_the_makefile_tries(wheel):
    with ZipFile(wheel) as archive:
        [name] = [name for name in archive.namelist() if name.endswith("dist-info/METADATA")]
        metadata = HeaderParser().parsestr(archive.read(name).decode())
    versions = re.findall(r"Python :: (3\.\d+)", "\n".join(metadata.get_all("Classifier")))
    assert versions == ["3.11", "3.12", "3.13"]
    assert metadata["Requires-Python"] == ">=3.11"


def test_what_runs_is_the_installed_package(programs, away):
    said = run(programs / "python", "-c", "import bagassets; print(bagassets.__file__)", cwd=away)
    assert Path(said.strip()).is_relative_to(programs.parent)
    assert run(programs / "bagassets", "--version", cwd=away).split()[-1] == bagassets.__version__


def test_every_command_has_help(programs, away):
    said = run(programs / "bagassets", "--help", cwd=away)
    assert "build" in said
    code = (
        "from bagassets.cli.docs import all_commands, command_reference\n"
        "assert len(list(all_commands())) > 20\n"
        "print(command_reference())"
    )
    assert "## bagassets dataset diff" in run(programs / "python", "-c", code, cwd=away)


def test_pages_that_are_cited_can_be_read(programs, away):
    listed = run(programs / "bagassets", "docs", "page", cwd=away)
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")}
    assert {line.split()[0] for line in listed.splitlines()[:-1]} == pages
    folder = Path(listed.splitlines()[-1].removeprefix("They are in "))
    assert folder.is_relative_to(programs.parent)
    sources = [
        path.read_text("utf-8")
        for path in (programs.parent / "lib").glob("*/site-packages/bagassets/**/*.py")
    ]
    cited = {name for text in sources for name in CITED.findall(text)}
    assert {"formats", "decoders", "steps"} <= cited <= pages
    for name in sorted(cited):
        page = (ROOT / "docs" / f"{name}.md").read_text("utf-8")
        assert run(programs / "bagassets", "docs", "page", name, cwd=away) == page


def test_links_between_its_pages_lead_somewhere(programs):
    [folder] = (programs.parent / "share" / "doc").iterdir()
    pages = list(folder.rglob("*.md"))
    assert len(pages) > 15
    links = {
        (page, link)
        for page in pages
        for link in re.findall(r"\]\(([^)#\s]+)", page.read_text("utf-8"))
        if "://" not in link
    }
    broken = sorted(
        f"{page.relative_to(folder)}: {link}" for page, link in links if not (page.parent / link).exists()
    )
    # Results of benchmarks, and what is about work on the checkout, stay there.
    assert [line for line in broken if "../benchmarks/" not in line] == []


def test_references_come_from_the_package(programs, away):
    for name in ("recipe", "assets"):
        page = (ROOT / "docs" / f"{name}.md").read_text("utf-8")
        assert run(programs / "bagassets", "docs", name, cwd=away) == page


def test_plug_ins_are_listed(programs, away):
    assert "bagassets docs page decoders" in run(programs / "bagassets", "decoders", cwd=away)
    formats = json.loads(run(programs / "bagassets", "formats", "--json", cwd=away))
    assert "nuscenes" in {one["name"] for one in formats["formats"]}


def test_a_sample_drive_is_built(programs, project):
    scenes = json.loads(next((project / "dataset" / "nuscenes").glob("v1.0-*/scene.json")).read_text())
    assert len(scenes) == 1
    assert "fresh" in run(programs / "bagassets", "status", cwd=project)


def test_a_notebook_builds_and_reads_it(programs, project):
    code = (
        "import bagassets\n"
        "report = bagassets.build('recipe.yaml')\n"
        "dataset = bagassets.open_dataset(report.dataset)\n"
        "print(len(dataset.scenes), dataset[0].image('CAM_FRONT').shape)"
    )
    assert run(programs / "python", "-c", code, cwd=project).startswith("1 (")


def test_its_loops_are_compiled(programs, project):
    code = "from bagassets.geometry.kernels import moving; print(moving._MOVE.function() is not None)"
    assert run(programs / "python", "-c", code, cwd=project).strip() == "True"


def test_dagster_materializes_in_the_project_folder(programs, project):
    everything = ("--select", "*nuscenes_tables", "--partition", "drive.mcap")
    run(programs / "dagster", "asset", "materialize", "-m", "bagassets.definitions", *everything, cwd=project)
    assert "9 fresh" in run(programs / "bagassets", "status", cwd=project)


def test_dagster_dev_loads_the_project(programs, project):
    log, port = project.parent / "dev.log", free_port()
    with running([programs / "dagster", "dev", "--port", port], project, log) as process:
        query = json.dumps({"query": "{assetNodes {assetKey {path}}}"}).encode()
        request = Request(f"http://127.0.0.1:{port}/graphql", query, {"Content-Type": "application/json"})

        def assets():
            try:
                with urlopen(request, timeout=30) as answer:
                    return {node["assetKey"]["path"][-1] for node in json.load(answer)["data"]["assetNodes"]}
            except URLError:
                assert process.poll() is None, log.read_text()
                return None

        eventually(assets, "it answers")
        assert {"bag", "frames", "nuscenes_dataset"} <= assets()


def test_its_examples_install(programs, away):
    folder = programs.parent / "share" / "doc" / "bagassets"
    assert {path.name for path in folder.iterdir()} >= {"deploy", "docs", "examples", "requirements.lock"}
    pip = (programs / "python", "-m", "pip", "--quiet", "--disable-pip-version-check")
    run(*pip, "install", "--no-deps", folder / "examples" / "decoder_plugin", cwd=away)
    assert "acme_msgs/msg/RawFrame" in run(programs / "bagassets", "decoders", cwd=away)
    run(*pip, "uninstall", "--yes", "acme-decoders", cwd=away)


def test_the_demo_needs_no_checkout(programs, away):
    said = run(programs / "bagassets", "demo", "demo", "--seconds", "1.5", cwd=away)
    assert said.count(" built") >= 6


def test_the_web_ui_starts_and_answers(programs, project):
    log, port = project.parent / "ui.log", free_port()
    command = [programs / "bagassets", "ui", "--port", port, "--no-browser"]
    with running(command, project, log) as process:
        url = f"http://127.0.0.1:{port}"
        eventually(lambda: url in log.read_text() or process.poll() is not None, "it tells its address")
        assert process.poll() is None, log.read_text()
        with urlopen(f"{url}/server_info", timeout=30) as answer:
            assert "dagster_version" in json.load(answer)
        with urlopen(url, timeout=30) as answer:
            assert b"<html" in answer.read()


def test_type_checkers_see_its_types(programs, away):
    (away / "use.py").write_text("from bagassets.recipe import load_recipe\n\nreveal_type(load_recipe)\n")
    mypy = (
        sys.executable,
        "-m",
        "mypy",
        "--config-file",
        "/dev/null",
        "--python-executable",
        programs / "python",
    )
    said = run(*mypy, "--ignore-missing-imports", "--follow-imports", "silent", "use.py", cwd=away)
    assert "Recipe" in said.splitlines()[0]


def test_what_is_optional_can_be_uninstalled_as_the_docs_say(programs, away):
    """The last test of this file, since the environment lacks something from now on."""
    page = (ROOT / "docs" / "install.md").read_text("utf-8")
    listed = re.findall(r"^- `pip uninstall ([^`]+)` saves", page, re.MULTILINE)
    assert len(listed) == 2
    run(programs / "bagassets", "sample", "more/drive.mcap", "--duration", "2", cwd=away)
    for name in ("with", "without"):
        if name == "without":
            packages = " ".join(listed).split()
            run(programs / "python", "-m", "pip", "uninstall", "--quiet", "--yes", *packages, cwd=away)
        run(programs / "bagassets", "init", name, "--bags", "more", cwd=away)
        run(programs / "bagassets", "build", cwd=away / name)
    one, other = (
        {path.name: path.read_bytes() for path in (away / name / "dataset").rglob("*") if path.is_file()}
        for name in ("with", "without")
    )
    same = {name for name in one if not name.endswith(".json")}
    assert len(same) > 50
    assert {name: one[name] for name in same} == {name: other[name] for name in same}
    done = subprocess.run(
        [programs / "bagassets", "ui", "--no-browser"],
        cwd=away / "without", env=bare_environment(), capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 1
    [line] = done.stderr.splitlines()
    assert re.match(
        r"error: the web UI needs dagster-webserver, .*: `pip install dagster-webserver==1\.", line
    )
