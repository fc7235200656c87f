"""The parameter tree, pure; semantics of stock rosmaster's paramserver.py.

Values are XML-RPC values, a dict is a namespace. Keys arrive resolved. Rights are not decided here
(`rossec.master.api.parameter_calls`); `item` and `items_affected` say which parameters a call
reaches. Stricter than stock: a name inside a tree is one segment (stock stores `{"a/b": 1}` under a
key that no call can read), and the depth is bounded by what can be encoded. Every accepted value
must be encodable: XML-RPC has extensions (nil, long and big numbers) that a call can carry but no
answer can, and one such value would make every tree that contains it unreadable.
"""

from collections.abc import Collection, Iterator
from copy import deepcopy
from datetime import datetime
from itertools import accumulate
from typing import Any, Final, NamedTuple, NoReturn

from ca.errors import NameRefused
from ca.names import REMOTE, check_label, check_name, is_alias
from rossec.errors import ImportRefused
from rossec.master.state.imported_facts import Site
from rossec.ros import names, xmlrpc

DEPTH_LIMIT: Final = 32
_NAME_SHOWN: Final = 80  # characters of a name in an error
SIZE_LIMIT: Final = 64 * 1024 * 1024  # bytes of all parameters together
MIRROR_LIMIT: Final = 1024 * 1024  # bytes of the parameters of one site
_INTS: Final = range(-(2**31), 2**31)
_SCALAR, _TEXT, _ARRAY, _STRUCT, _MEMBER = 28, 36, 52, 46, 34  # bytes of markup of each
_SCALARS: Final = (bool, float, datetime)
_FLAT: Final = frozenset({int, *_SCALARS})
Tree = dict[str, object]


def check_value(value: object, depth: int = DEPTH_LIMIT) -> None:
    if depth < 0:
        raise ValueError(f"parameters nested deeper than {DEPTH_LIMIT}")
    if isinstance(value, dict):
        for name, below in value.items():
            is_segment = isinstance(name, str) and name and not name.startswith(names.PRIVATE)
            if not is_segment or names.SEPARATOR in name:
                raise ValueError(f"{name!r} cannot be the name of a parameter in a tree")
            check_value(below, depth - 1)
    elif isinstance(value, list):
        for item in value:
            check_value(item, depth - 1)
    elif type(value) is int:
        if value not in _INTS:
            _refuse(f"the number {value}" if abs(value) < 1 << 70 else "a number this long")
    elif type(value) not in _SCALARS and not isinstance(value, str | bytes):
        _refuse("nil" if value is None else f"a {type(value).__name__}")


def encoded_size(value: object) -> int:
    """About how many bytes `value` takes in an answer; for any value that a method returns."""
    match value:
        case xmlrpc.EncodedList():
            return len(value.text)
        case str() | bytes():
            return _TEXT + len(value)
        case dict():
            return _STRUCT + _MEMBER * len(value) + sum(map(len, value)) + _sizes(value.values())
        case list() | tuple():
            return _ARRAY + _sizes(value)
        case _:
            return _SCALAR


def exceeds(value: object, limit: int) -> bool:
    return any(limit < so_far for so_far in accumulate(_encoded_sizes(value)))


def member_size(name: str, value: object) -> int:
    return _MEMBER + len(name) + encoded_size(value)


def _encoded_sizes(value: object) -> Iterator[int]:
    if not isinstance(value, dict):
        yield encoded_size(value)
        return
    yield _STRUCT + _MEMBER * len(value) + sum(map(len, value))
    if _flat_size(value.values()) is not None:
        yield _sizes(value.values())
        return
    for below in value.values():
        yield from _encoded_sizes(below)


def _sizes(values: Collection[Any]) -> int:
    flat = _flat_size(values)
    return sum(map(encoded_size, values)) if flat is None else flat


def _flat_size(values: Collection[Any]) -> int | None:
    kinds = set(map(type, values))
    if kinds <= _FLAT:
        return _SCALAR * len(values)
    return _TEXT * len(values) + sum(map(len, values)) if kinds == {str} else None


def _refuse(what: str) -> NoReturn:
    raise ValueError(f"XML-RPC cannot carry {what} in an answer")


