"""Messages as text: printed for people and programs, written by people, and counted. Pure.

What is printed is YAML that `rostopic pub`, and `rossec topic pub`, take as it stands. It differs
from rostopic's own output only where that would not come back: numbers that YAML 1.1 takes for text
(`1e-05`, `nan`), and long or unusual text, which stays on its line here.

What is written is a mapping of some fields, or a list of all of them in order. A time is
`{secs, nsecs}` (also by the names of ROS 2), a number of nanoseconds, or `now`; a header may be
`auto`, which is the time now.
"""

import math
import shlex
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from grants.errors import YamlRefused
from grants.policy import source
from rossec import clock
from rossec.errors import ConfigurationError
from rossec.participant import message_types
from rossec.terminal import printable

# A time or duration of ROS 1 is a message to rosbags; (its name there, the one in ROS 1).
TIMES: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
TIME_FIELDS: Final = {"sec": "secs", "nanosec": "nsecs"}
Kinds = tuple[type, ...]
_SHOWN = 60  # characters of what was typed
_SECOND: Final = 1_000_000_000
_ALL: Final = "its type has this many: give all of them"
_SPOKEN: Final = {"inf": float("inf"), "-inf": float("-inf"), "nan": float("nan")}
_UNITS: Final = ((1_000_000, "MB"), (1000, "KB"), (1, "B"))


def plain(value: Any) -> object:
    if is_message(value):
        return {
            _shown_name(value, field): plain(message_types.field_value(value, field))
            for field in message_types.field_names(value)
        }
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list) else value


def is_message(value: object) -> bool:
    return hasattr(value, "__msgtype__")


def _shown_name(message: message_types.Message, field: str) -> str:
    return TIME_FIELDS[field] if is_time(message) else field


def is_time(value: object) -> bool:
    return getattr(value, "__msgtype__", "") in TIMES


def flat(message: message_types.Message, path: str = "") -> dict[str, str]:
    """Each value of the message by the path of its field, as `pose.position.x`."""
    found: dict[str, str] = {}
    for field in message_types.field_names(message):
        value, at = message_types.field_value(message, field), f"{path}{_shown_name(message, field)}"
        if is_message(value):
            found |= flat(value, f"{at}.")
        elif isinstance(value, list) and value and is_message(value[0]):
            for index, item in enumerate(value):
                found |= flat(item, f"{at}[{index}].")
        else:
            found[at] = _value(message, field, 0).strip()
    return found


def _value(message: message_types.Message, field: str, indent: int, hidden: Kinds = ()) -> str:
    value = message_types.field_value(message, field)
    if hidden and (length := _length(message, field, hidden)):
        return length
    if field == "nanosec" and is_time(message):
        return f"{value:9d}"  # of nanoseconds, as rostopic prints them
    if is_message(value):
        return _below(render(value, indent, hidden))
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return _list(value, indent, hidden) if isinstance(value, list) else _scalar(value)


def _length(message: message_types.Message, field: str, hidden: Kinds) -> str:
    value = message_types.field_value(message, field)
    if isinstance(value, list | np.ndarray):
        kind = message_types.element_type(message, field)
        if list in hidden or (str in hidden and kind == "string"):
            return f'"<array type: {kind}, length: {len(value)}>"'
    if str in hidden and isinstance(value, str):
        return f'"<string length: {len(value)}>"'
    return ""


def _below(text: str) -> str:
    return f"\n{text}" if text else "{}"


def render(message: message_types.Message, indent: int = 0, hidden: Kinds = ()) -> str:
    """The message as rostopic prints it: one `field: value` a line, nested by two spaces.

    Text was written by a peer: it stays on its line and cannot steer the terminal. Of lists and
    texts, whichever is `hidden`, only the length is printed.
    """
    head = " " * indent
    return "\n".join(
        f"{head}{_shown_name(message, field)}: {_value(message, field, indent + 2, hidden)}"
        for field in message_types.field_names(message)
    )


def _list(values: list[Any], indent: int, hidden: Kinds) -> str:
    head = f"\n{' ' * indent}- "
    if values and is_message(values[0]):
        return "".join(head + _below(render(item, indent + 2, hidden)) for item in values)
    if values and isinstance(values[0], str):
        return "".join(head + _scalar(item) for item in values)
    return "[" + ", ".join(map(_scalar, values)) + "]"


def _scalar(value: object) -> str:
    if isinstance(value, str):
        return quoted(value)
    if not isinstance(value, float):
        return str(value)
    # YAML 1.1 reads `1e-05` and `nan` as text: it must come back as the number it was.
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
    # A peer wrote it: it must not forge a line or steer the terminal (attack `terminal-output`).
    return f'"{printable(escaped)}"'


