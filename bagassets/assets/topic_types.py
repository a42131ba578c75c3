"""Finding the decoder of a channel by the type of its messages, before any of them is read."""

from bagassets.decode.registry import AnyFamily, Decoder, advice, expected_types, find_decoder
from bagassets.errors import DecodeError
from bagassets.plugins import Family

__all__ = ["require_decoder"]


def require_decoder(name: str, topic: str, msgtype: str, family: Family, *others: AnyFamily) -> Decoder:
    """Return the decoder of a channel's messages.

    Args:
        name: canonical channel.
        topic: topic of its messages.
        msgtype: type of its messages, `pkg/msg/Type`.
        family: family of decoders for the channel.
        others: further families that may decode it.

    Raises:
        DecodeError: none of the families has a decoder for messages of this type.
        PluginError: several decoder plug-ins claim the type.
    """
    for one in (family, *others):
        decoder = find_decoder(one, msgtype)
        if decoder is not None:
            return decoder
    raise DecodeError(
        f"{name} ({topic}): carries {msgtype}, expected {expected_types(family)}; {advice(family, msgtype)}"
    )
