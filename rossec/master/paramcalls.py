"""The Parameter Server's calls. Pure; texts are stock's.

A right must cover what a call reaches: for a tree every parameter in it, before and after. So
`setParam("/", ...)` or `getParam("/ns")` is no way around a missing right on one of them.
"""

from collections.abc import Callable

from grants.model import Right
from rossec.master import arguments as arg
from rossec.master import params
from rossec.master.calls import (
    Method,
    Methods,
    ParameterChanged,
    ParameterKept,
    Reply,
    Request,
)
from rossec.master.gatekeeper import Caller, require_room, require_tree
from rossec.master.journal import Change
from rossec.master.params import SIZE_LIMIT, ParameterMissing, Parameters
from rossec.master.registry import Kind, NodeRef, Registry


class ParameterCalls:
    """Handlers over one parameter tree.

    Args:
        caller_of: what a subscriber may read when an update goes out; None: nothing any more.
        limit: bytes of all parameters together.
    """

    def __init__(
        self,
        parameters: Parameters,
        registry: Registry,
        caller_of: Callable[[NodeRef, int], Caller | None],
        limit: int = SIZE_LIMIT,
    ) -> None:
        self._parameters = parameters
        self._limit = limit
        self._registry = registry
        self._caller_of = caller_of

    def methods(self) -> Methods:
        """The rows of the method table."""
        key, api = arg.key("key"), arg.uri("caller_api", "http")
        return {
            "getParam": Method((key,), 0, self._get),
            "hasParam": Method((key,), False, self._has),
            "setParam": Method((key, arg.not_none("value")), 0, self._set),
            "deleteParam": Method((key,), 0, self._delete),
            "searchParam": Method((arg.search_key("key"),), 0, self._search),
            "getParamNames": Method((), [], self._names),
            "subscribeParam": Method((api, key), 0, self._subscribe),
            "unsubscribeParam": Method((api, key), 0, self._unsubscribe),
        }

    def below(self, subscription: str) -> list[str]:
        """The parameters that a subscription reaches."""
        return self._parameters.leaves(subscription.removesuffix("/") or "/")

    def _get(self, request: Request) -> Reply:
        key = request.text(1)
        require_tree(request.caller, Right.PARAM_GET, key, self._parameters.leaves(key))
        try:
            return Reply(self._parameters.get(key), f"Parameter [{key}]")
        except ParameterMissing:
            return Reply(0, f"Parameter [{key}] is not set", -1)

    def _has(self, request: Request) -> Reply:
        key = request.text(1)
        require_tree(request.caller, Right.PARAM_GET, key, self._parameters.leaves(key))
        return Reply(self._parameters.has(key), key)

    def _set(self, request: Request) -> Reply:
        key, value = request.text(1), request.arguments[2]
        reach = {*self._parameters.reach(key), *params.leaves_of(key, value)}
        require_tree(request.caller, Right.PARAM_SET, key, reach)
        try:
            self._parameters.set(key, value, self._limit)
        except (TypeError, ValueError) as error:
            return Reply(0, f"Error: invalid arguments: {error}", -1)
        kept = ParameterKept(Change(key, value))
        events = self._updates(key, value, request, setter=request.caller.name)
        return Reply(0, f"parameter {key} set", events=(kept, *events))

    def _delete(self, request: Request) -> Reply:
        key = request.text(1)
        require_tree(request.caller, Right.PARAM_SET, key, self._parameters.leaves(key))
        try:
            self._parameters.delete(key)
        except ParameterMissing:
            return Reply(0, f"parameter [{key}] is not set", -1)
        kept = ParameterKept(Change(key, deleted=True))
        events = self._updates(key, {}, request, setter=None)
        return Reply(0, f"parameter {key} deleted", events=(kept, *events))

    def _search(self, request: Request) -> Reply:
        key = request.text(1)

        def visible(leaf: str) -> bool:
            return request.caller.may(Right.PARAM_GET, leaf)

        try:
            found = self._parameters.search(request.caller.name, key, visible)
        except ValueError as error:
            return Reply(0, f"Internal failure: {error}", 0)
        if found is None:
            return Reply("", f"Cannot find parameter [{key}] in an upwards search", -1)
        return Reply(found, f"Found [{found}]")

    def _names(self, request: Request) -> Reply:
        names = self._parameters.names()
        shown = [name for name in names if request.caller.may(Right.PARAM_GET, name)]
        return Reply(shown, "Parameter names")

    def _subscribe(self, request: Request) -> Reply:
        node, key = request.node(1), request.text(2)
        require_tree(request.caller, Right.PARAM_GET, key, self._parameters.leaves(key))
        subscription = params.subscription_key(key)
        require_room(self._registry, Kind.PARAMETER, subscription, node)
        events = self._registry.register_parameter(subscription, node)
        value = self._parameters.get(key) if self._parameters.has(key) else {}
        return Reply(value, f"Subscribed to parameter [{key}]", events=tuple(events))

    def _unsubscribe(self, request: Request) -> Reply:
        node, key = request.node(1), request.text(2)
        self._registry.unregister(Kind.PARAMETER, params.subscription_key(key), node)
        return Reply(1, f"Unsubscribe to parameter [{key}]")

    def _updates(
        self, key: str, value: object, request: Request, setter: str | None
    ) -> tuple[ParameterChanged, ...]:
        subscriptions = [name for name, _ in self._registry.entries(Kind.PARAMETER)]
        return tuple(
            ParameterChanged(node, update.key, update.value)
            for update in params.updates(subscriptions, key, value)
            for node in self._registry.members(Kind.PARAMETER, update.subscription)
            if (update.to_setter or node.name != setter)
            and self._may_hear(node, update.key, update.value, request.now)
        )

    def _may_hear(self, node: NodeRef, key: str, value: object, now: int) -> bool:
        caller = self._caller_of(node, now)
        if caller is None:
            return False
        leaves = params.leaves_of(key.removesuffix("/") or key, value)
        return all(caller.may(Right.PARAM_GET, leaf) for leaf in leaves)
