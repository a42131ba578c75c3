"""Layouts of message types: a type with all types that it refers to.

A definition recorded with the messages is the only layout of its type. Without one, the user's folders of `.msg` files
come first, then the known versions of packages (`bagassets.recordings.known_types`) and the standard types, newest
first. Where several layouts are possible, `Choice` picks the one that fits the bytes.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache, partial
from pathlib import Path
from threading import Lock
from typing import cast

from rosbags.interfaces import CDRDeser, Msgdef, Nodetype
from rosbags.interfaces.typing import Constdefs, Fielddefs, Typesdict
from rosbags.serde.cdr import generate_deserialize_cdr
from rosbags.serde.ros1 import generate_deserialize_ros1
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.base import make_typesdict, normalize_fieldname
from rosbags.typesys.msg import MSGParser
from rosbags.typesys.store import Typestore

from bagassets.base.errors import BagAssetsError, DecodeError, RecordingError
from bagassets.recipe.model import Limits
from bagassets.recordings.elements import announced_elements, fewest_bytes_of, padded_end
from bagassets.recordings.known_types import FieldType, Types, known_versions
from bagassets.recordings.model import Definition, Message, Serialization
from bagassets.store.canonical import digest_json

# Missing from the ROS 1 type store, yet in most ROS 1 bags; `tf/tfMessage` is the older name.
_TF = "geometry_msgs/TransformStamped[] transforms\n"
TF_NAMES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
# Definitions of ROS 1 do not spell these out; all standard types take 30 ms to load.
_TIMES = "int32 sec\nuint32 nanosec\n"
_TIME_NAMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
# Standard types that had other fields before Humble, when bags had no definitions yet.
CHANGED_IN_HUMBLE = frozenset({"shape_msgs/msg/SolidPrimitive", "visualization_msgs/msg/Marker"})

IDL_TEXT = re.compile(r"//[^\n]*|/\*.*?\*/|\"(?:\\\\.|[^\"\\\\])*\"", re.DOTALL)
"""Comments and strings."""
_OPERATOR = re.compile(r"<<|\*")
# Bags list a type and the types that it includes in sections headed like this.
_IDL_SECTION = re.compile(r"^=+\r?\nIDL: .*$", re.MULTILINE)

# In the header of a message: big and little endian, and those of XCDR2, which aligns eight bytes otherwise, and nothing else.
_PLAIN_CDR = frozenset({0, 1, 6, 7})
_EXTENDED_CDR = "it is in extended CDR (XCDR2, or a list of parameters); record it in plain CDR (XCDR1)"

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no serialization begins like that
_UNTOLD_ZSTD = (
    "it is compressed by zstd, which nothing says; give its folder a metadata.yaml with compression_mode: MESSAGE and "
    "compression_format: zstd"
)

_COMMON = (
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "tf2_msgs/msg/TFMessage",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
)

Lookup = Callable[[str], tuple[Constdefs, Fielddefs] | None]
# The `.msg` files of a folder with size and mtime, so that a process notices an edit.
FolderListing = tuple[tuple[Path, int, int], ...]


@dataclass(frozen=True)
class Layout:
    """One way to read a message type.

    Attributes:
        msgtype: the type.
        serialization: how its messages are serialized.
        types: it and all types that it refers to.
    """

    msgtype: str
    serialization: Serialization
    types: Types

    @cached_property
    def store(self) -> Typestore:
        """A type store with these types, and with others that agree with them."""
        return _compiled(self.types, self.serialization)

    @cached_property
    def digest(self) -> str:
        """Digest of everything that decides what a payload decodes to; comments do not count."""
        types = {
            name: {
                "constants": [[str(part) for part in constant] for constant in constants],
                "fields": [[field, _plain(description)] for field, description in fields],
            }
            for name, (constants, fields) in self.types.items()
        }
        return digest_json({"type": self.msgtype, "serialization": self.serialization, "types": types})

    @cached_property
    def fewest_bytes(self) -> Callable[[int], int | None]:
        """The smallest size at which a message can hold more than so many elements; see `fewest_bytes_of`."""
        return cache(partial(fewest_bytes_of, self.types, self.msgtype, self.serialization))

    @property
    def text(self) -> str:
        """The definition as ROS writes it, with `MSG:` sections for nested types."""
        ros1 = self.serialization == "ros1"
        return self.store.generate_msgdef(self.msgtype, ros_version=1 if ros1 else 2)[0]

    def decode(self, data: bytes | memoryview) -> Message:
        """Return the message object.

        Raises:
            DecodeError: the bytes do not fit.
        """
        encoding = data[1] if self.serialization == "cdr" and len(data) > 1 else 0
        if encoding not in _PLAIN_CDR:
            raise DecodeError(_UNTOLD_ZSTD if bytes(data[:4]) == ZSTD_MAGIC else _EXTENDED_CDR)
        decode = self.store.deserialize_ros1 if self.serialization == "ros1" else self.store.deserialize_cdr
        try:
            return cast("Message", decode(data, self.msgtype))
        except MemoryError:
            raise
        except Exception as err:  # rosbags' generated code raises anything on bytes that do not fit
            end = None if self.serialization == "ros1" else padded_end(self.types, self.msgtype, data)
            if end is None or end >= len(data):
                misfit = f"its bytes do not fit {self.msgtype}"
                raise DecodeError(_EXTENDED_CDR if encoding > 1 else misfit) from err
        return self.decode(data[:end])


class _Codec:
    """What rosbags generates for reading a type, each function when it is first needed.

    A `Msgdef` has fourteen functions, of which reading a recording needs one.
    """

    def __init__(self, store: Typestore, msgtype: str) -> None:
        self.fields: Fielddefs = [
            (normalize_fieldname(name), kind) for name, kind in store.fielddefs[msgtype][1]
        ]
        self.cls = store.types[msgtype]
        self._store = store

    @cached_property
    def deserialize_ros1(self) -> CDRDeser:
        return generate_deserialize_ros1(self.fields, self._store)

    @cached_property
    def deserialize_cdr_le(self) -> CDRDeser:
        return generate_deserialize_cdr(self.fields, self._store, "le")

    @cached_property
    def deserialize_cdr_be(self) -> CDRDeser:
        return generate_deserialize_cdr(self.fields, self._store, "be")


class _ReadingStore(Typestore):
    """A type store that can only read messages."""

    def get_msgdef(self, typename: str) -> Msgdef[object]:
        """Return what reads messages of a type."""
        codec = self.cache.get(typename)
        if codec is None:
            codec = self.cache[typename] = cast("Msgdef[object]", _Codec(self, typename))
        return codec


_STORES: list[_ReadingStore] = []
_STORES_LOCK = Lock()


def _compiled(types: Types, serialization: Serialization) -> Typestore:
    """Return a type store with all of these types, ready to read messages of them.

    Message types of one rig share most of their parts; each part (half a millisecond) is compiled once for all of them.
    """
    with _STORES_LOCK:
        for store in _STORES:
            if all(store.fielddefs.get(name, fields) == fields for name, fields in types.items()):
                break
        else:
            store = _ReadingStore()
            _STORES.append(store)
        store.register({name: fields for name, fields in types.items() if name not in store.fielddefs})
        for name in types:  # generating the functions refuses impossible fields
            codec = store.get_msgdef(name)
            _ = codec.deserialize_ros1 if serialization == "ros1" else codec.deserialize_cdr_le
        return store


class Choice:
    """The possible layouts of a type, and how many messages did not fit each.

    Args:
        layouts: at least one, the likeliest first.
    """

    def __init__(self, layouts: Sequence[Layout]) -> None:
        self.layouts = tuple(layouts)
        self._misfits = [0] * len(self.layouts)

    @property
    def best(self) -> Layout:
        """The layout that most messages fitted; on a tie, the likeliest one."""
        return self.layouts[self._misfits.index(min(self._misfits))]

    def decode(self, data: bytes | memoryview) -> Message:
        """Return the message object, decoded by the best layout that fits.

        Raises:
            DecodeError: no layout fits.
        """
        if len(self.layouts) == 1:
            return self.layouts[0].decode(data)
        for number in sorted(range(len(self.layouts)), key=self._misfits.__getitem__):
            try:
                return self.layouts[number].decode(data)
            except DecodeError as err:
                self._misfits[number] += 1
                problem = err
        raise problem


def choice_of(
    msgtype: str,
    serialization: Serialization,
    definition: Definition | None,
    folders: Sequence[Path],
    limits: Limits | None = None,
) -> Choice | str:
    """Return the layouts of a type, or the reason why it has none.

    Args:
        msgtype: `pkg/msg/Type`.
        serialization: how its messages are serialized.
        definition: the one in the recording, if any.
        folders: of `.msg` files, laid out as `pkg/msg/Type.msg` or `pkg/Type.msg`.
        limits: bounds on the definition and its arrays; by default those of an empty recipe.

    Raises:
        RecordingError: a folder does not exist, or a file in it is no message definition.
    """
    limits = limits or Limits()
    if definition is not None and len(definition.text) > limits.definition_bytes:
        return f"the definition of {msgtype} is longer than limits.definition_bytes in the recipe allows"
    listings = tuple(_list_folder(folder) for folder in folders)
    layouts = _layouts(msgtype, serialization, definition, listings, limits.array_length)
    return layouts if isinstance(layouts, str) else Choice(layouts)


# Parsing and compiling a layout takes 2 ms, and recordings of one rig share their types.
@lru_cache(maxsize=512)
def _layouts(
    msgtype: str,
    serialization: Serialization,
    definition: Definition | None,
    folders: tuple[FolderListing, ...],
    array_length: int,
) -> tuple[Layout, ...] | str:
    given = definition is not None and definition.format != "none" and bool(definition.text)
    try:
        own = _parsed(definition, msgtype) if definition is not None and given else {}
        candidates: list[Types] = []
        for lookups in _lookup_orders(msgtype, own, folders, serialization):
            types = _closure(msgtype, lookups)
            if types is not None and types not in candidates:
                if announced_elements(types, msgtype) > array_length:
                    return (
                        f"the definition of {msgtype} announces more strings and messages in arrays than "
                        "limits.array_length in the recipe allows"
                    )
                candidates.append(types)
        layouts = tuple(Layout(msgtype, serialization, types) for types in candidates)
        for layout in layouts[:1]:
            _ = layout.store  # the others are compiled only if this one does not fit
            _ = layout.digest
    except (MemoryError, BagAssetsError):
        raise
    except Exception as err:  # noqa: BLE001  (a bad definition costs its topic, nothing more)
        return f"the definition of {msgtype} cannot be used ({_definition_problem(err)})"
    if layouts:
        return layouts
    if given:
        return f"the definition of {msgtype} cannot be used (it refers to types that are not defined)"
    return f"there is no definition of {msgtype}; name a folder of .msg files in bags.message_definitions"


def _definition_problem(err: Exception) -> str:
    """Return what is wrong with a definition, since messages of libraries are for programmers."""
    if isinstance(err, RecursionError):
        return "its types contain each other without end"
    if isinstance(err, ValueError) and not isinstance(err, UnicodeError):
        text = str(err)
        if "contains itself" in text or text.startswith("an array of"):
            return text
    if isinstance(err, TypesysError):
        lines = str(err).splitlines()
        if lines and lines[0].startswith("Could not parse") and len(lines) > 2 and lines[2].isdigit():
            return f"it does not parse at character {lines[2]}"
        if "conflicting Python names" in str(err):
            return "two of its fields have the same name"
    return "it does not parse, or names what Python cannot"


def _lookup_orders(
    msgtype: str, own: Types, folders: Sequence[FolderListing], serialization: Serialization
) -> Iterator[Sequence[Lookup]]:
    """Yield sequences of lookups to try in turn for each type, the likeliest sequence first."""
    package = msgtype.partition("/")[0]
    by_hand: Typesdict = {}
    for folder in folders:
        by_hand |= {name: fields for name, fields in _message_files(folder).items() if name not in by_hand}
    settled = msgtype in own or msgtype in by_hand
    # If the type itself is given, only the types that it refers to are looked up, in their newest version.
    versions = known_versions(package)[: 1 if settled else None] or ({},)
    standards = (
        ("ros1",) if serialization == "ros1" else ("humble",) if msgtype in own else ("humble", "galactic")
    )
    for version in versions:
        for standard in standards:
            yield (own.get, by_hand.get, version.get, _newest_known, _times().get, _standard(standard))


def _newest_known(name: str) -> tuple[Constdefs, Fielddefs] | None:
    versions = known_versions(name.partition("/")[0])
    return versions[0].get(name) if versions else None


def _standard(name: str) -> Lookup:
    def look_up(msgtype: str) -> tuple[Constdefs, Fielddefs] | None:
        # The older store takes 30 ms to load, so only types that differ there are looked up in it.
        old = name == "galactic" and msgtype in CHANGED_IN_HUMBLE
        stores = {"ros1": Stores.ROS1_NOETIC, "humble": Stores.ROS2_HUMBLE, "galactic": Stores.ROS2_GALACTIC}
        return _standard_types(stores[name if name == "ros1" or old else "humble"]).get(msgtype)

    return look_up


def compile_common_types() -> Iterator[None]:
    """Compile the types of most recordings, one at a time, before processes are forked from this one.

    The standard types are loaded by the way (30 ms for each version of ROS), for recordings without definitions.
    """
    orders: tuple[tuple[str, Serialization], ...] = (("ros1", "ros1"), ("humble", "cdr"))
    for standard, serialization in orders:
        for msgtype in _COMMON:
            types = _closure(msgtype, (_standard(standard),))
            if types is not None:
                _compiled(types, serialization)
            yield


@cache
def _times() -> Types:
    return {name: get_types_from_msg(_TIMES, name)[name] for name in _TIME_NAMES}


@cache
def _standard_types(store: Stores) -> Types:
    types = {name: (fields[0], fields[1]) for name, fields in get_typestore(store).fielddefs.items()}
    for name in TF_NAMES:
        types |= {} if name in types else get_types_from_msg(_TF, name)
    return types


def _closure(msgtype: str, lookups: Iterable[Lookup]) -> Typesdict | None:
    """Return a type and all types that it refers to; None if one of them is unknown."""
    types: Typesdict = {}
    missing = [msgtype]
    while missing:
        name = missing.pop()
        fields = next((found for look_up in lookups if (found := look_up(name)) is not None), None)
        if fields is None:
            return None
        types[name] = fields
        missing += [
            inner for _, description in fields[1] for inner in _references(description) if inner not in types
        ]
    return dict(sorted(types.items()))


def _references(description: FieldType) -> Iterator[str]:
    kind, inner = description
    if kind == Nodetype.NAME:
        yield inner
    elif kind in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
        yield from _references(inner[0])


def _plain(description: object) -> object:
    """Return a field's description as JSON."""
    if isinstance(description, Nodetype):
        return description.name
    return [_plain(part) for part in description] if isinstance(description, tuple) else description


