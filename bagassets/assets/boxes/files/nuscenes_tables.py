"""Boxes of an existing nuScenes dataset: the tables of its version folder, in its global frame."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property

from bagassets.assets.boxes.files.json_text import entries, parse
from bagassets.assets.boxes.files.label import Label, UnreadableLabelsError, as_text, box_label, is_number
from bagassets.base.json_types import Json, JsonMapping, JsonObject
from bagassets.geometry.se3 import SE3

_BOXES = "sample_annotation.json"
TABLES = (
    _BOXES,
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
        others: logs that count if there is none with that logfile.
        place_log: returns `global_SE3_log` for a row of `log`, from the global frame of that log to that of the recording; None
            if they are the same for all.
    """

    def __init__(
        self,
        logfile: str | None,
        others: Sequence[str] = (),
        place_log: Callable[[JsonMapping], SE3] | None = None,
    ) -> None:
        self._logfile, self._others, self._place_log = logfile, others, place_log
        self._rows: dict[str, dict[str, JsonObject]] = {}
        self._places: dict[str, SE3 | None] = {}

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

    def global_SE3_log(self, sample: JsonMapping) -> SE3 | None:
        """Return where the boxes of a sample are, by the log that it belongs to; None if that is not wanted."""
        if self._logfile is None and self._place_log is None:
            return SE3()
        scene = self.row("scene", sample.get("scene_token"))
        log = None if scene is None else self.row("log", scene.get("log_token"))
        if log is None:
            return SE3() if self._logfile is None else None
        token = str(log["token"])
        if token not in self._places:
            is_wanted = self._logfile is None or log.get("logfile") in self._logfiles
            place_log = self._place_log or (lambda _: SE3())
            self._places[token] = place_log(log) if is_wanted else None
        return self._places[token]

    @cached_property
    def _logfiles(self) -> Sequence[Json]:
        names = [log.get("logfile") for log in self._rows.get("log", {}).values()]
        return (self._logfile,) if self._logfile in names else self._others


def read_table(tables: TableSet, name: str, data: bytes) -> Iterator[Label]:
    """Yield the boxes of `sample_annotation.json`; those of other logs are no boxes. Add another table to those it refers to.

    Raises:
        UnreadableLabelsError: it is not a JSON list.
    """
    if name != _BOXES:
        return tables.add(name, data)
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
    if (global_SE3_log := tables.global_SE3_log(sample)) is None:
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
    label = box_label(
        line,
        [float(value) for value in row["translation"]],
        [float(value) for value in row["rotation"]],
        (width, length, height),
        track_id=str(row["instance_token"]),
        category=str(category.get("name")),
        stamp_ns=int(sample["timestamp"]) * _NS_PER_US,
        attributes=tuple(str(found["name"]) for found in attributes if found is not None),
    )
    if label.box is None or global_SE3_log == SE3():
        return label
    return replace(label, box=replace(label.box, frame_SE3_box=global_SE3_log @ label.box.frame_SE3_box))
