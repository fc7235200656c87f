"""Messages as text: parsed from YAML, printed as rostopic does or as JSON."""

from typing import Any

import numpy as np

from grants import yaml_text
from grants.errors import YamlRefused
from rossec.errors import ConfigurationError
from rossec.participant.message_types import Message, field_names
from rossec.terminal import printable

_SHOWN = 60  # characters of what was typed


def fill(message: Message, content: object) -> None:
    """Set the fields of `message` that the mapping `content` names, nested ones too.

    Raises:
        ConfigurationError: an unknown field, or a value where a mapping is needed.
    """
    if not isinstance(content, dict):
        raise ConfigurationError("a message is a mapping of fields", "for example '{data: hello}'")
    for field, value in content.items():
        if field not in field_names(message):
            name = message.__msgtype__.replace("/msg/", "/")
            raise ConfigurationError(
                f"no field {field!r} in {name}", f"it has {', '.join(field_names(message))}"
            )
        current = getattr(message, field)
        if hasattr(current, "__msgtype__"):
            fill(current, value)
        else:
            setattr(message, field, _like(field, current, value))


def _like(field: str, current: Any, value: object) -> object:
    """`value` as the type the field has."""
    try:
        if isinstance(current, np.ndarray):
            return np.asarray(value, dtype=current.dtype)
        if isinstance(current, float) and isinstance(value, int):
            return float(value)
    except (ValueError, TypeError, OverflowError) as error:
        raise ConfigurationError(f"{field}: {error}") from error
    if type(value) is not type(current):
        raise ConfigurationError(
            f"{field} is of type {type(current).__name__}, not {type(value).__name__}"
        )
    return value


def render(message: Message, indent: int = 0) -> str:
    """The message as rostopic prints it: one `field: value` a line, nested by two spaces.

    Text was written by a peer: it stays on its line and cannot steer the terminal.
    """
    lines = []
    for field in field_names(message):
        value = getattr(message, field)
        head = " " * indent + f"{field}:"
        if hasattr(value, "__msgtype__"):
            lines += [head, render(value, indent + 2)]
        elif isinstance(value, list) and value and hasattr(value[0], "__msgtype__"):
            dash = " " * (indent + 2) + "-"
            lines += [head, *(f"{dash}\n{render(item, indent + 4)}" for item in value)]
        else:
            lines.append(f"{head} {_plain(value)}")
    return "\n".join(lines)


def _plain(value: Any) -> str:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list):
        return "[" + ", ".join(_quoted(item) for item in value) + "]"
    return "\\n".join(map(printable, str(value).split("\n")))


def _quoted(item: object) -> str:
    return f"'{_plain(item)}'" if isinstance(item, str) else str(item)


def plain(value: Any) -> object:
    """A message, or a value in one, as what JSON has."""
    if hasattr(value, "__msgtype__"):
        return {field: plain(getattr(value, field)) for field in field_names(value)}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list) else value


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
