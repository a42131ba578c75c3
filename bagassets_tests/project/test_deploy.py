"""The examples of deployments are accepted by the classes that they name."""

import re
from pathlib import Path

import click
import pytest
import yaml
from dagster._core.instance import InstanceRef
from dagster._core.launcher import RunLauncher
from dagster._core.run_coordinator import RunCoordinator

from bagassets.cli.docs import all_commands

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
KUBECONFIG = """
apiVersion: v1
kind: Config
clusters: [{name: c, cluster: {server: "https://127.0.0.1:1"}}]
users: [{name: u, user: {token: t}}]
contexts: [{name: x, context: {cluster: c, user: u}}]
current-context: x
"""


@pytest.mark.parametrize(
    ("name", "launcher"),
    [("slurm", "SlurmRunLauncher"), ("kubernetes", "K8sRunLauncher"), ("docker", "DockerRunLauncher")],
)
def test_each_example_is_loaded_by_the_real_classes(name, launcher, tmp_path, monkeypatch):
    text = (DEPLOY / name / "dagster.yaml").read_text("utf-8")
    if name == "kubernetes":  # outside of a cluster
        (tmp_path / "kubeconfig").write_text(KUBECONFIG)
        assert "load_incluster_config: true" in text
        text = text.replace(
            "load_incluster_config: true",
            f"load_incluster_config: false\n    kubeconfig_file: {tmp_path / 'kubeconfig'}",
        )
    (tmp_path / "dagster.yaml").write_text(text, "utf-8")
    monkeypatch.setenv("BAGASSETS_DATABASE", "postgresql+psycopg2://user:password@host:5432/dagster")
    ref = InstanceRef.from_dir(str(tmp_path))
    assert type(ref.run_launcher_data.rehydrate(as_type=RunLauncher)).__name__ == launcher
    assert ref.run_coordinator_data.rehydrate(as_type=RunCoordinator) is not None
    assert ref.event_storage_data.config_dict["postgres_url"] == {"env": "BAGASSETS_DATABASE"}
    assert ref.event_storage_data.class_name == "PostgresEventLogStorage"
    assert ref.settings["run_monitoring"]["enabled"]


def test_the_recipe_of_an_example_reaches_its_runs():
    """Where the launcher is ours it is told; others hand it on in the environment."""
    for name in ("slurm", "kubernetes", "docker"):
        config = yaml.safe_load((DEPLOY / name / "dagster.yaml").read_text())["run_launcher"]["config"]
        assert "recipe.yaml" in str([config.get("recipe"), config.get("env_vars")])


def test_the_service_starts_a_command_that_exists():
    (line,) = re.findall(
        r"^ExecStart=.*/bagassets (.*)$",
        (DEPLOY / "systemd" / "bagassets-ui.service").read_text(),
        re.MULTILINE,
    )
    name, *options = line.split()
    command = dict(all_commands())[f"bagassets {name}"]
    known = {flag for option in command.params if isinstance(option, click.Option) for flag in option.opts}
    assert {option for option in options if option.startswith("-")} <= known


def test_the_image_is_made_of_what_is_there():
    copied = re.findall(r"^COPY (.*) /src\S*$", (DEPLOY / "docker" / "Dockerfile").read_text(), re.MULTILINE)
    for name in " ".join(copied).split():
        assert (ROOT / name).exists(), name
    assert len(copied) > 3
