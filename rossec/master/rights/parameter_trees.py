"""Rights on trees of parameters, checked without listing them where possible. Pure.

Where a right covers everything below a namespace, or nothing there, its names are not checked one
by one. A check of a whole tree ends at the first name without the right, and covers at most
`MAX_NAMES_CHECKED` names, fewer for a caller with many patterns: a larger tree is refused. A
filtered query may take many turns, between which the tree may change.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

from ca.domains.aliases import shown
from grants.model import Right
from rossec.master.rights.caller import Caller, Refused
from rossec.ros import names

MAX_NAMES_CHECKED: Final = 8192  # names checked for one call, namespaces included
MAX_PATTERN_MATCHES: Final = 2 * MAX_NAMES_CHECKED  # of patterns with wildcards against names

ParameterItem: TypeAlias = tuple[str, object]
"""A key and its value; a dict is a namespace."""


class TreeDecision(NamedTuple):
    """Whether a parameter, or everything below a namespace, is covered."""

    item: ParameterItem
    covered: bool | None  # None: a namespace whose names are checked one by one


def require_tree(caller: Caller, right: Right, key: str, *items: ParameterItem) -> None:
    """Raise `Refused` unless `caller` has `right` on everything in `items`; also if empty.

    The text depends on `key` alone, which the caller knows: the uncovered name, the grants that
    nearly cover it, or the size of the tree would reveal which parameters exist.
    """
    if not items or not has_right_on_all(caller, right, items):
        needs = f"{caller.display_name} needs the right {right.label} on {shown(key)}"
        raise Refused(
            f"{needs}: no grant covers it and all below it ({caller.remedy(right, key)})",
            (right, key),
        )


def has_right_on_all(caller: Caller, right: Right, items: Sequence[ParameterItem]) -> bool:
    """Whether `caller` has `right` on every parameter in `items`, and `items` are not too large."""
    if len(items) == 1 and not isinstance(items[0][1], dict):  # the usual case
        return caller.may(right, items[0][0])
    limit = min(MAX_NAMES_CHECKED, MAX_PATTERN_MATCHES // max(1, caller.patterns(right)))
    results = (decision for item in items for decision in decisions(caller, right, item))
    return all(
        count <= limit and decision.covered is not False
        for count, decision in enumerate(results, 1)
    )


def decisions_across_turns(
    caller: Caller, right: Right, item: ParameterItem
) -> Iterator[TreeDecision]:
    """As `decisions`, for a tree that may change meanwhile."""
    return decisions(caller, right, item, lambda tree: tuple(tree.items()))


def decisions(
    caller: Caller,
    right: Right,
    item: ParameterItem,
    entries: Callable[[dict[str, object]], Iterable[Any]] = dict.items,
) -> Iterator[TreeDecision]:
    """Which parts of `item` are covered by `right`, in the order of the tree."""
    key, value = item
    if not isinstance(value, dict) or not value:
        yield TreeDecision(item, caller.may(right, key))
    elif caller.may_all_below(right, key):
        yield TreeDecision(item, covered=True)
    elif not caller.may_some_below(right, key):
        yield TreeDecision(item, covered=False)
    else:
        yield TreeDecision(item, covered=None)
        for name, below in entries(value):
            yield from decisions(caller, right, (names.join(key, name), below), entries)


def parameter_names(item: ParameterItem) -> Iterator[str]:
    """The name of every parameter in `item`, in stock's order; the tree may change meanwhile."""
    key, value = item
    if not isinstance(value, dict):
        yield key
        return
    for name, below in tuple(value.items()):
        yield from parameter_names((names.join(key, name), below))
