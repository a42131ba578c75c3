#!/usr/bin/env bash
# A robot publishes its goals with Cyclone DDS: a number, the joint that it is for, which is @optional, and a speed. They are recorded as they are (CDR, with
# the IDL as schema, as MCAP keeps it for DDS), and read in a web page with @foxglove/omgidl-serialization, whose list of what it cannot do does not name it.
# Guess: the joint, or none; or an error. Seen with @foxglove/omgidl-serialization 1.0.3, @foxglove/omgidl-parser 1.1.0 and cyclonedds 11.0.1 on 2026-11-30,
# without a word:
# - XCDR2: the byte which says whether there is a joint is taken for the joint, and the joint for the speed: joint 3 at 1.5 m/s is joint 1 at 4e-45 m/s.
#   Without a joint it is joint 0
# - XCDR1: joint 556801 at 1e-45 m/s, with a joint or without: the header of the field is taken for its value
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check cyclonedds==11.0.1
npm install --silent --no-fund --no-audit @foxglove/omgidl-serialization@1.0.3 @foxglove/omgidl-parser@1.1.0 >/dev/null
cat > publish.py <<'PYTHON'
import json
from dataclasses import dataclass
from typing import Optional

from cyclonedds.idl import IdlStruct, annotations, types


@dataclass
@annotations.final
class Goal(IdlStruct, typename="robot.Goal"):
    number: types.int32
    joint: Optional[types.int32]
    speed: types.float32


goals = [Goal(7, joint, 1.5) for joint in (3, None)]
for xcdr2 in (False, True):
    assert [Goal.deserialize(goal.serialize(use_version_2=xcdr2)) for goal in goals] == goals
print(json.dumps([goal.serialize(use_version_2=xcdr2).hex() for xcdr2 in (False, True) for goal in goals]))
PYTHON
venv/bin/python publish.py > goals.json
cat > read.cjs <<'JS'
const assert = require("assert");
const { readFileSync } = require("fs");
const { parseIDL } = require("@foxglove/omgidl-parser");
const { MessageReader } = require("@foxglove/omgidl-serialization");
const idl = "module robot { @final struct Goal { long number; @optional long joint; float speed; }; };";
const reader = new MessageReader("robot::Goal", parseIDL(idl));
const goals = JSON.parse(readFileSync("goals.json")).map((bytes) => reader.readMessage(Buffer.from(bytes, "hex")));
console.log(goals);
assert.deepStrictEqual(goals.map(({ number, joint }) => [number, joint]), [[7, 556801], [7, 556801], [7, 1], [7, 0]]);
assert.deepStrictEqual(goals.map(({ speed }) => speed > 0 && speed < 1e-44), [true, true, true, false]);
assert.strictEqual(goals[3].speed, 1.5);
JS
node read.cjs
