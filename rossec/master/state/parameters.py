"""The parameter tree, pure; semantics of stock rosmaster's paramserver.py.

Values are XML-RPC values, a dict is a namespace. Keys arrive resolved. Rights are not decided here
(`rossec.master.rights.parameter_trees`); `item` and `items_affected` say which parameters a call
reaches. Stricter than stock: a name inside a tree is one segment (stock stores `{"a/b": 1}` under a
key that no call can read), and the depth is bounded by what can be encoded.
"""

from collections.abc import Collection, Iterator
from copy import deepcopy
from typing import Final, NamedTuple

from ca.errors import NameRefused
from ca.names import check_name
from rossec.master.state import parameter_values
from rossec.master.state.parameter_values import DEPTH_LIMIT, Tree
from rossec.ros import names

_NAME_SHOWN: Final = 80  # characters of a name in an error
SIZE_LIMIT: Final = 64 * 1024 * 1024  # bytes of all parameters together


class ParameterMissing(KeyError):
    """This key is not set."""


class TooLarge(ValueError):
    """All parameters together would take `size` bytes."""

    def __init__(self, size: int, limit: int) -> None:
        super().__init__(f"all parameters together would take more than {limit} bytes")
        self.size = size


class ParameterUpdate(NamedTuple):
    """The update for subscribers of `subscription`: `key` now has this value ({}: unset)."""

    subscription: str
    key: str
    value: object
    to_setter: bool  # stock notifies the setter itself only about exact keys inside a tree


class Parameters:
    """The tree of all parameters."""

    def __init__(self) -> None:
        self._top: Tree = {"": {}}  # the root has no name
        self.size = parameter_values.encoded_size(self._top)

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
        """Set a value, or replace a whole tree; values on the path become namespaces.

        Raises:
            TypeError: the root must stay a tree.
            ValueError: not a valid parameter.
            TooLarge: all together would take more than `limit`.
        """
        segments = _segments(key)
        parameter_values.check(value, DEPTH_LIMIT - len(segments))
        if not segments and not isinstance(value, dict):
            raise TypeError("cannot set root of parameter tree to non-dictionary")
        parent, name, new = self._insertion_point(["", *segments], value)
        size = self.size + parameter_values.member_size(name, new)
        if name in parent:
            size -= parameter_values.member_size(name, parent[name])
        if limit is not None and size > max(limit, self.size):
            raise TooLarge(size, limit)
        parent[name] = new
        self.size = size

    def _insertion_point(self, path: list[str], value: object) -> tuple[Tree, str, object]:
        """Where a value is inserted: the namespace, the name in it, and its new value."""
        node = self._top
        for depth, name in enumerate(path[:-1], 1):
            below = node.get(name)
            if not isinstance(below, dict):
                for missing in reversed(path[depth:]):
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
        self.size -= parameter_values.member_size(last, parent.pop(last))

    def item(self, key: str) -> tuple[str, object]:
        """`key` and its value, or None: the item that a call on `key` reaches."""
        try:
            return key, self.get(key)
        except ParameterMissing:
            return key, None

    def items_affected(self, key: str) -> list[tuple[str, object]]:
        """The items that setting `key` changes: its own, or a value above, which becomes a tree."""
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


def search_candidates(namespace: str, key: str) -> list[tuple[str, str]]:
    """The keys that a search for `key` from `namespace` tries, nearest first, and their results.

    The search is for the first segment of `key`, upwards from `namespace`.

    Raises:
        ValueError: `key` is empty or private.
    """
    if not key or key.startswith(names.PRIVATE):
        raise ValueError("invalid key")
    if key.startswith(names.SEPARATOR):
        return [(key, key)]
    return list(names.search_paths(namespace, key))


def check_names(key: str, value: object) -> None:
    """Check that every name in a tree that is to be set at `key` is a valid name.

    Raises:
        ValueError: names the invalid one.
    """
    if not isinstance(value, dict):
        return
    for name, below in value.items():
        inner = _with_slash(key) + name
        if names.SEPARATOR in name or not _is_name(inner):
            raise ValueError(f"{name[:_NAME_SHOWN]!r} cannot be the name of a parameter in a tree")
        check_names(inner, below)


def updates(subscriptions: Collection[str], key: str, value: object) -> list[ParameterUpdate]:
    """Which subscriptions a change of `key` to `value` concerns (keys of both end with '/').

    A subscriber is notified of any change at, above or below its key; a key that a replaced tree
    no longer contains is reported as unset. All `subscriptions` are searched only when a tree is
    set: other nodes may have made many.
    """
    if not subscriptions:
        return []
    changed = _with_slash(key)
    value = deepcopy(value)  # the event is delivered later, when the tree may have changed
    result = [
        ParameterUpdate(namespace, changed, value, to_setter=False)
        for namespace in _namespaces(changed)
        if namespace in subscriptions
    ]
    if isinstance(value, dict):
        inside = dict(_descendants(changed, value))
        below = (name for name in subscriptions if name != changed and name.startswith(changed))
        result += [
            ParameterUpdate(name, name, inside.get(name, {}), to_setter=True) for name in below
        ]
    return result


def subscription_key(key: str) -> str:
    """The form in which subscriptions to `key` are stored."""
    return _with_slash(names.canonical(key))


def _with_slash(key: str) -> str:
    return key if key.endswith(names.SEPARATOR) else key + names.SEPARATOR


def _is_name(key: str) -> bool:
    try:
        check_name(key)
    except NameRefused:
        return False
    return True


def _namespaces(changed: str) -> list[str]:
    """`/`, `/a/`, `/a/b/` of `/a/b/`."""
    ends = [at for at, letter in enumerate(changed, 1) if letter == names.SEPARATOR]
    return [changed[:end] for end in ends]


def _segments(key: str) -> list[str]:
    return [segment for segment in key.split(names.SEPARATOR) if segment]


def _descendants(key: str, value: Tree) -> Iterator[tuple[str, object]]:
    for name, below in value.items():
        inner = _with_slash(key + name)
        yield inner, below
        if isinstance(below, dict):
            yield from _descendants(inner, below)
