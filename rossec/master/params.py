"""The parameter tree, pure; semantics of stock rosmaster's paramserver.py.

Values are XML-RPC values, a dict is a namespace. Keys arrive resolved. Rights are not decided
here, but what a call reaches is said here: `leaves` of what is, `leaves_of` what would be.
Stricter than stock: a name inside a tree is one segment (stock stores `{"a/b": 1}` where nobody
finds it again), and the depth is bounded by what can be sent back.
"""

from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from typing import Final, NamedTuple

from rossec.master import values
from rossec.master.values import DEPTH_LIMIT, Tree
from rossec.ros import names

SIZE_LIMIT: Final = 64 * 1024 * 1024  # bytes of all parameters together


class ParameterMissing(KeyError):
    """Nothing is set under this key."""


class Update(NamedTuple):
    """What subscribers of `subscription` must be told: `key` now has this value ({}: unset)."""

    subscription: str
    key: str
    value: object
    to_setter: bool  # stock tells the setter itself only about exact keys inside a tree


class Parameters:
    """All parameters."""

    def __init__(self) -> None:
        self._top: Tree = {"": {}}  # the root has no name
        self.size = values.weight(self._top)

    def get(self, key: str) -> object:
        """The value, or the tree, at `key`; a live reference.

        Raises:
            ParameterMissing: not set.
        """
        value: object = self._top[""]
        for segment in _segments(key):
            if not isinstance(value, dict) or segment not in value:
                raise ParameterMissing(key)
            value = value[segment]
        return value

    def has(self, key: str) -> bool:
        """Whether `key` is set."""
        try:
            self.get(key)
        except ParameterMissing:
            return False
        return True

    def set(self, key: str, value: object, limit: int | None = None) -> None:
        """Set a value, or replace a whole tree; values on the way become namespaces.

        Raises:
            TypeError: the root must stay a tree.
            ValueError: not the value of a parameter, or all together would take more than `limit`.
        """
        segments = _segments(key)
        values.check(value, DEPTH_LIMIT - len(segments))
        if not segments and not isinstance(value, dict):
            raise TypeError("cannot set root of parameter tree to non-dictionary")
        parent, name, new = self._place(["", *segments], value)
        size = self.size + values.entry_weight(name, new)
        if name in parent:
            size -= values.entry_weight(name, parent[name])
        if limit is not None and size > max(limit, self.size):
            raise ValueError(f"all parameters together would take more than {limit} bytes")
        parent[name] = new
        self.size = size

    def _place(self, path: list[str], value: object) -> tuple[Tree, str, object]:
        """Where a change begins: the namespace, the name in it, and what will be there."""
        node = self._top
        for place, name in enumerate(path[:-1], 1):
            below = node.get(name)
            if not isinstance(below, dict):
                for missing in reversed(path[place:]):
                    value = {missing: value}
                return node, name, value
            node = below
        return node, path[-1], value

    def delete(self, key: str) -> None:
        """Unset a value or a tree.

        Raises:
            ParameterMissing: not set, or the root.
        """
        head, _, last = names.canonical(key).rpartition(names.SEPARATOR)
        parent = self.get(head)
        if not isinstance(parent, dict) or last not in parent:
            raise ParameterMissing(key)
        self.size -= values.entry_weight(last, parent.pop(last))

    def names(self) -> Iterator[str]:
        """Every parameter with a value, in stock's order."""
        return (name for name, value in _walk(names.SEPARATOR, self._top[""]) if value != {})

    def leaves(self, key: str) -> list[str]:
        """What a call on `key` reaches: the parameters below it, or itself if there are none."""
        try:
            return leaves_of(key, self.get(key))
        except ParameterMissing:
            return [key]

    def reach(self, key: str) -> list[str]:
        """What setting `key` changes: `leaves`, or a value on the way, which becomes a tree."""
        segments = _segments(key)
        value: object = self._top[""]
        for depth, segment in enumerate(segments):
            if not isinstance(value, dict):
                return [names.SEPARATOR + names.SEPARATOR.join(segments[:depth]), key]
            if segment not in value:
                return [key]
            value = value[segment]
        return leaves_of(key, value)

    def search(self, space: str, key: str, visible: Callable[[str], bool]) -> str | None:
        """Climb from `space` to the first namespace that has the first segment of `key`.

        Raises:
            ValueError: `key` is empty or private.
        """
        if not key or key.startswith(names.PRIVATE):
            raise ValueError("invalid key")
        if key.startswith(names.SEPARATOR):
            return key if self._shown(key, visible) else None
        first = _segments(key)[0]
        above = _segments(space)
        for length in range(len(above), -1, -1):
            prefix = names.SEPARATOR + names.SEPARATOR.join(above[:length])
            if self._shown(names.join(prefix, first), visible):
                return names.join(prefix, key)
        return None

    def _shown(self, key: str, visible: Callable[[str], bool]) -> bool:
        return self.has(key) and any(visible(leaf) for leaf in self.leaves(key))


def leaves_of(key: str, value: object) -> list[str]:
    """The parameters that `value` set at `key` consists of; an empty tree is one itself."""
    if not isinstance(value, dict):  # nearly always
        return [key]
    return [name for name, _ in _walk(key, value)]


def updates(subscriptions: Iterable[str], key: str, value: object) -> list[Update]:
    """Which subscriptions a change of `key` to `value` concerns (keys of both end with '/').

    A subscriber hears of anything at, above or below what it subscribed to; what a replaced tree
    no longer holds is reported as unset.
    """
    found = list(subscriptions)
    if not found:
        return []
    changed = _slashed(key)
    value = deepcopy(value)  # the event is delivered later, when the tree may have changed
    inside = dict(_inside(changed, value)) if isinstance(value, dict) else None
    result: list[Update] = []
    for subscription in found:
        if changed.startswith(_slashed(subscription)):
            result.append(Update(subscription, changed, value, to_setter=False))
        elif inside is not None and subscription.startswith(changed) and subscription not in inside:
            result.append(Update(subscription, subscription, {}, to_setter=True))
    if inside is not None:
        exact = (name for name in found if name in inside)
        result += [Update(name, name, inside[name], to_setter=True) for name in exact]
    return result


def subscription_key(key: str) -> str:
    """The form under which subscriptions to `key` are kept."""
    return _slashed(names.canonical(key))


def _slashed(key: str) -> str:
    return key if key.endswith(names.SEPARATOR) else key + names.SEPARATOR


def _segments(key: str) -> list[str]:
    return [segment for segment in key.split(names.SEPARATOR) if segment]


def _walk(key: str, value: object) -> Iterator[tuple[str, object]]:
    if not isinstance(value, dict) or not value:
        yield key, value
        return
    for name, below in value.items():
        yield from _walk(names.join(key, name), below)


def _inside(key: str, value: Tree) -> Iterator[tuple[str, object]]:
    for name, below in value.items():
        inner = _slashed(key + name)
        yield inner, below
        if isinstance(below, dict):
            yield from _inside(inner, below)
