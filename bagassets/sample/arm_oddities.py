"""What real recordings of arms do and the sample arm does not."""

from collections.abc import Callable, Iterator
from functools import partial

from bagassets.recordings.model import Message
from bagassets.sample.arm import CAMERAS, COMMANDS, ELEMENTS, STATE_PERIOD_NS, STATES, TASK, ArmTruth, said
from bagassets.sample.messages import Messages
from bagassets.sample.oddities import edited, with_fields
from bagassets.sample.schedule import Event

ArmOddity = Callable[[Iterator[Event], ArmTruth], Iterator[Event]]

CHANGE_AFTER_S = 2.0
"""When a camera stops, or joints change."""
LATE_S = 1.0
"""When commands begin, and how long after a task another one is said."""
OTHER_TASK = "Wait for the next task."


def _camera_stops(events: Iterator[Event], truth: ArmTruth) -> Iterator[Event]:
    """The wrist camera stops after 2 s."""
    return (
        one
        for one in events
        if one.topic != CAMERAS["wrist"] or truth.seconds(one.log_time_ns) < CHANGE_AFTER_S
    )


def _action_late(events: Iterator[Event], truth: ArmTruth) -> Iterator[Event]:
    """Commands begin after 1 s."""
    return (one for one in events if one.topic != COMMANDS or truth.seconds(one.log_time_ns) >= LATE_S)


def _joints_lost(events: Iterator[Event], _truth: ArmTruth) -> Iterator[Event]:
    """After 2 s, the states lack the last joint, which is before the gripper."""
    first, lost = round(CHANGE_AFTER_S * 1e9) // STATE_PERIOD_NS, len(ELEMENTS) - 2

    def edit(_: Messages, message: Message, number: int) -> Message:
        if number < first:
            return message
        left = [index for index in range(len(ELEMENTS)) if index != lost]
        return with_fields(
            message, name=[message.name[index] for index in left], position=message.position[left]
        )

    return edited(events, {STATES}, edit)


def _joints_reordered(events: Iterator[Event], _truth: ArmTruth) -> Iterator[Event]:
    """Every second message has the joints in reverse order."""

    def edit(_: Messages, message: Message, number: int) -> Message:
        if number % 2:
            with_fields(message, name=message.name[::-1], position=message.position[::-1].copy())
        return message

    return edited(events, {STATES}, edit)


def _task_changes(events: Iterator[Event], _truth: ArmTruth) -> Iterator[Event]:
    """A second after each task another one is said, in the middle of its episode."""
    waiting: list[Event] = []
    for one in events:
        while waiting and waiting[0].log_time_ns <= one.log_time_ns:
            yield waiting.pop(0)
        yield one
        if one.topic == TASK:
            log_time_ns = one.log_time_ns + round(LATE_S * 1e9)
            waiting.append(Event(log_time_ns, TASK, one.msgtype, partial(said, OTHER_TASK)))


ARM_ODDITIES: dict[str, ArmOddity] = {
    "camera-stops": _camera_stops,
    "joint-lost": _joints_lost,
    "joints-reordered": _joints_reordered,
    "action-late": _action_late,
    "task-changes": _task_changes,
}
