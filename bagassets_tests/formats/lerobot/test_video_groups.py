"""Groups of episodes that share a file: bounded, and one more episode leaves the others alone."""

import random

from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.formats.lerobot.groups import Limits, Unit, grouped

LIMITS = Limits(usual_frames=1200, usual_size=10**6, most_frames=6000, most_size=5 * 10**6)
units = st.lists(
    st.builds(
        Unit,
        st.integers(0, 10**9).map(str),
        st.integers(2, 5999),
        st.integers(1, 2 * 10**6),
        st.sampled_from(["", "", "", "other"]),
    ),
    max_size=60,
    unique_by=lambda unit: unit.name,
)


@given(units)
@settings(max_examples=300)
def test_groups_cover_all_in_order_within_limits(some):
    groups = grouped(some, LIMITS)
    assert [number for group in groups for number in group] == list(range(len(some)))
    for group in groups:
        assert len({some[number].header for number in group}) == 1
        assert len(group) == 1 or sum(some[number].frames for number in group) <= LIMITS.most_frames
        assert len(group) == 1 or sum(some[number].size for number in group) <= LIMITS.most_size


def names_of(some):
    return {tuple(some[number].name for number in group) for group in grouped(some, LIMITS)}


def test_one_more_episode_touches_the_file_it_enters_wherever_that_is():
    """It may split that file in two; where a file had been cut because it grew too long, its neighbour may change, too."""
    some = [Unit(f"drive_{n:04d}/0", 300, 200_000) for n in range(1000)]
    before = names_of(some)
    chance = random.Random(1)
    touched, neighbours = [], 0
    for trial in range(200):
        at = chance.randrange(len(some) + 1)
        after = names_of([*some[:at], Unit(f"new_{trial}/0", 300, 200_000), *some[at:]])
        gone, new = before - after, after - before
        assert len(gone) <= 2
        neighbours += len(gone) == 2
        touched.append(len(new))
    assert neighbours <= 2
    assert max(touched) <= 3
    assert sum(number == 1 for number in touched) > 120
    assert 2.5 <= len(some) / len(before) <= 6
