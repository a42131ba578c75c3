"""Large images wait for room; small ones never do."""

from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest

from bagassets.assets.image_output import _SMALL_PIXELS, _Room

pytestmark = pytest.mark.once

LARGE = _SMALL_PIXELS + 1
SOON_S, NEVER_S = 30, 0.2


@pytest.fixture
def pool():
    with ThreadPoolExecutor(4) as made:
        yield made


class Work:
    """An image in work until it may end."""

    def __init__(self, pool, room, pixels, most_pixels):
        self.begun, self.end = Event(), Event()
        self.done = pool.submit(self._run, room, pixels, most_pixels)

    def _run(self, room, pixels, most_pixels):
        with room.room_for(pixels, most_pixels):
            self.begun.set()
            assert self.end.wait(SOON_S)

    def finish(self):
        self.end.set()
        self.done.result(SOON_S)


def test_those_that_fit_are_in_work_together_and_one_more_waits(pool):
    room, most = _Room(), 2 * LARGE
    first, second = Work(pool, room, LARGE, most), Work(pool, room, LARGE, most)
    assert first.begun.wait(SOON_S)
    assert second.begun.wait(SOON_S)
    third = Work(pool, room, LARGE, most)
    assert not third.begun.wait(NEVER_S)
    first.finish()
    assert third.begun.wait(SOON_S)
    second.finish()
    third.finish()


def test_one_too_large_for_all_the_room_is_in_work_alone(pool):
    room, most = _Room(), LARGE
    huge = Work(pool, room, 5 * LARGE, most)
    assert huge.begun.wait(SOON_S)
    other = Work(pool, room, LARGE, most)
    assert not other.begun.wait(NEVER_S)
    huge.finish()
    assert other.begun.wait(SOON_S)
    other.finish()


def test_small_ones_never_wait(pool):
    room = _Room()
    huge = Work(pool, room, 5 * LARGE, LARGE)
    assert huge.begun.wait(SOON_S)
    small = Work(pool, room, _SMALL_PIXELS, LARGE)
    assert small.begun.wait(SOON_S)
    small.finish()
    huge.finish()


def test_an_image_that_fails_leaves_its_room(pool):
    room = _Room()
    with pytest.raises(ValueError, match="damaged"), room.room_for(LARGE, LARGE):
        raise ValueError("damaged")
    after = Work(pool, room, LARGE, LARGE)
    assert after.begun.wait(SOON_S)
    after.finish()
