"""What `make fuzz` runs works: every target takes its seeds, and some changed ones."""

import random

import pytest

from bagassets.base.errors import DecodeError
from bagassets.decode.registry import BUILT_IN
from bagassets_tests.fuzz.decoders import cases
from bagassets_tests.fuzz.targets import LIMITS, TARGETS, decoded


@pytest.mark.parametrize("name", TARGETS)
def test_a_target_takes_valid_inputs_and_damaged_ones(tmp_path, name):
    target, dice = TARGETS[name], random.Random(name)
    seeds = target.seeds(tmp_path)
    assert seeds
    for data in seeds:
        target.run(data)
    for _ in range(20):
        data = bytearray(dice.choice(seeds))
        for _ in range(dice.randrange(1, 6)):
            data[dice.randrange(len(data))] = dice.randrange(256)
        target.run(bytes(data[: dice.randrange(len(data)) + 1] if dice.random() < 0.3 else data))


def test_an_error_that_is_no_sentence_of_ours_is_found(tmp_path, monkeypatch):
    def broken(*_args):
        raise KeyError("surprise")

    (seed, *_) = TARGETS["recipe"].seeds(tmp_path)
    monkeypatch.setattr("bagassets_tests.fuzz.targets.load_recipe", broken)
    with pytest.raises(KeyError):
        TARGETS["recipe"].run(seed)


def test_every_decoder_is_fuzzed_and_reads_a_seed_in_each_serialization():
    read = set()
    for case in cases():
        topic = case.topic(LIMITS)
        assert topic.problem is None
        for data in case.seeds:
            try:
                decoded(case.line, topic, data)
            except DecodeError:  # some are odd on purpose
                continue
            read.add((case.line, case.source.msgtype, case.source.serialization))
    assert read == {(case.line, case.source.msgtype, case.source.serialization) for case in cases()}
    assert {line for line, *_ in read} == set(BUILT_IN)
    foxglove = [line for line in BUILT_IN if line.msgtype.startswith("foxglove_msgs/")]
    assert {(line, line.msgtype, how) for line in foxglove for how in ("cdr", "protobuf", "json")} <= read
