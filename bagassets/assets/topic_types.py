"""Which types of messages a channel can be made of, told before a message of its topic is read."""

from bagassets.decode.registry import AnyFamily, Decoder, advice, expected_types, find_decoder
from bagassets.errors import DecodeError
from bagassets.plugins import Family

__all__ = ["require_decoder"]


def require_decoder(name: str, topic: str, msgtype: str, family: Family, *others: AnyFamily) -> Decoder:
    """Return the decoder of a channel's messages.

    Args:
        name: canonical channel.
        topic: where its messages are.
        msgtype: their type, `pkg/msg/Type`.
        family: what the channel is made of.
        others: what else it can be made of.

    Raises:
        DecodeError: messages of this type cannot be that.
        PluginError: several decoder plug-ins claim the type.
    """
    for one in (family, *others):
        decoder = find_decoder(one, msgtype)
        if decoder is not None:
            return decoder
    raise DecodeError(
        f"{name} ({topic}): carries {msgtype}, expected {expected_types(family)}; {advice(family, msgtype)}"
    )
