"""Whether the messages of a topic match their definition."""

from bagassets.errors import DecodeError
from bagassets.recordings.model import RawMessage
from bagassets.recordings.topic import Topic

__all__ = ["TopicProbe"]

# A single damaged message does not make its topic unreadable.
MOST_MISFITS = 5


class TopicProbe:
    """Decodes the first messages of a topic, until one fits its definition.

    If a type has several possible layouts, all messages are decoded: empty lists, for example, fit
    any layout.

    Args:
        topic: the topic, whose type is known.
    """

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._misfits = 0
        self._reason = ""
        self._fits = False
        self._done = False

    def add(self, message: RawMessage) -> None:
        """Take the next message."""
        if self._done:
            return
        try:
            self._topic.decode(message.data)
        except DecodeError as err:
            self._misfits += 1
            self._reason = str(err)
        else:
            self._fits = True
        enough = self._fits or self._misfits == MOST_MISFITS
        self._done = enough and not self._topic.is_ambiguous

    @property
    def problem(self) -> str | None:
        """Why its messages cannot be decoded; None if one was decoded, or if there were none."""
        if self._fits or not self._misfits:
            return None
        if "limits." in self._reason:
            return f"none of its messages can be decoded: {self._reason}"
        msgtype = self._topic.msgtype
        if self._topic.has_definition:
            return f"its messages do not fit the definition of {msgtype} that is in the recording"
        return (
            f"its messages fit no definition of {msgtype} that is known; name a folder of .msg files in "
            "bags.message_definitions"
        )
