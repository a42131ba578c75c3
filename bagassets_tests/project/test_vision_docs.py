"""What the pages about datasets and pictures show can be done as shown."""

import re
from pathlib import Path

import pytest

from bagassets.cli.main import COMMANDS
from bagassets.recipe import load_recipe
from bagassets.sample.recipe import sample_recipe

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("vision.md", "datasets.md", "pictures.md")
SNIPPETS = [
    (page, text)
    for page in PAGES
    for text in re.findall(r"```yaml\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)
]


@pytest.mark.parametrize(("page", "text"), SNIPPETS)
def test_recipes_are_accepted(page, text, tmp_path):
    base = sample_recipe(output="dataset/nuscenes")
    section = text.split(":")[0]
    assert section not in base.split("\n")
    (tmp_path / "recipe.yaml").write_text(base + text)
    recipe = load_recipe(tmp_path / "recipe.yaml")
    assert getattr(recipe, section)


@pytest.mark.parametrize("page", PAGES)
def test_links_and_commands_lead_somewhere(page):
    text = (DOCS / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert (DOCS / target).exists(), target
    for command in re.findall(r"bagassets ([a-z]+)", text):
        assert command in COMMANDS, command
