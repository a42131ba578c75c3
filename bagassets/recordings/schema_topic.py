"""A topic whose messages are not ROS: protobuf or JSON, decoded by the schema recorded with them."""

from functools import cached_property

from bagassets.base.errors import DecodeError
from bagassets.recordings.heads import first_head_of
from bagassets.recordings.layouts import Choice
from bagassets.recordings.model import Message
from bagassets.recordings.schemas import Schema, schema_of
from bagassets.recordings.topic import RefusedBytes, Topic


class SchemaTopic(Topic):
    """A topic with a schema. It has none of ROS's layouts, so nothing is read of a message without decoding it."""

    @cached_property
    def _layouts(self) -> Choice | str:
        return "its messages are not those of ROS"

    @cached_property
    def _schema(self) -> Schema | str:
        if len(self._own.text) > self._limits.definition_bytes:
            return f"the schema of {self.msgtype} is larger than limits.definition_bytes in the recipe allows"
        return schema_of(self.msgtype, self.serialization, self._own, self._limits.message_elements)

    def _definition_problem(self) -> str | None:
        return self._schema if isinstance(self._schema, str) else None

    def decode(self, data: bytes | memoryview) -> Message:
        """Return a message as an object with the fields of its schema; see `Topic.decode`."""
        if isinstance(data, RefusedBytes):
            raise DecodeError(data.reason)
        if self._refused or isinstance(self._schema, str):
            raise DecodeError(self._refused or str(self._schema))
        return self._schema.decode(bytes(data))

    def header(self, data: bytes | memoryview) -> tuple[int, str] | None:
        """Return stamp and frame id of a message that has them; see `first_head_of`."""
        try:
            return first_head_of(self.decode(data))
        except DecodeError:
            return None

    @property
    def layout_digest(self) -> str:
        """Digest of the schema; empty without one."""
        return "" if isinstance(self._schema, str) else self._schema.digest
