"""Message types by their ROS 1 name: definition text, md5, serialization. No ROS install needed.

`rosbags` provides the definitions of Noetic's standard packages and the serialization; what it leaves out is
below. Other types are found in the packages of this host (`host_types`), or added from their `.msg` text. The
ROS 2 names (`pkg/msg/Type`) that `rosbags` uses do not leave this module.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import Any, Final

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError, normalize_fieldname
from rosbags.typesys.store import Typestore

from rossec.errors import MessageError
from rossec.participant.definitions import Definition, unknown_type
from rossec.participant.host_types import known_type

_TRANSFORMS: Final = "geometry_msgs/TransformStamped[] transforms\n"

FURTHER_TYPES: Final[Mapping[str, str]] = {
    "tf2_msgs/TFMessage": _TRANSFORMS,
    "tf/tfMessage": _TRANSFORMS,
    "tf2_msgs/TF2Error": (
        "uint8 NO_ERROR = 0\nuint8 LOOKUP_ERROR = 1\nuint8 CONNECTIVITY_ERROR = 2\n"
        "uint8 EXTRAPOLATION_ERROR = 3\nuint8 INVALID_ARGUMENT_ERROR = 4\n"
        "uint8 TIMEOUT_ERROR = 5\nuint8 TRANSFORM_ERROR = 6\n\nuint8 error\nstring error_string\n"
    ),
    "audio_common_msgs/AudioData": "uint8[] data\n",
    "audio_common_msgs/AudioDataStamped": ("std_msgs/Header header\naudio_common_msgs/AudioData audio\n"),
    "audio_common_msgs/AudioInfo": (
        "uint8 channels\nuint32 sample_rate\nstring sample_format\nuint32 bitrate\nstring coding_format\n"
    ),
}
"""The text of the .msg file, by name; a type comes after those it uses: transforms and sound, which are in
the vocabulary (`grants.vocabulary.contents`), so a policy can name them also on a host without ROS."""

_TIMES: Final = {"builtin_interfaces/msg/Time": "time", "builtin_interfaces/msg/Duration": "duration"}
# rosbags' names of ROS base types that numpy does not know under the same name
_NUMPY: Final = {"octet": "uint8", "byte": "int8", "char": "uint8"}
_SEGMENT: Final = re.compile("[A-Za-z][A-Za-z0-9_]*")  # rosbags makes Python code of it
_NO_FIELDS: Final = "structure_needs_at_least_one_member"
_CHECK_TEXT: Final = "check the text of the .msg file, and register the types it uses first"

Message = Any  # a dataclass made by rosbags; its fields are those of the definition


@dataclass(frozen=True)
class MessageType(Definition):
    """A message type whose messages can be created, serialized and deserialized."""

    @cached_property
    def _ros2_name(self) -> str:
        # Checked once: for each message it was a third of serializing a short one.
        return _ros2_name(self.name)

    def create(self, /, **fields: object) -> Message:
        """Create a message with every field at its zero value, then set `fields`. A field that is a keyword
        of Python is named as it is or as its attribute: `from_`."""
        message = _zero(self._ros2_name)
        names = _field_names(self._ros2_name)
        attributes = {attribute_of(name) for name in names}
        for field, value in fields.items():
            if field not in names and field not in attributes:
                known = ", ".join(names)
                raise MessageError(f"no field {field!r} in {self.name}", f"it has {known}")
            setattr(message, attribute_of(field), value)
        return message

    def serialize(self, message: Message) -> memoryview:
        """ROS 1 wire bytes of `message`, without the length prefix."""
        try:
            data: memoryview = _store().serialize_ros1(message, self._ros2_name)
        except Exception as error:
            raise MessageError(
                f"cannot serialize this as {self.name}: {error}", "check the types of its fields"
            ) from error
        return data

    def deserialize(self, data: bytes | memoryview) -> Message:
        try:
            return _store().deserialize_ros1(data, self._ros2_name)
        except Exception as error:
            raise MessageError(f"bytes that are not one {self.name}: {error}") from error


@cache
def message_type(name: str) -> MessageType:
    """Look up a type by its ROS name, for example `geometry_msgs/PoseStamped`. A type that is not a standard
    one, nor was registered, is that of its package on this host."""
    try:
        return registered_type(name)
    except MessageError:
        known = known_type(name)
        if known is None:
            raise
    register_types({name: known.definition})
    return registered_type(name)


def registered_type(name: str) -> MessageType:
    """A standard type, or one that was registered; packages are not looked at."""
    try:
        definition, md5sum = _store().generate_msgdef(_ros2_name(name), ros_version=1)
    except TypesysError as error:
        raise MessageError(f"unknown message type {name!r}", unknown_type(name, type_names())) from error
    return MessageType(name, md5sum, definition)


def type_names() -> list[str]:
    """The ROS names of all known types, to suggest one for a misspelt name."""
    return [name.replace("/msg/", "/") for name in _store().fielddefs]


def register_type(name: str, definition: str) -> MessageType:
    """Add the type `name` from the text of its `.msg` file; nested types must be known already."""
    register_types({name: definition})
    return message_type(name)


def register_types(definitions: Mapping[str, str]) -> None:
    """Add all of these types, by name, or none; raises as `register_type`."""
    types: dict[str, Any] = {}
    for name, definition in definitions.items():
        try:
            found = get_types_from_msg(definition, _ros2_name(name))
        except TypesysError as error:
            raise MessageError(f"cannot register {name}: {error}", _CHECK_TEXT) from error
        for _, fields in found.values():
            if len({attribute_of(field) for field, _ in fields}) < len(fields):
                raise MessageError(f"cannot register {name}: two fields of one name", _CHECK_TEXT)
            for kind in (kind for _, kind in fields):
                while kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                    kind = kind[1][0]  # noqa: PLW2901 - walk down to the element
                if kind[0] is Nodetype.NAME and kind[1] not in _store().fielddefs.keys() | found.keys():
                    unknown = kind[1].replace("/msg/", "/")
                    raise MessageError(f"cannot register {name}: unknown type {unknown}", _CHECK_TEXT)
        types |= found
    try:
        _store().register(types)
    except TypesysError as error:
        names = " and ".join(definitions)
        raise MessageError(f"cannot register {names}: {error}", _CHECK_TEXT) from error


def field_names(message: Message) -> list[str]:
    return _field_names(message.__msgtype__)


def attribute_of(field: str) -> str:
    return str(normalize_fieldname(field))


def field_value(message: Message, field: str) -> Any:
    return getattr(message, attribute_of(field))


def set_field(message: Message, field: str, value: object) -> None:
    setattr(message, attribute_of(field), value)


def element_of(message: Message, field: str) -> Callable[[], Any]:
    """What makes a zero element of the list `field` of `message`: a message, a time, a text."""
    return partial(_zero_field, _element(message, field))


def element_type(message: Message, field: str) -> str:
    """The type of the elements of the list `field` of `message`, as ROS 1 writes it."""
    kind, inner = _element(message, field)
    if kind is Nodetype.BASE:
        return str(inner[0])
    return _TIMES.get(inner, str(inner).replace("/msg/", "/"))


def _element(message: Message, field: str) -> Any:
    _, fields = _store().fielddefs[message.__msgtype__]
    return dict(fields)[field][1][0]


def _field_names(inner: str) -> list[str]:
    # rosbags adds a field to an empty message, as ROS 2's IDL requires; ROS 1 has none
    return [name for name, _ in _store().fielddefs[inner][1] if name != _NO_FIELDS]


@cache
def _store() -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC)
    for name, definition in FURTHER_TYPES.items():
        store.register(get_types_from_msg(definition, _ros2_name(name)))
    return store


def _ros2_name(name: str) -> str:
    package, slash, leaf = name.partition("/")
    if not slash or not all(_SEGMENT.fullmatch(part) for part in (package, leaf)):
        raise MessageError(f"{name!r} is not a message type name", "write package/Type")
    return f"{package}/msg/{leaf}"


def _zero(inner: str) -> Message:
    _, fields = _store().fielddefs[inner]
    values: dict[str, Any] = {attribute_of(name): _zero_field(kind) for name, kind in fields}
    return _store().types[inner](**values)


def _zero_field(kind: Any) -> object:
    match kind:
        case (Nodetype.BASE, (base, _)):
            if base == "string":
                return ""
            return np.zeros((), dtype=_NUMPY.get(base, base)).item()
        case (Nodetype.NAME, inner):
            return _zero(inner)
        case (Nodetype.ARRAY, (element, length)):
            return _zero_array(element, length)
        case (Nodetype.SEQUENCE, (element, _)):
            return _zero_array(element, 0)
        case _:
            raise MessageError(f"unknown field kind {kind!r}")


def _zero_array(element: Any, length: int) -> object:
    match element:
        case (Nodetype.BASE, (base, _)) if base != "string":
            return np.zeros(length, dtype=_NUMPY.get(base, base))
        case _:
            return [_zero_field(element) for _ in range(length)]
