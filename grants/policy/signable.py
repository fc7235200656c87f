"""Whether a right of a policy can be in a grant at all: checked before anything is signed.

What is valid in a policy, rule by rule, may be too much for one grant: conditions of several rules
on one topic hold together, so they cannot be divided. Such a right is refused alone, by its name.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from typing import Final, TypeVar

from ca.encoding import MAX_SIZE
from ca.errors import HintedError
from grants import claims
from grants.conditions.compile import check_syntax
from grants.model import Permission

MAX_ENTRIES: Final = 64  # of one grant, where what it says can be divided
_MAX_TEXT: Final = 8 * 1024  # of one grant as text, which is longer than its encoding
MAX_SCOPE: Final = MAX_SIZE - 2048  # the rest of a grant: names, keys, times and the signature
_Right = TypeVar("_Right")
_TOO_LARGE: Final = "its conditions and filters are too large for one grant"


@lru_cache(maxsize=4096)
def why_unsignable(permissions: tuple[Permission, ...]) -> str:
    """Why no grant can have these entries together, as every verifier would say; empty: it can."""
    try:
        for item in permissions:
            for text in item.restriction.conditions if item.restriction is not None else ():
                check_syntax(text)
        scope = claims.scope_of(permissions)
        if len(scope) > MAX_SCOPE:
            return _TOO_LARGE
        claims.read_scope(scope)
    except HintedError as error:
        return str(error)
    except UnicodeEncodeError:
        return "a text in it is not Unicode"
    return ""


def divide(
    rights: Iterable[_Right], entries: Callable[[_Right], Sequence[Permission]]
) -> Iterator[tuple[_Right, ...]]:
    """The rights by grant, in order; `entries` of one right stay together."""
    part: list[_Right] = []
    size = number = 0
    for each in rights:
        found = entries(each)
        text = sum(len(repr(item)) for item in found)
        number += len(found)
        size += text
        if part and (number > MAX_ENTRIES or size > _MAX_TEXT):
            yield tuple(part)
            part, size, number = [], text, len(found)
        part.append(each)
    if part:
        yield tuple(part)
