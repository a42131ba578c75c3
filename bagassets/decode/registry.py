"""Decoder plug-ins as the steps use them: what they add to an action's key, and loading them.

A step asks `decoder_params` while it plans, which imports nothing of the plug-in, and
`plugin_decoder` when it runs. What a plug-in returns or raises is checked message by message: a
foreign mistake costs messages, which are counted, and is told in one sentence.
"""

import importlib.metadata
import traceback
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.model import BoxReading, CloudReading, ImageReading, PoseReading, RadarReading
from bagassets.decode.readings import problem_of
from bagassets.errors import DecodeError, PluginError
from bagassets.plugins import DecoderPlugin, Family, installed_decoders

__all__ = ["decoder_params", "plugin_box_decoder", "plugin_decoder"]

_READINGS = {"image": ImageReading, "cloud": CloudReading, "radar": RadarReading, "pose": PoseReading}


def decoder_params(family: Family, msgtype: str) -> dict[str, Any]:
    """Return the parameter `decoder` of an action whose messages a plug-in decodes; else nothing.

    Raises:
        PluginError: it is not clear which plug-in that is.
    """
    plugin = installed_decoders().find(family, msgtype)
    return {} if plugin is None else {"decoder": plugin.as_json()}


def plugin_decoder(
    family: Family, msgtype: str, given: Mapping[str, str] | None
) -> Callable[[Any], Any] | None:
    """Load the decoder that an action is keyed by.

    Args:
        family: `image`, `cloud`, `radar` or `pose`.
        msgtype: the type of the messages.
        given: the parameter `decoder` of the action; None if it has none.

    Returns:
        message -> reading, raising DecodeError; None if `given` is.

    Raises:
        PluginError: it cannot be loaded, or is not the one that the action names.
    """
    if given is None:
        return None
    plugin = _announced(family, msgtype, given)
    function = _load(plugin)
    if not callable(function):
        raise PluginError(f"{plugin}: {plugin.reference} is no function; mend or uninstall it.")
    kind = _READINGS[family]

    def decode(message: Any) -> Any:
        reading = _guarded(plugin, function, message)
        _check(plugin, reading, kind)
        return reading

    return decode


def plugin_box_decoder(msgtype: str, given: Mapping[str, str] | None) -> BoxDecoder | None:
    """Load the decoder of boxes that an action is keyed by; None if `given` is None.

    Raises:
        PluginError: it cannot be loaded, or is not the one that the action names.
    """
    if given is None:
        return None
    plugin = _announced("boxes", msgtype, given)
    decoder = _load(plugin)
    if not isinstance(decoder, BoxDecoder):
        raise PluginError(f"{plugin}: {plugin.reference} is no BoxDecoder; mend or uninstall it.")

    def items(message: Any) -> Iterable[Any]:
        found: list[Any] = _guarded(plugin, lambda whole: list(decoder.items(whole)), message)
        return found

    def decode(message: Any, item: Any) -> BoxReading | None:
        box = _guarded(plugin, decoder.decode, message, item)
        if box is None:
            return None
        _check(plugin, box, BoxReading)
        reading: BoxReading = box
        return reading

    return BoxDecoder(items, decode)


def _announced(family: Family, msgtype: str, given: Mapping[str, str]) -> DecoderPlugin:
    """Return the installed plug-in, which must be the one that an action was keyed by."""
    plugin = installed_decoders().find(family, msgtype)
    if plugin is None or plugin.as_json() != given:
        there = "it is not installed" if plugin is None else f"installed is {plugin.version}"
        raise PluginError(
            f"{msgtype}: planned was the decoder of {given['distribution']} {given['version']}, but {there}; "
            "start again."
        )
    return plugin


def _load(plugin: DecoderPlugin) -> Any:
    """Import a decoder.

    Raises:
        PluginError: it cannot be imported, or was upgraded since this process read its version.
    """
    entry = importlib.metadata.EntryPoint(plugin.name, plugin.reference, "")
    try:
        # Code that is imported only now must be of the version that the action is keyed by.
        version = importlib.metadata.version(plugin.distribution)
        if version == plugin.version:
            return entry.load()
    except Exception as err:  # foreign code runs: whatever it raises is the plug-in's fault
        raise PluginError(
            f"{plugin}: {plugin.reference} cannot be loaded ({_in_words(err)}); mend or uninstall it."
        ) from err
    raise PluginError(f"{plugin}: version {version} was installed while this process ran; start it again.")


def _guarded(plugin: DecoderPlugin, function: Callable[..., Any], *args: Any) -> Any:
    """Call foreign code; whatever it raises costs this message, and names the line to blame."""
    try:
        return function(*args)
    except DecodeError:
        raise
    except Exception as err:
        # By type and place, not by text: lost messages are counted by reason, and texts hold values.
        raise DecodeError(f"{plugin} raised {type(err).__name__}{_place(err)}") from err


def _place(err: Exception) -> str:
    """Return where in the plug-in's own code an error arose, and not in a library that it calls."""
    frames = traceback.extract_tb(err.__traceback__)[1:]
    own = [frame for frame in frames if Path(frame.filename).parent == Path(frames[0].filename).parent]
    return f" at {Path(own[-1].filename).name}:{own[-1].lineno}" if own else ""


def _check(plugin: DecoderPlugin, reading: Any, kind: type) -> None:
    """Raise DecodeError unless a reading is what its family says."""
    if not isinstance(reading, kind):
        raise DecodeError(f"{plugin} returned {type(reading).__name__}, not {kind.__name__}")
    problem = problem_of(reading)
    if problem is not None:
        raise DecodeError(f"{plugin} returned a {kind.__name__} whose {problem}")


def _in_words(err: Exception) -> str:
    lines = str(err).strip().splitlines()
    return f"{type(err).__name__}: {lines[0]}" if lines else type(err).__name__
