"""The recipe reference is complete and is what stands in docs/."""

from pathlib import Path

from bagassets.recipe import parse_recipe
from bagassets.recipe.model import Recipe
from bagassets.recipe.reference import EXAMPLE, render_reference
from bagassets.recipe.schema import models_in

DOCS = Path(__file__).parents[2] / "docs"


def models():
    found, queue = {Recipe}, [Recipe]
    for model in queue:
        for field in model.model_fields.values():
            for inner in models_in(field.annotation):
                if inner not in found:
                    found.add(inner)
                    queue.append(inner)
    return found


def test_docs_are_up_to_date():
    assert (DOCS / "recipe.md").read_text(encoding="utf-8") == render_reference(), (
        "docs/recipe.md is out of date: make docs"
    )


def test_a_field_of_several_kinds_names_them():
    text = render_reference()
    assert "| `field` | text or a list, each entry text | required |" in text
    assert "| a value |" not in text


def test_every_field_is_described():
    text = render_reference()
    for model in models():
        assert (model.__doc__ or "").strip(), model
        for name, field in model.model_fields.items():
            described = field.description or model.model_fields[name].default
            assert described, f"{model.__name__}.{name} has no description"
            assert f"| `{name}` |" in text
            assert field.description is None or field.description.endswith("."), f"{model.__name__}.{name}"


def test_every_table_row_has_four_cells():
    rows = [line for line in render_reference().splitlines() if line.startswith("| `")]
    assert len(rows) > 80
    for row in rows:
        assert row.replace("\\|", "").count("|") == 5, row


def test_example_loads(tmp_path):
    assert parse_recipe(EXAMPLE, tmp_path / "recipe.yaml").rigs[0].name == "van"
