"""Boxes of an existing nuScenes dataset: the tables of its version folder, in its global frame."""

from collections.abc import Iterator

from bagassets.annotations.files.json_text import entries, parse
from bagassets.annotations.files.label import Label, UnreadableLabelsError, as_text, box_label, is_number
from bagassets.json_types import Json, JsonMapping, JsonObject

__all__ = ["TABLES", "TableSet", "read_tables"]

TABLES = (
    "sample_annotation.json",
    "sample.json",
    "instance.json",
    "category.json",
    "attribute.json",
    "scene.json",
    "log.json",
)
_NS_PER_US = 1_000


class TableSet:
    """The small tables that rows of `sample_annotation` refer to.

    Args:
        logfile: only samples of the log with this logfile count; None for all.
    """

    def __init__(self, logfile: str | None) -> None:
        self._logfile = logfile
        self._rows: dict[str, dict[str, JsonObject]] = {}

    def add(self, name: str, data: bytes) -> None:
        """Add the content of a table file other than `sample_annotation.json`.

        Raises:
            UnreadableLabelsError: it is not a list of rows with tokens.
        """
        rows = parse(as_text(data))
        if not isinstance(rows, list) or not all(isinstance(row, dict) and "token" in row for row in rows):
            raise UnreadableLabelsError(1, "is no table: a list of rows with tokens")
        self._rows[name.removesuffix(".json")] = {str(row["token"]): row for row in rows}

    def row(self, table: str, token: Json) -> JsonObject | None:
        """Return a row by its token, or None."""
        return self._rows.get(table, {}).get(str(token))

    def is_wanted(self, sample: JsonMapping) -> bool:
        """Return whether a sample belongs to the wanted log."""
        if self._logfile is None:
            return True
        scene = self.row("scene", sample.get("scene_token"))
        log = None if scene is None else self.row("log", scene.get("log_token"))
        return log is not None and log.get("logfile") == self._logfile


def read_tables(tables: TableSet, data: bytes) -> Iterator[Label]:
    """Yield the boxes of `sample_annotation.json`; those of other logs are no boxes.

    Raises:
        UnreadableLabelsError: it is not a JSON list.
    """
    text = as_text(data)
    if not isinstance(parse(text), list):
        raise UnreadableLabelsError(1, "is no table: a list of rows")
    for line, row in entries(text, None):
        yield _label(line, row, tables)


def _label(line: int, row: Json, tables: TableSet) -> Label:
    if not isinstance(row, dict):
        return Label(line, problem="it is no row")
    sample = tables.row("sample", row.get("sample_token"))
    if sample is None or type(sample.get("timestamp")) is not int:
        return Label(line, problem="its sample_token is in no row of sample.json")
    if not tables.is_wanted(sample):
        return Label(line)
    instance = tables.row("instance", row.get("instance_token"))
    if instance is None:
        return Label(line, problem="its instance_token is in no row of instance.json")
    category = tables.row("category", instance.get("category_token"))
    if category is None:
        return Label(line, problem="the category of its instance is in no row of category.json")
    named = row.get("attribute_tokens")
    attributes = [tables.row("attribute", token) for token in (named if isinstance(named, list) else [None])]
    if None in attributes:
        return Label(line, problem="an attribute token is in no row of attribute.json")
    for name, number in (("translation", 3), ("rotation", 4), ("size", 3)):
        values = row.get(name)
        if not isinstance(values, list) or len(values) != number or not all(map(is_number, values)):
            return Label(line, problem=f"its {name} is no list of {number} numbers")
    width, length, height = (float(value) for value in row["size"])
    return box_label(
        line,
        [float(value) for value in row["translation"]],
        [float(value) for value in row["rotation"]],
        (width, length, height),
        track_id=str(row["instance_token"]),
        category=str(category.get("name")),
        stamp_ns=int(sample["timestamp"]) * _NS_PER_US,
        attributes=tuple(str(found["name"]) for found in attributes if found is not None),
    )
