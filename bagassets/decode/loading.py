"""Importing decoders, and guarding those of plug-ins: their results and exceptions are checked for each message.

A mistake in a plug-in costs messages, which are counted, and is reported in one sentence.
"""

import importlib.metadata
import traceback
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from bagassets.base.errors import DecodeError, PluginError, kind_and_text
from bagassets.base.plugins import DecoderPlugin
from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.model import BoxReading, CloudReading, ImageReading, PoseReading, RadarReading
from bagassets.decode.registry import (
    BUILT_IN,
    AnyFamily,
    Decoder,
    built_in_decoder,
    expected_types,
    find_decoder,
)
from bagassets.recordings.model import Message

_A = ParamSpec("_A")
_R = TypeVar("_R")
_READINGS: Mapping[AnyFamily, type] = {
    "image": ImageReading,
    "cloud": CloudReading,
    "radar": RadarReading,
    "pose": PoseReading,
}


def keyed_decoder(family: AnyFamily, msgtype: str, given: Mapping[str, str] | None) -> Any:
    """Import and return the decoder in an action's key; None if there is no decoder for the type.

    Args:
        family: family of the decoder.
        msgtype: type of the messages.
        given: the parameter `decoder` of the action; None without a plug-in.

    Raises:
        PluginError: the decoder cannot be loaded, or is not the one in the key.
    """
    if given is None:
        own = built_in_decoder(family, msgtype)
        return None if own is None else load_decoder(own)
    decoder = find_decoder(family, msgtype)
    plugin = None if decoder is None else decoder.plugin
    if decoder is None or plugin is None or plugin.as_json() != given:
        there = "it is not installed" if plugin is None else f"version {plugin.version} is installed"
        raise PluginError(
            f"{msgtype}: the plan has the decoder of {given['distribution']} {given['version']}, but {there}; "
            "start again."
        )
    return load_decoder(decoder)


@cache
def own_decoder(family: AnyFamily, msgtype: str) -> Callable[[Message], Any]:
    """Import and return the decoder of a family that packages cannot add to.

    The recipe names the topics of these families. Some drivers publish types of their own with the fields of the standard
    one; these are read like it.

    Returns:
        A function of the message; it also raises DecodeError if a type does not have the fields.
    """
    line = built_in_decoder(family, msgtype)
    if line is not None:
        decode: Callable[[Message], Any] = load_decoder(line)
        return decode
    alike = load_decoder(next(line for line in BUILT_IN if line.family == family))

    def decode_alike(message: Message) -> Any:
        try:
            return alike(message)
        except AttributeError as err:
            carried = msgtype.replace("/msg/", "/")
            raise DecodeError(f"it is a {carried}, expected {expected_types(family)}") from err

    return decode_alike


def load_decoder(decoder: Decoder) -> Any:
    """Import and return a decoder, with the signature of its family.

    `image`, `pose`, `fix`, `imu`, `camera_info`: a function of the message that returns a reading. `cloud` also takes the
    meaning of the header stamp and the moment for the stamp (`decode_pointcloud2`), `radar` the message type and the side
    of positive azimuths (`decode_radar`); plug-ins ignore these. `boxes`: a `BoxDecoder`. `packets` and `transforms`: a
    function that returns the items in a message.

    Raises:
        PluginError: the decoder is a plug-in and cannot be loaded.
    """
    plugin = decoder.plugin
    if plugin is None:
        module, _, name = decoder.reference.partition(":")
        return getattr(import_module(module), name)
    loaded = _load(plugin)
    if decoder.family == "boxes":
        return _checked_boxes(plugin, loaded)
    return _checked_function(plugin, loaded, _READINGS[decoder.family])


def load_built_in() -> None:
    """Import all built-in decoders before processes are forked from this one."""
    for line in BUILT_IN:
        load_decoder(line)


def _checked_function(plugin: DecoderPlugin, function: object, kind: type) -> Callable[..., object]:
    if not callable(function):
        raise PluginError(f"{plugin}: {plugin.reference} is not a function; fix or uninstall it.")

    def decode(message: Message, *_of_the_recipe: object) -> object:
        reading = _guarded(plugin, function, message)
        _check(plugin, reading, kind)
        return reading

    return decode


def _checked_boxes(plugin: DecoderPlugin, decoder: object) -> BoxDecoder:
    if not isinstance(decoder, BoxDecoder):
        raise PluginError(f"{plugin}: {plugin.reference} is not a BoxDecoder; fix or uninstall it.")

    def items(message: Message) -> Iterable[Message]:
        found: list[Message] = _guarded(plugin, lambda whole: list(decoder.items(whole)), message)
        return found

    def decode(message: Message, item: Message) -> BoxReading | None:
        box = _guarded(plugin, decoder.decode, message, item)
        if box is not None:
            _check(plugin, box, BoxReading)
        return box

    return BoxDecoder(items, decode)


def _load(plugin: DecoderPlugin) -> object:
    """Import a decoder.

    Raises:
        PluginError: the plug-in cannot be imported, or was upgraded since this process read its version.
    """
    entry = importlib.metadata.EntryPoint(plugin.name, plugin.reference, "")
    try:
        # Code imported only now must have the version in the action's key.
        version = importlib.metadata.version(plugin.package)
        if version == plugin.version:
            return entry.load()
    except Exception as err:  # any exception of foreign code is the plug-in's fault
        raise PluginError(
            f"{plugin}: {plugin.reference} cannot be loaded ({kind_and_text(err)}); fix or uninstall it."
        ) from err
    raise PluginError(f"{plugin}: version {version} was installed while this process ran; start it again.")


def _guarded(plugin: DecoderPlugin, function: Callable[_A, _R], *args: _A.args, **options: _A.kwargs) -> _R:
    """Call foreign code; any exception costs this message, with the line that raised it as the reason."""
    try:
        return function(*args, **options)
    except DecodeError:
        raise
    except Exception as err:
        # By type and line, not by text: lost messages are counted by reason, and texts contain values.
        raise DecodeError(f"{plugin} raised {type(err).__name__}{_place(err)}") from err


def _place(err: Exception) -> str:
    """Return the line in the plug-in's own code, not in a library that it calls, from which an error came."""
    frames = traceback.extract_tb(err.__traceback__)[1:]
    own = [frame for frame in frames if Path(frame.filename).parent == Path(frames[0].filename).parent]
    return f" at {Path(own[-1].filename).name}:{own[-1].lineno}" if own else ""


def _check(plugin: DecoderPlugin, reading: object, kind: type) -> None:
    """Raise DecodeError unless a reading is valid for its family."""
    if not isinstance(reading, kind):
        raise DecodeError(f"{plugin} returned {type(reading).__name__}, not {kind.__name__}")
    from bagassets.decode.readings import problem_of  # noqa: PLC0415  (it imports OpenCV, which a first pass need not wait for)

    problem = problem_of(reading)
    if problem is not None:
        raise DecodeError(f"{plugin} returned a {kind.__name__} whose {problem}")
