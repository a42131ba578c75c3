#!/usr/bin/env bash
# A robot's program writes its state into an MCAP as JSON, with the JSON Schema that pydantic makes of its classes: a position (a class of its own), a speed that may be missing,
# a path, the number of a goal. roboto-mcap-codec makes Arrow tables of it. Guess: all fields, as each message has them; what does not fit a column is an error.
# Seen with roboto-mcap-codec 0.3.0 and pydantic 2.14.4 on 2026-11-30, without a word:
# - two columns of six: what refers to a class (`$ref`), what may be missing (`anyOf` with null), lists of classes and dictionaries are no columns, though the README names "every field"
# - an integer written as 3.0, as programs do that know one kind of number, is null; so are 3.7, text in a column of numbers, and the 2.0 in [1, 2.0, 3]
# - whole numbers from 2^63 on, such as hashes of 64 bits, are NEGATIVE: 2^63 + 5 is -2^63 + 5. A number below -2^63 is null
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check roboto-mcap-codec==0.3.0 pyarrow==26.0.1 mcap==1.6.0 pydantic==2.14.4
cd "$folder"
venv/bin/python - <<'PYTHON'
import json
from pathlib import Path

import mcap_codec
from mcap.writer import Writer
from pydantic import BaseModel


class Point(BaseModel):
    x: float
    y: float


class State(BaseModel):
    mode: str
    goal: int
    position: Point
    speed: float | None
    path: list[Point]
    joints: dict[str, float]


def rows(schema, messages):
    """Return the rows of a recording of these messages, without row number and time."""
    with open("drive.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/state", "json", writer.register_schema("State", "jsonschema", json.dumps(schema).encode()))
        for number, message in enumerate(messages):
            writer.add_message(channel, number, message.encode(), number)
        writer.finish()
    data = Path("drive.mcap").read_bytes()
    log_time = mcap_codec.TimestampSource("message_log_time")
    with mcap_codec.open_mcap_file(lambda offset, length: data[offset : offset + length], len(data), timestamp=log_time) as cursor:
        found = [row for batch in cursor for row in batch.to_pylist()]
    return [{name: value for name, value in row.items() if not name.startswith("_")} for row in found]


state = State(mode="auto", goal=7, position=Point(x=1, y=2), speed=1.5, path=[Point(x=3, y=4)], joints={"elbow": 0.5})
(row,) = rows(State.model_json_schema(), [state.model_dump_json()])
print(row, "of", state.model_dump_json())
assert row == {"mode": "auto", "goal": 7}

schema = {"type": "object", "properties": {"goal": {"type": "integer"}}}
goals = [row["goal"] for row in rows(schema, [f'{{"goal": {text}}}' for text in ("3", "3.0", "3.7", '"3"', 2**63 + 5, -(2**63) - 5)])]
print("goals", goals)
assert goals == [3, None, None, None, -(2**63) + 5, None]

schema = {"type": "object", "properties": {"goals": {"type": "array", "items": {"type": "integer"}}}}
(row,) = rows(schema, ['{"goals": [1, 2.0, 3]}'])
assert row == {"goals": [1, None, 3]}
PYTHON