class ParameterMissing(KeyError):
    """This key is not set."""


class TooLarge(ValueError):
    """All parameters together would take `size` bytes."""

    def __init__(self, size: int, limit: int) -> None:
        super().__init__(f"all parameters together would take more than {limit} bytes")
        self.size = size


class ParameterUpdate(NamedTuple):
    subscription: str
    key: str
    value: object
    to_setter: bool  # stock notifies the setter itself only about exact keys inside a tree


class Parameters:
    def __init__(self) -> None:
        self._top: Tree = {"": {}}  # the root has no name
        self.size = encoded_size(self._top)

    def get(self, key: str) -> object:
        value: object = self._top[""]
        for segment in _segments(key):
            if not isinstance(value, dict) or segment not in value:
                raise ParameterMissing(key)
            value = value[segment]
        return value

    def set(self, key: str, value: object, limit: int | None = None) -> None:
        segments = _segments(key)
        check_value(value, DEPTH_LIMIT - len(segments))
        if not segments and not isinstance(value, dict):
            raise TypeError("cannot set root of parameter tree to non-dictionary")
        # Where it goes: namespaces that are missing on the way are made, a value on the way is replaced.
        path, parent, new = ["", *segments], self._top, value
        for depth, name in enumerate(path, 1):
            if depth == len(path):
                break
            below = parent.get(name)
            if not isinstance(below, dict):
                for missing in reversed(path[depth:]):
                    new = {missing: new}
                break
            parent = below
        size = self.size + member_size(name, new)
        if name in parent:
            size -= member_size(name, parent[name])
        if limit is not None and size > max(limit, self.size):
            raise TooLarge(size, limit)
        parent[name] = new
        self.size = size

    def delete(self, key: str) -> None:
        head, _, last = names.canonical(key).rpartition(names.SEPARATOR)
        parent = self.get(head)
        if not isinstance(parent, dict) or last not in parent:
            raise ParameterMissing(key)
        self.size -= member_size(last, parent.pop(last))

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
    # The keys that a search for `key` from `namespace` tries, nearest first, and their results. The search is
    # for the first segment of `key`, upwards from `namespace`.
    if not key or key.startswith(names.PRIVATE):
        raise ValueError("invalid key")
    if key.startswith(names.SEPARATOR):
        return [(key, key)]
    return list(names.search_paths(namespace, key))


def check_names(key: str, value: object) -> None:
    if not isinstance(value, dict):
        return
    for name, below in value.items():
        inner = _with_slash(key) + name
        if names.SEPARATOR in name or not _is_name(inner):
            raise ValueError(f"{name[:_NAME_SHOWN]!r} cannot be the name of a parameter in a tree")
        check_names(inner, below)


def updates(subscriptions: Collection[str], key: str, value: object) -> list[ParameterUpdate]:
    # Which subscriptions a change of `key` to `value` concerns (keys of both end with '/'). A subscriber is
    # notified of any change at, above or below its key; a key that a replaced tree no longer contains is
    # reported as unset. All `subscriptions` are searched only when a tree is set: other nodes may have made
    # many.
    if not subscriptions:
        return []
    changed = _with_slash(key)
    value = deepcopy(value)  # the event is delivered later, when the tree may have changed
    result = [
        ParameterUpdate(namespace, changed, value, to_setter=False)
        for end, letter in enumerate(changed, 1)
        if letter == names.SEPARATOR and (namespace := changed[:end]) in subscriptions
    ]
    if isinstance(value, dict):
        inside = dict(_descendants(changed, value))
        below = (name for name in subscriptions if name != changed and name.startswith(changed))
        result += [ParameterUpdate(name, name, inside.get(name, {}), to_setter=True) for name in below]
    return result


def subscription_key(key: str) -> str:
    return _with_slash(names.canonical(key))


def _with_slash(key: str) -> str:
    return key if key.endswith(names.SEPARATOR) else key + names.SEPARATOR


def _is_name(key: str) -> bool:
    try:
        check_name(key)
    except NameRefused:
        return False
    return True


