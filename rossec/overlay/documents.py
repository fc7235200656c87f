"""JSON files of relays and routers: one object that names its form, with exactly these keys. Pure.

A file of another kind is told from a damaged one, so that the message says what was mistaken. A key
that occurs twice, `NaN` and anything nested without end are refused (RFC 8259 section 4 leaves the
first to each reader).
"""

import json
from collections.abc import Mapping
from typing import Any, Final, NoReturn

from rossec.errors import ConfigurationError

VERSION: Final = 1


def read_document(
    data: bytes, form: str, keys: frozenset[str], *, limit: int, hint: str
) -> dict[str, Any]:
    """The entries of a document of this form, without the entry that names it.

    Args:
        data: the content of the file.
        form: what it is: `rossec-seat`.
        keys: of its entries, all of which it has. Their values are the caller's to check.
        limit: bytes it may have.
        hint: of the error: how to get another one.

    Raises:
        ConfigurationError: anything else.
    """
    if len(data) > limit:
        raise ConfigurationError(f"a {form} file has at most {limit} bytes", hint)
    try:
        found = json.loads(data, object_pairs_hook=_once, parse_constant=_refuse_constant)
    except (ValueError, RecursionError):
        raise ConfigurationError(f"the {form} file is not JSON", hint) from None
    if not isinstance(found, dict) or form not in found:
        raise ConfigurationError(f"this is no {form} file", hint)
    version = found.pop(form)
    if version != VERSION or not isinstance(version, int) or isinstance(version, bool):
        raise ConfigurationError(f"the {form} file is of another version", hint)
    if found.keys() != keys:
        raise ConfigurationError(f"the {form} file has other entries than it should", hint)
    return found


def write_document(form: str, entries: Mapping[str, Any]) -> bytes:
    """What `read_document` reads."""
    return json.dumps({form: VERSION, **entries}, indent=1).encode() + b"\n"


def is_texts(value: object) -> bool:
    """Whether a value is a list of texts."""
    return isinstance(value, list) and all(isinstance(each, str) for each in value)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a key occurs twice")
    return found


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")
