#!/usr/bin/env bash
# A measurement (MCAP with JSON) has 20,000 messages, one each millisecond, recorded 2 ms after they were published. databeam-mcap-reader reads it as a whole, and
# in chunks (`get_data_chunked`), for files larger than memory; and a second one, whose program writes the number of a gear as 3.0 where the schema has integers.
# Guess: the same messages both ways; and 3. Seen with databeam-mcap-reader 0.5.2 on 2026-11-30, without a word:
# - 20,000 rows both ways, but in chunks 4 messages are there twice and the last 4 are nowhere. A chunk begins after the last `ts` of the one before, which is a
#   PUBLISH time, and is looked for by log time. Where two messages have one time and a chunk ends between them, the second is lost
# - a gear of 3.0 is 4613937818241073152, the bits of its double; 2^63 is -2^63, a message without a gear has gear 0, and where text has come into a column of
#   numbers, "7" is 55, the code of its letter
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check databeam-mcap-reader==0.5.2 mcap==1.6.0 numpy==2.4.6 orjson==3.13.0
cd "$folder"
venv/bin/python - <<'PYTHON'
import json
import logging
from collections import Counter

import numpy as np
from databeam_mcap_reader import McapReader
from mcap.writer import Writer

logging.getLogger("databeam_mcap").setLevel(logging.WARNING)
START_NS, MS = 1_700_000_000 * 10**9, 10**6


def read(messages, chunk_megabytes=None):
    """Return the rows of a recording of messages (published, recorded, values), read as a whole or in chunks."""
    properties = {"number": {"type": "integer"}, "gear": {"type": "integer"}, "speed": {"type": "number"}, "note": {"type": "string"}}
    with open("drive.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("State", "jsonschema", json.dumps({"type": "object", "properties": properties}).encode())
        channel = writer.register_channel("/state", "json", schema)
        for published_ns, recorded_ns, values in messages:
            writer.add_message(channel, recorded_ns, json.dumps(values).encode(), published_ns)
        writer.finish()
    reader = McapReader()
    reader.open("drive.mcap")
    if chunk_megabytes is None:
        return reader.get_data("/state")
    return np.concatenate(list(reader.get_data_chunked("/state", chunk_megabytes)))


def drive(each_ms, late_ms):
    """Return 20,000 messages, `each_ms` at a time, recorded `late_ms` after they were published."""
    times = [START_NS + (number + 1) // each_ms * MS for number in range(20_000)]
    return [(time, time + late_ms * MS, {"number": number, "gear": 1, "speed": 5.0, "note": ""}) for number, time in enumerate(times)]


for each_ms, late_ms, rows, twice, lost in ((1, 0, 20_000, 0, []), (1, 2, 20_000, 4, [*range(19_996, 20_000)]), (2, 0, 19_999, 0, [9362])):
    whole, chunked = (read(drive(each_ms, late_ms), size)["number"] for size in (None, 1))
    counts = Counter(chunked.tolist())
    print(f"{each_ms} at a time, {late_ms} ms late: {len(whole)} rows, and in chunks {len(chunked)}, of {len(counts)} messages")
    assert whole.tolist() == list(range(20_000))
    assert (len(chunked), sum(count == 2 for count in counts.values())) == (rows, twice)
    assert sorted(set(range(20_000)) - set(counts)) == lost

values = [{"gear": 3.0, "speed": 7}, {"gear": 2**63, "speed": "7"}, {"speed": None}]
states = read([(START_NS + number, START_NS + number, message) for number, message in enumerate(values)])
print("gears", states["gear"], "speeds", states["speed"])
assert states["gear"].tolist() == [np.float64(3.0).view(np.int64), -(2**63), 0]
assert states["speed"][:2].tolist() == [7, 55] and np.isnan(states["speed"][2])
PYTHON
