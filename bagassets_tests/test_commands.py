"""Every command as users meet it: in the overview, and in its own help."""

import click
import pytest

from bagassets.cli.docs import all_commands
from bagassets.cli.main import COMMANDS, EXIT_ERROR, main, root

LEAVES = {name: command for name, command in all_commands() if not isinstance(command, click.Group)}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_overview_says_what_the_command_says(name):
    command = root.get_command(click.Context(root), name)
    assert command is not None
    assert " ".join(command.help.partition("\n\n")[0].split()) == COMMANDS[name][1]


@pytest.mark.parametrize("name", LEAVES)
def test_every_command_has_examples_that_call_it(name):
    assert "Examples:" in LEAVES[name].epilog
    assert f"\n  {name}" in LEAVES[name].epilog


@pytest.mark.parametrize("name", LEAVES)
def test_every_option_is_explained(name):
    for parameter in LEAVES[name].params:
        if isinstance(parameter, click.Option):
            assert parameter.help, parameter.name
            assert parameter.help.rstrip().endswith("."), parameter.name


def test_a_mistyped_command_is_answered_with_the_one_that_was_meant(capsys):
    assert main(["biuld"]) == 2
    assert "Did you mean build?" in capsys.readouterr().err


@pytest.mark.parametrize("place", ["file/drive.mcap", "file/deeper/drive.bag", "file/drive"])
def test_a_place_that_cannot_be_is_told_and_is_no_defect(tmp_path, capsys, place):
    (tmp_path / "file").write_text("not a folder")
    assert main(["sample", str(tmp_path / place)]) == EXIT_ERROR
    told = capsys.readouterr().err
    assert f"{tmp_path / 'file'}" in told
    assert "mend this one" in told
