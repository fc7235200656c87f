"""What a caller may do with trees of parameters, judged without listing them. Pure.

A right that covers all below a namespace answers for it at once, and so does one that touches
nothing there; only between the two is a tree looked at, name by name. What must be decided in one
go ends at the first name without the right, and looks at `LOOKS` names at most, fewer for who holds
many patterns: beyond that the answer is no. What is shown in part may take many turns, between
which the tree may change.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

from grants.model import Right
from rossec.master.rights.access_rules import ASK, Caller, Refused, label
from rossec.ros import names

LOOKS: Final = 8192  # names that one call may have looked at, namespaces too
PATTERNS: Final = 2 * LOOKS  # and how often a pattern with wildcards may be held against one

Place: TypeAlias = tuple[str, object]
"""A key and the value there; a dict is a namespace."""


class Look(NamedTuple):
    """What was decided about a parameter, or about all below a namespace."""

    place: Place
    covered: bool | None  # None: of a namespace, in which what is below is looked at


def require_tree(caller: Caller, right: Right, key: str, *places: Place) -> None:
    """Raise `Refused` unless `caller` has `right` on all that is in `places`; nothing means no.

    The text depends on `key` alone, which the caller knows: the leaf that is missing, the grants
    that nearly cover it, or how much there is, would tell which parameters exist.
    """
    if not places or not may_all(caller, right, places):
        wanted = f"{caller.title} needs the right {label(right)} on {key}"
        raise Refused(f"{wanted}: no grant covers it and all below it ({ASK})", (right, key))


def may_all(caller: Caller, right: Right, places: Sequence[Place]) -> bool:
    """Whether `caller` has `right` on every parameter in `places`, and they are not too many."""
    if len(places) == 1 and not isinstance(places[0][1], dict):  # nearly always
        return caller.may(right, places[0][0])
    most = min(LOOKS, PATTERNS // max(1, caller.patterns(right)))
    looks = (look for place in places for look in looked(caller, right, place))
    return all(count <= most and look.covered is not False for count, look in enumerate(looks, 1))


def looked_in_turns(caller: Caller, right: Right, place: Place) -> Iterator[Look]:
    """As `looked`, of a tree that may change meanwhile."""
    return looked(caller, right, place, lambda tree: tuple(tree.items()))


def looked(
    caller: Caller,
    right: Right,
    place: Place,
    items: Callable[[dict[str, object]], Iterable[Any]] = dict.items,
) -> Iterator[Look]:
    """What `right` covers in `place` and what not, in the order of the tree."""
    key, value = place
    if not isinstance(value, dict) or not value:
        yield Look(place, caller.may(right, key))
    elif caller.may_all_below(right, key):
        yield Look(place, covered=True)
    elif not caller.may_some_below(right, key):
        yield Look(place, covered=False)
    else:
        yield Look(place, covered=None)
        for name, below in items(value):
            yield from looked(caller, right, (names.join(key, name), below), items)


def named(place: Place) -> Iterator[str]:
    """Every parameter in `place` that has a value, in stock's order; the tree may change."""
    key, value = place
    if not isinstance(value, dict):
        yield key
        return
    for name, below in tuple(value.items()):
        yield from named((names.join(key, name), below))