def _segments(key: str) -> list[str]:
    return [segment for segment in key.split(names.SEPARATOR) if segment]


def _descendants(key: str, value: Tree) -> Iterator[tuple[str, object]]:
    for name, below in value.items():
        inner = _with_slash(key + name)
        yield inner, below
        if isinstance(below, dict):
            yield from _descendants(inner, below)


class MirrorChange(NamedTuple):
    """A parameter, or a namespace, that has changed; value `{}`: it is gone."""

    key: str
    value: object


class _Mirror(NamedTuple):
    site: Site
    parameters: Parameters


class Mirrors:
    """The parameters of all sites, read-only below `/remote/<label>`; `limit`: bytes of one site."""

    # Each has one writer, its origin, so there is no conflict and nothing circulates. `/` remains the own
    # tree alone: a node that reads or sets it reaches no mirror.
    def __init__(self, limit: int = MIRROR_LIMIT) -> None:
        self._limit = limit
        self._mirrors: dict[str, _Mirror] = {}

    def replace(self, site: Site, tree: dict[str, object]) -> list[MirrorChange]:
        """Take over all that is mirrored of a site, in its names from its root; returns what has changed."""
        new = Parameters()
        try:
            check_names(names.SEPARATOR, tree)
            new.set(names.SEPARATOR, tree, self._limit)
        except TooLarge as error:
            raise ImportRefused(
                f"the parameters of site {site.label} take more than {self._limit} bytes",
                "mirror fewer: `rossec federation param`",
            ) from error
        except (TypeError, ValueError) as error:
            raise ImportRefused(f"parameters of site {site.label}: {error}") from error
        if REMOTE[1:] in tree:
            raise ImportRefused(f"site {site.label} names what it mirrors itself")
        old = self._mirrors.get(site.check().label)
        before = _root(old.parameters) if old is not None and old.site == site else {}
        events = [] if old is None or old.site == site else self.drop(site.label)
        self._mirrors[site.label] = _Mirror(site, new)
        return [*events, *_changes(_namespace(site), before, _root(new))]

    def drop(self, label: str) -> list[MirrorChange]:
        held = self._mirrors.pop(label, None)
        if held is None:
            return []
        return [*_changes(_namespace(held.site), _root(held.parameters), {})]

    def item(self, key: str) -> tuple[str, object]:
        """`key` and its value, or None: as `Parameters.item`, for keys below `/remote`."""
        namespace, slash, rest = key.removeprefix(f"{REMOTE}/").partition(names.SEPARATOR)
        for _, (site, parameters) in sorted(self._mirrors.items()):
            if site.namespace == namespace and is_alias(key):
                value = parameters.item(f"{slash}{rest}" or names.SEPARATOR)[1]
                if value is not None:
                    return key, value
        return key, None

    def items(self) -> Iterator[tuple[str, object]]:
        for namespace in dict.fromkeys(held.site.namespace for held in self._mirrors.values()):
            yield self.item(f"{REMOTE}/{namespace}")


def refuse_mirror(key: str, value: object = None) -> None:
    """Return if setting `key` to `value`, or unsetting it, reaches nothing below `/remote`."""
    below_root = key == names.SEPARATOR and isinstance(value, dict) and REMOTE[1:] in value
    if is_alias(key) or below_root:
        raise NameRefused(
            f"{REMOTE if below_root else key} stands for parameters of other masters, "
            "which are only read here",
            "set it at its own master",
        )


def _namespace(site: Site) -> str:
    return f"{REMOTE}/{check_label(site.namespace)}"


def _root(parameters: Parameters) -> dict[str, object]:
    root = parameters.get(names.SEPARATOR)
    return root if isinstance(root, dict) else {}


def _changes(key: str, before: dict[str, object], after: dict[str, object]) -> Iterator[MirrorChange]:
    for name in dict.fromkeys((*before, *after)):
        old, new, inner = before.get(name), after.get(name), f"{key}/{name}"
        if old == new:
            continue
        if isinstance(old, dict) and isinstance(new, dict) and old and new:
            yield from _changes(inner, old, new)
        else:
            yield MirrorChange(inner, {} if new is None else new)
