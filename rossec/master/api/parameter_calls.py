"""The Parameter Server's calls. Pure; texts are stock's.

A right must cover what a call reaches: for a tree every parameter in it, before and after. So
`setParam("/", ...)` or `getParam("/ns")` does not circumvent a missing right on one of them. Where a
right covers everything below a namespace, or nothing there, its names are not checked one by one. A
check of a whole tree ends at the first name without the right, and covers at most
`MAX_NAMES_CHECKED` names, fewer for a caller with many patterns: a larger tree is refused. A
filtered query may take many turns, between which the tree may change.
"""

import xmlrpc
import xmlrpc.client
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

from ca.names import is_alias, shown
from grants.model import Right
from rossec.master.api import methods
from rossec.master.rights.access_rules import require_address, require_capacity
from rossec.master.rights.caller import Caller, Refused, refusals_answered
from rossec.master.state import journals, parameters
from rossec.master.state.registry import Kind, NodeRef
from rossec.ros import names
from rossec.ros.xmlrpc import BODY_LIMIT

MAX_NAMES_CHECKED: Final = 8192  # names checked for one call, namespaces included
MAX_PATTERN_MATCHES: Final = 2 * MAX_NAMES_CHECKED  # of patterns with wildcards against names

ParameterItem: TypeAlias = tuple[str, object]  # A key and its value; a dict is a namespace


class TreeDecision(NamedTuple):
    item: ParameterItem
    covered: bool | None  # None: a namespace whose names are checked one by one


def require_tree(caller: Caller, right: Right, key: str, *items: ParameterItem) -> None:
    # Raise `Refused` unless `caller` has `right` on everything in `items`; also if empty. The text depends on
    # `key` alone, which the caller knows: the uncovered name, the grants that nearly cover it, or the size of
    # the tree would reveal which parameters exist.
    if not items or not has_right_on_all(caller, right, items):
        needs = f"{caller.display_name} needs the right {right.label} on {shown(key)}"
        raise Refused(
            f"{needs}: no grant covers it and all below it ({caller.remedy(right, key)})", (right, key)
        )


