"""The operations page says what is so: commands, options, files and exit statuses that exist."""

import re
from pathlib import Path

import click

from bagassets.cli.docs import all_commands
from bagassets.defs.builds.garbage import KEPT_LOCKS

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "operations.md").read_text(encoding="utf-8")


def test_every_command_and_option_exists():
    commands = {name.removeprefix("bagassets "): command for name, command in all_commands()}
    named = re.findall(r"(?:`|\$ )bagassets ((?:dataset )?[a-z]+)((?: --?[a-z-]+(?: [A-Z0-9]+)?)*)", PAGE)
    assert len(named) > 15
    for name, options in named:
        assert name in commands, name
        known = {
            flag
            for option in commands[name].params
            if isinstance(option, click.Option)
            for flag in option.opts
        }
        assert set(re.findall(r"--[a-z-]+", options)) <= known, (name, options)


def test_options_named_alone_belong_to_some_command():
    known = {
        flag
        for _, command in all_commands()
        for option in command.params
        if isinstance(option, click.Option)
        for flag in option.opts
    }
    assert set(re.findall(r"`(--[a-z-]+)", PAGE)) <= known


def test_links_and_places():
    for target in re.findall(r"\]\(([^)#]+)\)", PAGE):
        assert (DOCS / target).exists(), target
    assert f"`{KEPT_LOCKS}/`" in PAGE


def test_the_unit_runs_a_command_that_exists():
    unit = (DOCS / "bagassets-watch.service").read_text(encoding="utf-8")
    assert re.search(r"^ExecStart=\S+/bagassets watch /\S+$", unit, re.MULTILINE)
    assert "Restart=on-failure" in unit


def test_the_table_of_flipped_bits_is_the_one_that_was_measured():
    measured = (DOCS.parent / "benchmarks" / "results" / "flips.md").read_text("utf-8")
    assert PAGE.partition("<!-- flips -->\n")[2].partition("<!-- end of flips -->")[0] == measured
