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

if TYPE_CHECKING:
    from grants.filters.layout import Buffer


Keys: TypeAlias = Mapping[str, bytes]

FILTER_KEY_SIZE: Final = 32
DEFAULT_LENGTH: Final = 16  # hexadecimal digits: 2^32 texts until two are likely to collide
RECEIVER: Final = "receiver"
_DERIVED: Final = b"rossec-pseudonym-receiver\0"
_KEY_NAME: Final = re.compile(r"[a-z][a-z0-9_-]{0,31}", re.ASCII)


def check_key_name(name: object) -> str:
    """Return `name` if it is a valid name of a filter key: it may become a file name."""
    if not isinstance(name, str) or _KEY_NAME.fullmatch(name) is None:
        raise FilterRefused(f"not a key name: {str(name)[:40]!r}", "for example {hash: {key: ward}}")
    return name


def key_names(rules: Iterable[FilterRule]) -> frozenset[str]:
    """The keys that `rules` need."""
    hashes = (dict(rule.parameters) for rule in rules if rule.operator == "hash")
    return frozenset(check_key_name(given["key"]) for given in hashes if "key" in given)


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
    name = check_key_name(name)
    key = None if keys is None else keys.get(_personal(name) if personal else name)
    if keys is not None and (key is None or len(key) != FILTER_KEY_SIZE):
        raise FilterRefused(f"the publisher has no key {name!r} of {FILTER_KEY_SIZE} bytes")

    def rewrite(content: "Buffer") -> "tuple[Buffer, int]":
        if key is None:
            raise ValueError  # of `LAYOUT_ERRORS`: the message is refused
        return hmac.digest(key, bytes(content), "sha256").hex()[:length].encode(), length

    return rewrite
