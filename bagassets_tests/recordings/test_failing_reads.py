"""A read of a database that fails once: SQLite then says what it says of damage."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bagassets.base.errors import BagAssetsError
from bagassets.recordings.open import open_recording
from bagassets_tests import failing_reads
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once


def read_with_each_read_failing(bag):
    """Print what reading a recording ends in, for each read that fails: how many messages, or the error."""
    found, number, bag = [], 0, Path(bag)
    while True:
        number += 1
        failing_reads.begin(bag.parent, number)
        try:
            with open_recording(bag) as recording:
                found.append(sum(1 for _ in recording.messages(list(recording.topics))))
        except BagAssetsError as err:
            found.append(str(err))
        if not failing_reads.failed():
            print(json.dumps(found))
            return


@pytest.mark.skipif(shutil.which("cc") is None, reason="the library that has reads fail is compiled")
@pytest.mark.parametrize("is_bare", [True, False])
def test_a_read_that_fails_is_no_damage(tmp_path, is_bare):
    bag = write_drive(tmp_path / "bags" / "a", "ros2", duration_s=0.3)
    if is_bare:
        (database,) = bag.glob("*.db3")
        bag = database.rename(tmp_path / "bags" / "a.db3")
    with open_recording(bag) as recording:
        all_of_them = sum(1 for _ in recording.messages(list(recording.topics)))
    environment = failing_reads.with_library(failing_reads.compiled(tmp_path))
    command = [sys.executable, "-c", f"import {__name__} as it; it.read_with_each_read_failing({str(bag)!r})"]
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    *found, last = json.loads(done.stdout)
    assert last == all_of_them > 20
    refused = [one for one in found if one != all_of_them]
    assert len(refused) > 10
    assert [one for one in refused if "check its disk or file server" not in str(one)] == []
