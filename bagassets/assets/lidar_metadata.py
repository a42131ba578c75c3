"""What lidars whose packets were recorded say of themselves, in a topic beside the packets or in a file that the recipe names."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from bagassets.assets.asset import Inputs
from bagassets.base.errors import DecodeError

L = TypeVar("L")


def described(parse: Callable[[bytes], L], topic: str | None, content: bytes | None, inputs: Inputs) -> L:
    """Return what the metadata of a lidar says.

    Args:
        parse: reads it; what it returns can be compared and hashed.
        topic: where it was published; None if it is in a file.
        content: of the file.
        inputs: have the messages.

    Raises:
        DecodeError: there is none, or it cannot be used.
    """
    if topic is None:
        return parse(content or b"")
    with inputs.messages((topic,)) as recording:
        data = [getattr(recording.decode(one), "data", "") for one in recording.messages((topic,))]
    texts = {one.tobytes() if isinstance(one, np.ndarray) else str(one).encode() for one in data}
    # It is published again when the driver connects again, with other words on how the lidar is.
    lidars = set(map(parse, texts))
    if len(lidars) != 1:
        raise DecodeError(f"it describes the lidar in {len(lidars)} ways" if lidars else "it is empty")
    return lidars.pop()
