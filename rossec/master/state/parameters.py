"""The parameter tree, pure; semantics of stock rosmaster's paramserver.py.

Values are XML-RPC values, a dict is a namespace. Keys arrive resolved. Rights are not decided here
(`rossec.master.rights.parameter_trees`), but which places a call reaches is said here: `place` and
`reach`. Stricter than stock: a name inside a tree is one segment (stock stores `{"a/b": 1}` where
nobody finds it again), and the depth is bounded by what can be sent back.
"""

from collections.abc import Collection, Iterator
from copy import deepcopy
from typing import Final, NamedTuple

from ca.errors import NameRefused
from ca.names import check_name
from rossec.master.state import parameter_values
from rossec.master.state.parameter_values import DEPTH_LIMIT, Tree
from rossec.ros import names

_SHOWN: Final = 80  # characters of a name in an error
SIZE_LIMIT: Final = 64 * 1024 * 1024  # bytes of all parameters together


class ParameterMissing(KeyError):
    """Nothing is set under this key."""


class TooLarge(ValueError):
    """All parameters together would take `size` bytes."""

    def __init__(self, size: int, limit: int) -> None:
        super().__init__(f"all parameters together would take more than {limit} bytes")
        self.size = size


class ParameterUpdate(NamedTuple):
    """What subscribers of `subscription` must be told: `key` now has this value ({}: unset)."""

    subscription: str
    key: str
    value: object
    to_setter: bool  # stock tells the setter itself only about exact keys inside a tree


class Parameters:
    """All parameters."""

    def __init__(self) -> None:
        self._top: Tree = {"": {}}  # the root has no name
        self.size = parameter_values.weight(self._top)

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
            ValueError: not the value of a parameter.
            TooLarge: all together would take more than `limit`.
        """
        segments = _segments(key)
        parameter_values.check(value, DEPTH_LIMIT - len(segments))
        if not segments and not isinstance(value, dict):
            raise TypeError("cannot set root of parameter tree to non-dictionary")
        parent, name, new = self._place(["", *segments], value)
        size = self.size + parameter_values.entry_weight(name, new)
        if name in parent:
            size -= parameter_values.entry_weight(name, parent[name])
        if limit is not None and size > max(limit, self.size):
            raise TooLarge(size, limit)
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
        self.size -= parameter_values.entry_weight(last, parent.pop(last))

    def place(self, key: str) -> tuple[str, object]:
        """What a call on `key` reaches: it, with what is there, if anything."""
        try:
            return key, self.get(key)
        except ParameterMissing:
            return key, None

    def reach(self, key: str) -> list[tuple[str, object]]:
        """What setting `key` changes: what is there, or a value above, which becomes a tree."""
        segments = _segments(key)
        value: object = self._top[""]
        for depth, segment in enumerate(segments):
            if not isinstance(value, dict):
                above = names.SEPARATOR + names.SEPARATOR.join(segments[:depth])
                return [(above, value), (key, None)]
            if segment not in value:
                return [(key, None)]
            value = value[segment]
        return [(key, value)]


def places_to_search(space: str, key: str) -> list[tuple[str, str]]:
    """Where a search for `key` from `space` looks, nearest first, and what it finds there.

    What is looked for is the first segment of `key`, upwards from `space`.

    Raises:
        ValueError: `key` is empty or private.
    """
    if not key or key.startswith(names.PRIVATE):
        raise ValueError("invalid key")
    if key.startswith(names.SEPARATOR):
        return [(key, key)]
    return list(names.search_paths(space, key))


def check_names(key: str, value: object) -> None:
    """Return if every name in a tree that is to be set at `key` is one that can be asked for.

    Raises:
        ValueError: which one is not.
    """
    if not isinstance(value, dict):
        return
    for name, below in value.items():
        inner = _slashed(key) + name
        if names.SEPARATOR in name or not _is_name(inner):
            raise ValueError(f"{name[:_SHOWN]!r} cannot be the name of a parameter in a tree")
        check_names(inner, below)


def updates(subscriptions: Collection[str], key: str, value: object) -> list[ParameterUpdate]:
    """Which subscriptions a change of `key` to `value` concerns (keys of both end with '/').

    A subscriber hears of anything at, above or below what it subscribed to; what a replaced tree
    no longer holds is reported as unset. All `subscriptions` are looked at only where a tree is
    set: they are of others, and may be many.
    """
    if not subscriptions:
        return []
    changed = _slashed(key)
    value = deepcopy(value)  # the event is delivered later, when the tree may have changed
    result = [
        ParameterUpdate(space, changed, value, to_setter=False)
        for space in _spaces(changed)
        if space in subscriptions
    ]
    if isinstance(value, dict):
        inside = dict(_inside(changed, value))
        below = (name for name in subscriptions if name != changed and name.startswith(changed))
        result += [
            ParameterUpdate(name, name, inside.get(name, {}), to_setter=True) for name in below
        ]
    return result


def subscription_key(key: str) -> str:
    """The form under which subscriptions to `key` are kept."""
    return _slashed(names.canonical(key))


def _slashed(key: str) -> str:
    return key if key.endswith(names.SEPARATOR) else key + names.SEPARATOR


def _is_name(key: str) -> bool:
    try:
        check_name(key)
    except NameRefused:
        return False
    return True


def _spaces(changed: str) -> list[str]:
    """`/`, `/a/`, `/a/b/` of `/a/b/`."""
    ends = [at for at, letter in enumerate(changed, 1) if letter == names.SEPARATOR]
    return [changed[:end] for end in ends]


def _segments(key: str) -> list[str]:
    return [segment for segment in key.split(names.SEPARATOR) if segment]


def _inside(key: str, value: Tree) -> Iterator[tuple[str, object]]:
    for name, below in value.items():
        inner = _slashed(key + name)
        yield inner, below
        if isinstance(below, dict):
            yield from _inside(inner, below)