class _Parser(MSGParser):
    ConstantName = PackageName = MSGParser.MixedSnake  # as ROS 1 allows


def _parsed(definition: Definition, msgtype: str) -> Types:
    if definition.format == "msg":
        # The parser does not take the carriage returns of files from Windows, which ROS does.
        text = f"MSG: {msgtype}\n{definition.text}".replace("\r\n", "\n")
        return make_typesdict(_Parser(text).specification())
    if _OPERATOR.search(IDL_TEXT.sub("", definition.text)):
        raise ValueError("it computes")
    types: Typesdict = {}
    for section in _IDL_SECTION.split(definition.text):
        # The parser has no preprocessor and needs none: each included file is a section of its own.
        text = "\n".join(line for line in section.splitlines() if not line.lstrip().startswith("#"))
        types |= get_types_from_idl(text) if text.strip() else {}
    return types


def _list_folder(folder: Path) -> FolderListing:
    if not folder.is_dir():
        raise RecordingError(f"{folder}: no such folder; correct bags.message_definitions in the recipe.")
    files = [(path, path.stat()) for path in sorted(folder.rglob("*.msg"))]
    return tuple((path, stat.st_size, stat.st_mtime_ns) for path, stat in files)


@cache
def _message_files(files: FolderListing) -> Types:
    """Return the types defined in `.msg` files."""
    types: Typesdict = {}
    for path, _, _ in files:
        package = path.parent.parent.name if path.parent.name == "msg" else path.parent.name
        try:
            definition = Definition("msg", path.read_text(encoding="utf-8"))
            types |= _parsed(definition, f"{package}/msg/{path.stem}")
        except Exception as err:  # as in `_layouts`
            raise RecordingError(
                f"{path}: expected a message definition, but {_definition_problem(err)}; correct the file."
            ) from err
    return types
