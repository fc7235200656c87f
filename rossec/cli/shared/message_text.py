"""Messages written by people: YAML as `rostopic pub` takes it, into the fields of a message.

A message is a mapping of some of its fields, or a list of all of them in order. A time is
`{secs, nsecs}`, a number of nanoseconds, or `now`; a header may be `auto`, which is the time now.
`sec` and `nanosec`, the names of ROS 2, are understood too.
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from grants import yaml_text
from grants.errors import YamlRefused
from rossec import clock
from rossec.cli.shared.message_output import TIME_FIELDS, is_message, is_time
from rossec.errors import ConfigurationError
from rossec.participant.message_types import (
    Message,
    element_of,
    field_names,
    field_value,
    set_field,
)
from rossec.terminal import printable

_SHOWN = 60  # characters of what was typed
_SECOND: Final = 1_000_000_000
_HEADER: Final = "std_msgs/msg/Header"
_ALL: Final = "its type has this many: give all of them"
_SPOKEN: Final = {"inf": float("inf"), "-inf": float("-inf"), "nan": float("nan")}


def fill(message: Message, content: object, now: int = 0) -> None:
    """Set the fields of `message` that `content` names, nested ones too.

    Args:
        now: nanoseconds since the epoch, which `now` and `auto` stand for.

    Raises:
        ConfigurationError: an unknown field, or a value of another kind than the field's.
    """
    _Filling(now).message("", message, content)


def stamp_now() -> int:
    """The time of this host in nanoseconds, for `fill`."""
    return int(clock.time() * _SECOND)


def mentions_now(content: object) -> bool:
    """Whether `content` may have `now` or `auto` in it: it is another message each time."""
    if isinstance(content, dict):
        return any(map(mentions_now, content.values()))
    return any(map(mentions_now, content)) if isinstance(content, list) else (
        content in ("now", "auto")
    )  # fmt: skip


@dataclass(frozen=True)
class _Filling:
    """One message being filled; `path` says where an error is, as `pose.position`."""

    now: int

    def message(self, path: str, message: Message, content: object) -> None:
        """Set fields of `message`."""
        if is_time(message):
            self._time(path, message, content)
        elif content == "auto" and message.__msgtype__ == _HEADER:
            self._time(path, message.stamp, self.now)
        else:
            for field, value in _by_name(path, message, content).items():
                self._field(f"{path}.{field}" if path else field, message, field, value)

    def _time(self, path: str, time: Message, content: object) -> None:
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

    def _field(self, path: str, message: Message, field: str, value: object) -> None:
        current = field_value(message, field)
        if is_message(current):
            self.message(path, current, value)
        elif isinstance(current, list):
            set_field(message, field, self._list(path, message, field, value))
        else:
            set_field(message, field, _like(path, current, value))

    def _list(self, path: str, message: Message, field: str, value: object) -> list[Any]:
        if not isinstance(value, list):
            raise ConfigurationError(f"{path} is a list, not {_kind(value)}", "write [a, b]")
        # A message begins with lists of this length, or none.
        fixed = len(field_value(message, field))
        if fixed not in (0, len(value)):
            has = _counted(fixed, "element")
            raise ConfigurationError(f"{path} has {has}, not {len(value)}", _ALL)
        element = element_of(message, field)
        return [self._element(f"{path}[{at}]", element(), item) for at, item in enumerate(value)]

    def _element(self, path: str, element: Any, value: object) -> Any:
        if not is_message(element):
            return _like(path, element, value)
        self.message(path, element, value)
        return element


def _by_name(path: str, message: Message, content: object) -> dict[str, object]:
    """What each field shall be; a list names them all in order."""
    fields = field_names(message)
    where = f"{path}: " if path else ""
    shown = [TIME_FIELDS[name] for name in fields] if is_time(message) else fields
    if isinstance(content, list):
        if len(content) != len(fields):
            raise ConfigurationError(
                f"{where}{_counted(len(content), 'value')} for {_counted(len(fields), 'field')}",
                f"give all of {', '.join(shown)} in this order, or name them: '{{field: value}}'"
                if shown else "it has no fields: write {}",
            )  # fmt: skip
        return dict(zip(fields, content, strict=True))
    if not isinstance(content, dict):
        raise ConfigurationError(
            f"{where}a message is a mapping of fields, not {_kind(content)}",
            f"it has {', '.join(shown)}: for example '{{{shown[0]}: ...}}'" if shown
            else "it has no fields: write {}",
        )  # fmt: skip
    for field in content:
        if field not in fields:
            name = message.__msgtype__.replace("/msg/", "/").replace("builtin_interfaces/", "")
            raise ConfigurationError(
                f"{where}no field {field!r} in {name}",
                f"it has {', '.join(shown)}" if shown else "it has none",
            )
    return content


def _like(path: str, current: Any, value: object) -> object:
    """`value` as the type the field has."""
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
        raise ConfigurationError(
            f"{path} is {_kind(current)}, not {_kind(value)}", _advice(current, value)
        )
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


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _kind(value: object) -> str:
    names = {str: "text", bool: "true or false", int: "a whole number", float: "a number",
             list: "a list", dict: "a mapping", type(None): "nothing"}  # fmt: skip
    return names.get(type(value), "a list")


def _advice(current: object, value: object) -> str:
    if isinstance(current, str) and isinstance(value, int | float):
        return f"put text that looks like a number in quotes: '\"{value}\"'"
    return "write the values as rostopic does: '{field: value}', or '[1, 2]' for a list"


def parse_message(text: str) -> object:
    """The YAML of a message, as in rostopic; see `grants.yaml_text.load`.

    Raises:
        ConfigurationError: invalid YAML, or over the limits.
    """
    try:
        return yaml_text.load(text)
    except YamlRefused as error:
        shown = printable(text[:_SHOWN]) + ("..." if len(text) > _SHOWN else "")
        raise ConfigurationError(
            f"cannot parse {shown}: {error}", error.hint or "for example '{data: hello}'"
        ) from error


def parse_arguments(texts: Sequence[str]) -> object:
    """The message of a command line, as in rostopic: one mapping, or each field in order.

    Without arguments every field stays zero.
    """
    _refuse_split(texts)
    values = [parse_message(text) for text in texts]
    if len(values) == 1 and isinstance(values[0], dict):
        return values[0]
    return values or {}


def _refuse_split(texts: Sequence[str]) -> None:
    """Refuse what a shell made several words of: `{header: {frame_id: map}}` without quotes.

    Raises:
        ConfigurationError: a word opens a bracket that only a later one closes.
    """
    if len(texts) > 1 and any(_unclosed(text) for text in texts) and not _unclosed(" ".join(texts)):
        raise ConfigurationError(
            f"the shell made {len(texts)} words of the message",
            f"put it in single quotes: {shlex.quote(' '.join(texts))}",
        )


def _unclosed(text: str) -> bool:
    return any(text.count(begin) > text.count(end) for begin, end in ("{}", "[]"))


def parse_documents(text: str) -> list[object]:
    """The messages of a file, each behind a line `---`, as `rossec topic echo` prints them."""
    documents = [""]
    for line in text.splitlines(keepends=True):
        if line.rstrip() == "---":
            documents.append("")
        else:
            documents[-1] += line
    return [parse_message(document) for document in documents if document.strip()]
