"""Pseudonyms: HMAC-SHA-256 of a text under a named key, shortened.

The same text under the same key has the same pseudonym, so a receiver of two topics hashed with
one key can link them; different keys prevent that. Without the key a pseudonym can be neither
reversed nor compared with guesses. Keys stay with the publisher.
"""

import hmac
import re
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Final, TypeAlias

from grants.errors import FilterRefused
from grants.model import FilterRule

if TYPE_CHECKING:  # a node's home does not load the compiler
    from grants.filters.codegen import Buffer

Keys: TypeAlias = Mapping[str, bytes]

FILTER_KEY_SIZE: Final = 32
DEFAULT_LENGTH: Final = 16  # hexadecimal digits: 2^32 texts until two are likely to collide
RECEIVER: Final = "receiver"
_DERIVED: Final = b"rossec-pseudonym-receiver\0"
_KEY_NAME: Final = re.compile(r"[a-z][a-z0-9_-]{0,31}", re.ASCII)


def check_key_name(name: object) -> str:
    """Return `name` if it is a valid name of a filter key: it may become a file name.

    Raises:
        FilterRefused: not 1 to 32 lower case letters, digits, `-` and `_`, a letter first.
    """
    if not isinstance(name, str) or _KEY_NAME.fullmatch(name) is None:
        raise FilterRefused(
            f"not a key name: {str(name)[:40]!r}", "for example {hash: {key: ward}}"
        )
    return name


def key_names(rules: Iterable[FilterRule]) -> frozenset[str]:
    """The keys that `rules` need."""
    return frozenset(
        check_key_name(value)
        for rule in rules
        if rule.operator == "hash"
        for name, value in rule.parameters
        if name == "key"
    )


def is_personal(rules: Iterable[FilterRule]) -> bool:
    """Whether what `rules` do differs from receiver to receiver."""
    return any(rule.operator == "hash" and ("per", RECEIVER) in rule.parameters for rule in rules)


def receiver_keys(keys: Keys, receiver: bytes) -> Keys:
    """`keys` beside those of one receiver, by the thumbprint of its key."""
    own = {
        _personal(name): hmac.digest(key, _DERIVED + receiver, "sha256")
        for name, key in keys.items()
        if len(key) == FILTER_KEY_SIZE
    }
    return {**keys, **own}


def _personal(name: str) -> str:
    return f"{name}/{RECEIVER}"  # no name of a key has a slash


def pseudonyms(
    name: object, length: int, keys: Keys | None, *, personal: bool = False
) -> "Callable[[Buffer], tuple[Buffer, int]]":
    """The function from a text to the first `length` hexadecimal digits of its HMAC.

    Raises:
        FilterRefused: the key is not among `keys`, or too short.
    """
    name = check_key_name(name)
    if keys is None:
        return _no_key
    key = keys.get(_personal(name) if personal else name)
    if key is None or len(key) != FILTER_KEY_SIZE:
        raise FilterRefused(f"the publisher has no key {name!r} of {FILTER_KEY_SIZE} bytes")

    def rewrite(content: "Buffer") -> "tuple[Buffer, int]":
        return hmac.digest(key, bytes(content), "sha256").hex()[:length].encode(), length

    return rewrite


def _no_key(_: "Buffer") -> "tuple[Buffer, int]":
    raise ValueError  # of `codegen.LAYOUT_ERRORS`: the message is refused