def has_right_on_all(caller: Caller, right: Right, items: Sequence[ParameterItem]) -> bool:
    # Whether there is `right` on every parameter in `items`, and `items` are not too large.
    if len(items) == 1 and not isinstance(items[0][1], dict):  # the usual case
        return caller.may(right, items[0][0])
    limit = min(MAX_NAMES_CHECKED, MAX_PATTERN_MATCHES // max(1, caller.patterns(right)))
    results = (decision for item in items for decision in decisions(caller, right, item))
    return all(count <= limit and decision.covered is not False for count, decision in enumerate(results, 1))


def decisions_across_turns(caller: Caller, right: Right, item: ParameterItem) -> Iterator[TreeDecision]:
    return decisions(caller, right, item, lambda tree: tuple(tree.items()))


def decisions(
    caller: Caller,
    right: Right,
    item: ParameterItem,
    entries: Callable[[dict[str, object]], Iterable[Any]] = dict.items,
) -> Iterator[TreeDecision]:
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
    key, value = item
    if not isinstance(value, dict):
        yield key
        return
    for name, below in tuple(value.items()):
        yield from parameter_names((names.join(key, name), below))


MAX_ENCODED: Final = 2 * BODY_LIMIT  # by `encoded_size`, about the length of an answer
_TOO_LONG: Final = f"rossec: an answer of more than {BODY_LIMIT} bytes: ask for less at a time"

Fault = xmlrpc.client.Fault


class ParameterCalls:
    """Handlers over the parameter tree and what is mirrored."""

    def __init__(self, tables: methods.MasterTables) -> None:
        self._parameters = tables.parameters
        self._mirrors = tables.imports.mirrors
        self._limit = tables.parameter_bytes
        self._registry = tables.registry
        # a subscriber with its rights when an update is sent; None: its key is revoked
        self._caller_of = tables.trust.caller_of
        self._bytes_added: Counter[bytes] = Counter()  # by key, net of what it deleted

    def mirror(
        self, changes: Iterable[parameters.MirrorChange], now: int
    ) -> tuple[methods.ParameterChanged, ...]:
        """The updates for subscribers of mirrored parameters that have changed."""
        return tuple(
            event for change in changes for event in self._updates(change.key, change.value, now, setter=None)
        )

    def get(self, request: methods.CallRequest) -> methods.Reply:
        key = request.text(1)
        item = self._item(key)
        require_tree(request.caller, Right.PARAM_GET, key, item)
        if item[1] is None:  # no parameter has this value
            return methods.Reply(0, f"Parameter [{key}] is not set", -1)
        return methods.Reply(_sendable(item[1]), f"Parameter [{key}]")

    def has(self, request: methods.CallRequest) -> methods.Reply:
        key = request.text(1)
        item = self._item(key)
        require_tree(request.caller, Right.PARAM_GET, key, item)
        return methods.Reply(item[1] is not None, key)

    def _item(self, key: str) -> ParameterItem:
        return self._mirrors.item(key) if is_alias(key) else self._parameters.item(key)

    def set(self, request: methods.CallRequest) -> methods.Reply:
        key, value, caller = request.text(1), request.arguments[2], request.caller
        with refusals_answered():
            parameters.refuse_mirror(key, value)
        try:
            # 1. The right on all that is there before and after: a tree that is replaced is deleted too.
            parameters.check_names(key, value)
            before = self._parameters.items_affected(key)  # the last of them is `key` itself
            has_tree = isinstance(value, dict) or isinstance(before[-1][1], dict)
            affected = [*before, (key, value)] if has_tree else before
            require_tree(caller, Right.PARAM_SET, key, *affected)
            # 2. One key adds at most half of all, or it could keep the others out; what was set before the
            #    master was started counts for no key.
            size, quota = self._parameters.size, self._limit // 2
            own = min(self._bytes_added[caller.thumbprint], size)  # others may have deleted it
            try:
                self._parameters.set(key, value, min(self._limit, size + max(0, quota - own)))
            except parameters.TooLarge as error:
                if error.size > self._limit:
                    raise parameters.TooLarge(error.size, self._limit) from error
                text = f"the parameters that {caller.identity} has set would take more than {quota} bytes"
                raise ValueError(text) from error
            self._account(caller, size)
        except (TypeError, ValueError) as error:
            return methods.Reply(0, f"Error: invalid arguments: {error}", -1)
        persist = methods.PersistParameter(journals.ParameterChange(key, value))
        events = self._updates(key, value, request.now, setter=caller.name)
        return methods.Reply(0, f"parameter {key} set", events=(persist, *events))

    def _account(self, caller: Caller, before: int) -> None:
        # Count what a caller added since the size was `before`, at least 0 in total.
        key = caller.thumbprint
        self._bytes_added[key] = min(self._bytes_added[key], before) + self._parameters.size - before
        if self._bytes_added[key] <= 0:
            del self._bytes_added[key]

    def delete(self, request: methods.CallRequest) -> methods.Reply:
        key = request.text(1)
        with refusals_answered():
            parameters.refuse_mirror(key)
        require_tree(request.caller, Right.PARAM_SET, key, self._parameters.item(key))
        before = self._parameters.size
        try:
            self._parameters.delete(key)
        except parameters.ParameterMissing:
            return methods.Reply(0, f"parameter [{key}] is not set", -1)
        self._account(request.caller, before)
        persist = methods.PersistParameter(journals.ParameterChange(key, deleted=True))
        events = self._updates(key, {}, request.now, setter=None)
        return methods.Reply(0, f"parameter {key} deleted", events=(persist, *events))

    def search(self, request: methods.CallRequest) -> methods.Steps:
        key, caller = request.text(1), request.caller
        try:
            candidates = parameters.search_candidates(caller.name, key)
        except ValueError as error:
            return methods.Reply(0, f"Internal failure: {error}", 0)
        for candidate, found in candidates:
            if self._item(candidate)[1] is None:
                continue
            results = decisions_across_turns(caller, Right.PARAM_GET, self._item(candidate))
            for count, decision in enumerate(results, 1):
                if decision.covered:
                    return methods.Reply(found, f"Found [{found}]")
                if not count % caller.names_per_yield:
                    yield
        return methods.Reply("", f"Cannot find parameter [{key}] in an upwards search", -1)

    def parameter_names(self, request: methods.CallRequest) -> methods.Steps:
        caller, shown, bytes_left, count = request.caller, list[str](), MAX_ENCODED, 0
        for item in (self._parameters.item("/"), *self._mirrors.items()):
            for decision in decisions_across_turns(caller, Right.PARAM_GET, item):
                # Names that are not shown count too, as each costs time.
                for name in parameter_names(decision.item) if decision.covered else (None,):
                    if name is not None:
                        shown.append(name)
                        bytes_left -= parameters.encoded_size(name)
                    if bytes_left < 0:
                        raise Fault(1, _TOO_LONG)
                    count += 1
                    if not count % caller.names_per_yield:
                        yield
        return methods.Reply(shown, "Parameter names")

    def subscribe(self, request: methods.CallRequest) -> methods.Reply:
        node, key = request.node(1), request.text(2)
        item = self._item(key)
        require_tree(request.caller, Right.PARAM_GET, key, item)
        require_address(self._registry, request.caller, node.uri, is_local=request.is_local)
        subscription = parameters.subscription_key(key)
        require_capacity(self._registry, Kind.PARAMETER, subscription, node)
        value = {} if item[1] is None else _sendable(item[1])
        events = self._registry.register_parameter(subscription, node)
        return methods.Reply(value, f"Subscribed to parameter [{key}]", events=tuple(events))

    def unsubscribe(self, request: methods.CallRequest) -> methods.Reply:
        node, key = request.node(1), request.text(2)
        self._registry.unregister(Kind.PARAMETER, parameters.subscription_key(key), node)
        return methods.Reply(1, f"Unsubscribe to parameter [{key}]")

    def _updates(
        self, key: str, value: object, now: int, setter: str | None
    ) -> tuple[methods.ParameterChanged, ...]:
        subscriptions = self._registry.keys(Kind.PARAMETER)
        allowed: dict[tuple[bytes, str], bool] = {}  # by key: it may have many nodes

        def may_receive(node: NodeRef, update: parameters.ParameterUpdate) -> bool:
            about = node.thumbprint, update.key
            if about not in allowed:
                caller = self._caller_of(node, now)
                item = update.key.removesuffix("/") or update.key, update.value
                allowed[about] = caller is not None and has_right_on_all(caller, Right.PARAM_GET, [item])
            return allowed[about]

        return tuple(
            methods.ParameterChanged(node, update.key, update.value)
            for update in parameters.updates(subscriptions, key, value)
            for node in self._registry.registered_nodes(Kind.PARAMETER, update.subscription)
            if (update.to_setter or node.name != setter) and may_receive(node, update)
        )


def _sendable(value: object) -> object:
    # The value, unless it is far too long: encoding it would already take long.
    if isinstance(value, dict) and parameters.exceeds(value, MAX_ENCODED):
        raise Fault(1, _TOO_LONG)
    return value
