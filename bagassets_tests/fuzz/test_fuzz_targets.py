"""What `make fuzz` runs works: every target takes its seeds, and some changed ones."""

import random

import pytest

from bagassets_tests.fuzz.targets import TARGETS


@pytest.mark.parametrize("name", TARGETS)
def test_a_target_takes_valid_inputs_and_damaged_ones(tmp_path, name):
    target, dice = TARGETS[name], random.Random(name)
    seeds = target.seeds(tmp_path)
    assert seeds
    for data in seeds[:40]:
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