def fill(message: message_types.Message, content: object, now: int = 0) -> None:
    """Set the fields that `content` names, nested ones too; `now` and `auto` are `now`, in nanoseconds."""
    _Filling(now).message("", message, content)


@dataclass(frozen=True)
class _Filling:
    now: int

    def message(self, path: str, message: message_types.Message, content: object) -> None:
        if is_time(message):
            self._time(path, message, content)
        elif content == "auto" and message.__msgtype__ == "std_msgs/msg/Header":
            self._time(path, message.stamp, self.now)
        else:
            for field, value in _by_name(path, message, content).items():
                self._field(f"{path}.{field}" if path else field, message, field, value)

    def _time(self, path: str, time: message_types.Message, content: object) -> None:
        if content == "now" and time.__msgtype__.endswith("/Time"):
            content = self.now
        if isinstance(content, int) and not isinstance(content, bool):
            time.sec, time.nanosec = divmod(content, _SECOND)
            return
        fields = {theirs: ours for ours, theirs in TIME_FIELDS.items()}
        if isinstance(content, dict):
            content = {fields.get(name, name): value for name, value in content.items()}
        for field, value in _by_name(path, time, content).items():
            self._field(f"{path}.{TIME_FIELDS[field]}", time, field, value)

    def _field(self, path: str, message: message_types.Message, field: str, value: object) -> None:
        current = message_types.field_value(message, field)
        if is_message(current):
            self.message(path, current, value)
        elif isinstance(current, list):
            message_types.set_field(message, field, self._list(path, message, field, value))
        else:
            message_types.set_field(message, field, _like(path, current, value))

    def _list(self, path: str, message: message_types.Message, field: str, value: object) -> list[Any]:
        if not isinstance(value, list):
            raise ConfigurationError(f"{path} is a list, not {_kind(value)}", "write [a, b]")
        # A message begins with lists of this length, or none.
        fixed = len(message_types.field_value(message, field))
        if fixed not in (0, len(value)):
            has = _counted(fixed, "element")
            raise ConfigurationError(f"{path} has {has}, not {len(value)}", _ALL)
        element = message_types.element_of(message, field)
        return [self._element(f"{path}[{at}]", element(), item) for at, item in enumerate(value)]

    def _element(self, path: str, element: Any, value: object) -> Any:
        if not is_message(element):
            return _like(path, element, value)
        self.message(path, element, value)
        return element


def _by_name(path: str, message: message_types.Message, content: object) -> dict[str, object]:
    fields = message_types.field_names(message)
    where = f"{path}: " if path else ""
    shown = [TIME_FIELDS[name] for name in fields] if is_time(message) else fields
    if isinstance(content, list):
        if len(content) != len(fields):
            raise ConfigurationError(
                f"{where}{_counted(len(content), 'value')} for {_counted(len(fields), 'field')}",
                f"give all of {', '.join(shown)} in this order, or name them: '{{field: value}}'"
                if shown
                else "it has no fields: write {}",
            )
        return dict(zip(fields, content, strict=True))
    if not isinstance(content, dict):
        raise ConfigurationError(
            f"{where}a message is a mapping of fields, not {_kind(content)}",
            f"it has {', '.join(shown)}: for example '{{{shown[0]}: ...}}'"
            if shown
            else "it has no fields: write {}",
        )
    for field in content:
        if field not in fields:
            name = message.__msgtype__.replace("/msg/", "/").replace("builtin_interfaces/", "")
            raise ConfigurationError(
                f"{where}no field {field!r} in {name}",
                f"it has {', '.join(shown)}" if shown else "it has none",
            )
    return content


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _kind(value: object) -> str:
    names = {
        str: "text",
        bool: "true or false",
        int: "a whole number",
        float: "a number",
        list: "a list",
        dict: "a mapping",
        type(None): "nothing",
    }
    return names.get(type(value), "a list")


def _like(path: str, current: Any, value: object) -> object:
    try:
        if isinstance(current, np.ndarray):
            return _array(path, current, value)
        if isinstance(current, float):
            value = _SPOKEN.get(value, value) if isinstance(value, str) else value
            if isinstance(value, int) and not isinstance(value, bool):
                return float(value)
    except (ValueError, TypeError, OverflowError) as error:
        raise ConfigurationError(f"{path}: {error}", "a number of this field's type") from error
    if value is None and isinstance(current, str):
        return ""  # as rostopic: a key without a value is empty text
    if type(value) is not type(current):
        raise ConfigurationError(f"{path} is {_kind(current)}, not {_kind(value)}", _advice(current, value))
    return value


