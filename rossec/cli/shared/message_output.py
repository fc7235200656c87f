"""Messages as text for people and programs: as `rostopic echo` prints them, or as JSON.

What is printed is YAML that `rostopic pub`, and `rossec topic pub`, take as it stands. It differs
from rostopic's own output only where that would not come back: numbers that YAML 1.1 takes for text
(`1e-05`, `nan`), and long or unusual text, which stays on its line here.
"""

import math
from typing import Any, Final

import numpy as np

from rossec.participant.message_types import Message, element_type, field_names, field_value
from rossec.terminal import printable

# A time or duration of ROS 1 is a message to rosbags; (its name there, the one in ROS 1).
TIMES: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
TIME_FIELDS: Final = {"sec": "secs", "nanosec": "nsecs"}
_WIDTH: Final = 9  # of nanoseconds, as rostopic prints them


def is_message(value: object) -> bool:
    """Whether `value` is a message, and no other value of a field."""
    return hasattr(value, "__msgtype__")


def is_time(value: object) -> bool:
    """Whether `value` is a time or a duration of ROS 1."""
    return getattr(value, "__msgtype__", "") in TIMES


Kinds = tuple[type, ...]


def render(message: Message, indent: int = 0, hidden: Kinds = ()) -> str:
    """The message as rostopic prints it: one `field: value` a line, nested by two spaces.

    Text was written by a peer: it stays on its line and cannot steer the terminal. Of lists and
    texts, whichever is `hidden`, only the length is printed.
    """
    head = " " * indent
    return "\n".join(
        f"{head}{_shown_name(message, field)}: {_value(message, field, indent + 2, hidden)}"
        for field in field_names(message)
    )


def _shown_name(message: Message, field: str) -> str:
    return TIME_FIELDS[field] if is_time(message) else field


def _value(message: Message, field: str, indent: int, hidden: Kinds = ()) -> str:
    value = field_value(message, field)
    if hidden and (length := _length(message, field, hidden)):
        return length
    if field == "nanosec" and is_time(message):
        return f"{value:{_WIDTH}d}"
    if is_message(value):
        return _below(render(value, indent, hidden))
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return _list(value, indent, hidden) if isinstance(value, list) else _scalar(value)


def _list(values: list[Any], indent: int, hidden: Kinds) -> str:
    """Messages and texts have lines of their own, numbers stand in one."""
    head = f"\n{' ' * indent}- "
    if values and is_message(values[0]):
        return "".join(head + _below(render(item, indent + 2, hidden)) for item in values)
    if values and isinstance(values[0], str):
        return "".join(head + _scalar(item) for item in values)
    return "[" + ", ".join(map(_scalar, values)) + "]"


def _length(message: Message, field: str, hidden: Kinds) -> str:
    """What rostopic prints instead of a hidden value; empty: it is shown."""
    value = field_value(message, field)
    if isinstance(value, list | np.ndarray):
        kind = element_type(message, field)
        if list in hidden or (str in hidden and kind == "string"):
            return f'"<array type: {kind}, length: {len(value)}>"'
    if str in hidden and isinstance(value, str):
        return f'"<string length: {len(value)}>"'
    return ""


def _below(text: str) -> str:
    """The lines of a message below its name; an empty message (`{}`) has none."""
    return f"\n{text}" if text else "{}"


def _scalar(value: object) -> str:
    if isinstance(value, str):
        return quoted(value)
    return _float(value) if isinstance(value, float) else str(value)


def _float(value: float) -> str:
    """A number that YAML 1.1 reads as one: `1e-05` is text there, as it has no point."""
    if math.isnan(value):
        return ".nan"
    if math.isinf(value):
        return ".inf" if value > 0 else "-.inf"
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def quoted(text: str) -> str:
    """`text` in quotes, on one line; empty text is `''`, as rostopic prints it."""
    if not text:
        return "''"
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    for character, name in (("\n", "\\n"), ("\t", "\\t"), ("\r", "\\r")):
        escaped = escaped.replace(character, name)
    return f'"{printable(escaped)}"'


def plain(value: Any) -> object:
    """A message, or a value in one, as what JSON has."""
    if is_message(value):
        return {
            _shown_name(value, field): plain(field_value(value, field))
            for field in field_names(value)
        }
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list) else value


def flat(message: Message, path: str = "") -> dict[str, str]:
    """Each value of the message by the path of its field, as `pose.position.x`."""
    found: dict[str, str] = {}
    for field in field_names(message):
        value, at = field_value(message, field), f"{path}{_shown_name(message, field)}"
        if is_message(value):
            found |= flat(value, f"{at}.")
        elif isinstance(value, list) and value and is_message(value[0]):
            for index, item in enumerate(value):
                found |= flat(item, f"{at}[{index}].")
        else:
            found[at] = _value(message, field, 0).strip()
    return found
