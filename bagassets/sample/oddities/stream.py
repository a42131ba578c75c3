"""What an oddity is: a function from the messages of a drive to those that are recorded."""

from collections.abc import Callable, Collection, Iterator
from functools import partial

from bagassets.decode.fields import stamp_ns
from bagassets.recordings.model import Message
from bagassets.sample.messages import Messages
from bagassets.sample.schedule import Event, Make, event
from bagassets.sample.truth import Truth

__all__ = ["Clock", "Edit", "Oddity", "edited", "on_clock", "with_fields"]

# Gets events in the order of their log times, and yields them in that order.
Oddity = Callable[[Iterator[Event], Truth], Iterator[Event]]
# (factory, message, its number on the topic) -> the message to record.
Edit = Callable[[Messages, Message, int], Message]
# What another clock says at a time.
Clock = Callable[[int], int]


def edited(events: Iterator[Event], topics: Collection[str], edit: Edit) -> Iterator[Event]:
    """Yield all events, with those of some topics edited; times, topics and types stay."""
    numbers = dict.fromkeys(topics, 0)
    for one in events:
        if one.topic not in numbers or one.make is None:
            yield one
            continue
        number, make = numbers[one.topic], one.make
        numbers[one.topic] += 1
        yield event(one.log_time_ns, one.topic, one.msgtype, partial(_edit, edit, make, number))


def _edit(edit: Edit, make: Make, number: int, messages: Messages) -> Message:
    return edit(messages, make(messages), number)


def on_clock(events: Iterator[Event], clock: Clock) -> Iterator[Event]:
    """Yield events as on another clock: their log times, and the stamps in their messages."""
    for one in events:
        if one.make is not None:
            yield event(clock(one.log_time_ns), one.topic, one.msgtype, partial(_stamped, clock, one.make))


def _stamped(clock: Clock, make: Make, messages: Messages) -> Message:
    message = make(messages)
    parts = getattr(message, "transforms", [message, *getattr(message, "detections", ())])
    for header in {id(part.header): part.header for part in parts}.values():  # some share one
        header.stamp = messages.time(clock(stamp_ns(header.stamp)))
    return message


def with_fields(message: Message, **fields: object) -> Message:
    """Set fields of a message and return it."""
    for name, value in fields.items():
        setattr(message, name, value)
    return message