def _array(path: str, current: Any, value: object) -> Any:
    if isinstance(value, list) and current.dtype.kind == "f":
        value = [_SPOKEN.get(item, item) if isinstance(item, str) else item for item in value]
    if isinstance(value, bytes):
        return np.frombuffer(value, dtype=current.dtype)
    if not isinstance(value, list):
        raise ConfigurationError(f"{path} is a list, not {_kind(value)}", "write [1, 2]")
    if len(current) not in (0, len(value)):
        has = _counted(len(current), "number")
        raise ConfigurationError(f"{path} has {has}, not {len(value)}", _ALL)
    return np.asarray(value, dtype=current.dtype).reshape(len(value))


def _advice(current: object, value: object) -> str:
    if isinstance(current, str) and isinstance(value, int | float):
        return f"put text that looks like a number in quotes: '\"{value}\"'"
    return "write the values as rostopic does: '{field: value}', or '[1, 2]' for a list"


def stamp_now() -> int:
    """The time of this host in nanoseconds, for `fill`."""
    return int(clock.time() * _SECOND)


def mentions_now(content: object) -> bool:
    """Whether `content` may have `now` or `auto` in it: it is another message each time."""
    if isinstance(content, dict):
        return any(map(mentions_now, content.values()))
    return any(map(mentions_now, content)) if isinstance(content, list) else (content in ("now", "auto"))


def parse_arguments(texts: Sequence[str]) -> object:
    """The message of a command line, as in rostopic: one mapping, or each field in order.

    Without arguments every field stays zero.
    """
    if len(texts) > 1 and any(_unclosed(text) for text in texts) and not _unclosed(" ".join(texts)):
        raise ConfigurationError(
            f"the shell made {len(texts)} words of the message",
            f"put it in single quotes: {shlex.quote(' '.join(texts))}",
        )
    values = [parse_message(text) for text in texts]
    if len(values) == 1 and isinstance(values[0], dict):
        return values[0]
    return values or {}


def _unclosed(text: str) -> bool:
    return any(text.count(begin) > text.count(end) for begin, end in ("{}", "[]"))


def parse_message(text: str) -> object:
    """The YAML of a message, as in rostopic; see `grants.policy.source.load`."""
    try:
        return source.load_yaml(text)
    except YamlRefused as error:
        shown = printable(text[:_SHOWN]) + ("..." if len(text) > _SHOWN else "")
        raise ConfigurationError(
            f"cannot parse {shown}: {error}", error.hint or "for example '{data: hello}'"
        ) from error


def parse_documents(text: str) -> list[object]:
    """The messages of a file, each behind a line `---`, as `rossec topic echo` prints them."""
    documents = [""]
    for line in text.splitlines(keepends=True):
        if line.rstrip() == "---":
            documents.append("")
        else:
            documents[-1] += line
    return [parse_message(document) for document in documents if document.strip()]


class RateWindow:
    """How often messages came: the last `size` of them, or all since the beginning."""

    def __init__(self, size: int | None = None) -> None:
        self._times: deque[float] = deque(maxlen=size)
        self._fresh = False

    def add(self, now: float) -> None:
        self._times.append(now)
        self._fresh = True

    def describe(self) -> str:
        """As rostopic says it; without a new message since the last time, that."""
        fresh, self._fresh = self._fresh, False
        if len(self._times) < 2 or not fresh:
            return "no new messages"
        moments = list(self._times)
        gaps = [later - earlier for earlier, later in pairwise(moments)]
        mean = sum(gaps) / len(gaps)
        spread = math.sqrt(sum((gap - mean) ** 2 for gap in gaps) / len(gaps))
        return (
            f"average rate: {1 / mean if mean > 0 else 0:.3f}\n"
            f"\tmin: {min(gaps):.3f}s max: {max(gaps):.3f}s"
            f" std dev: {spread:.5f}s window: {len(moments)}"
        )


class SizeWindow:
    """How many bytes came: the last `size` messages, or all since the beginning."""

    def __init__(self, size: int | None = None) -> None:
        self._messages: deque[tuple[float, int]] = deque(maxlen=size)

    def add(self, now: float, size: int) -> None:
        self._messages.append((now, size))

    def describe(self, now: float) -> str:
        """As rostopic says it; with fewer than two messages nothing can be said."""
        if len(self._messages) < 2:
            return "no new messages"
        sizes = [size for _, size in self._messages]
        passed = max(now - self._messages[0][0], 1e-9)
        rate, total = sum(sizes) / passed, sum(sizes) / len(sizes)
        scale, unit = next((pair for pair in _UNITS if rate >= pair[0]), _UNITS[-1])
        shown = [f"{value / scale:.2f}{unit}" for value in (rate, total, min(sizes), max(sizes))]
        return (
            f"average: {shown[0]}/s\n\tmean: {shown[1]} min: {shown[2]} max: {shown[3]} window: {len(sizes)}"
        )
