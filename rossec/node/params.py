"""Parameters: the master's tree, read and written over the node's session, and its changes.

Values are those of XML-RPC: bool, int, float, str, bytes, lists, mappings with str keys. A subscription holds
the newest value; a slow iteration misses values in between. The master notifies subscribers of an unset
parameter with an empty mapping, as ROS does.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from copy import deepcopy
from typing import Any, Final

from ca.errors import HintedError
from ca.names import shown
from rossec.errors import AnswerMalformed, AnswerRefused, ParameterUnset
from rossec.node.context import NodeContext
from rossec.participant.handshakes import refuse_offer
from rossec.ros.names import SEPARATOR
from rossec.ros.xmlrpc import Fault

_REQUIRED: Final = object()
_NOT_FOUND: Final = "Cannot find parameter"  # the master's answer to a search, as stock
_REFUSAL: Final = "rossec: "  # begins a refusal of the master; other errors mean absent

Value = Any  # any XML-RPC value


class NodeParameters:
    """The parameters this node may read and write: `node.params`; `resolve` makes a name absolute."""

    def __init__(self, context: NodeContext, resolve: Callable[[str], str]) -> None:
        self._context = context
        self._resolve = resolve
        self._subscriptions: dict[str, list[ParameterSubscription]] = {}

    async def get(self, name: str, default: Value = _REQUIRED) -> Value:
        """The value of `name`, of a namespace as a mapping; `default`, if given, when it is unset. Raises
        ParameterUnset: it has no value, and there is no default; RossecError: the master refuses, or is out
        of reach."""
        key = self._key(name)
        try:
            return await self._ask("getParam", key)
        except AnswerRefused as error:
            if str(error).startswith(_REFUSAL):
                raise
            if default is not _REQUIRED:
                return default
            raise _unset(key) from error

    async def set(self, name: str, value: Value) -> None:
        """Give `name` a value; a mapping replaces a whole namespace. Raises RossecError: XML-RPC cannot carry
        the value, a name below /remote, or the master refuses."""
        key = refuse_offer(self._key(name), "set")
        await self._ask("setParam", key, value)
        self.changed(key, value)  # the master does not notify the caller

    async def has(self, name: str) -> bool:
        return bool(await self._ask("hasParam", self._key(name)))

    async def delete(self, name: str) -> None:
        """Unset `name` and everything below it; raises as `get`, and for a name below /remote."""
        key = refuse_offer(self._key(name), "deleted")
        try:
            await self._ask("deleteParam", key)
        except AnswerRefused as error:
            if str(error).startswith(_REFUSAL):
                raise
            raise _unset(key) from error

    async def search(self, name: str) -> str | None:
        """The nearest `name` in this node's namespace and those above; None when there is none. Raises
        RossecError: the name is empty, or the master is out of reach."""
        try:
            return str(await self._ask("searchParam", name))
        except AnswerRefused as error:
            if not str(error).startswith(_NOT_FOUND):
                raise
            return None

    async def names(self) -> list[str]:
        found = await self._ask("getParamNames")
        if not isinstance(found, list) or not all(isinstance(name, str) for name in found):
            raise AnswerMalformed("parameter names that are not a list of str")
        return found

    async def subscribe(self, name: str) -> "ParameterSubscription":
        """Subscribe to `name`: `async for value in subscription` begins with the current value. Raises
        RossecError: the master refuses, or is out of reach."""
        subscription = ParameterSubscription(self._key(name), self._unsubscribe)
        self._subscriptions.setdefault(subscription.name, []).append(subscription)
        try:
            await self._register(subscription.name)
        except BaseException:
            self._drop(subscription)
            raise
        return subscription

    def changed(self, key: str, value: Value) -> None:
        key = key.removesuffix(SEPARATOR) or SEPARATOR
        for name, subscriptions in self._subscriptions.items():
            for subscription in subscriptions:
                if key == name or _is_below(key, name):
                    subscription.take(_replaced(subscription.value, _path(key, name), value))
                elif _is_below(name, key):
                    subscription.take(_found(value, _path(name, key)))

    async def restore(self) -> None:
        """Subscribe to everything again: the master was restarted, or there is a new grant."""
        for name in tuple(self._subscriptions):
            with self._context.restoring(name):
                await self._register(name)

    def close(self) -> None:
        for subscriptions in self._subscriptions.values():
            for subscription in subscriptions:
                subscription.end()

    async def _register(self, key: str) -> None:
        before = [item.updates for item in self._subscriptions[key]]
        value = await self._ask("subscribeParam", self._context.uri, key)
        for subscription, updates in zip(self._subscriptions.get(key, []), before, strict=False):
            if subscription.updates == updates:  # an update may have arrived first
                subscription.take(value)

    async def _unsubscribe(self, subscription: "ParameterSubscription") -> None:
        self._drop(subscription)
        if subscription.name not in self._subscriptions:
            with contextlib.suppress(HintedError, OSError, TimeoutError):
                await self._ask("unsubscribeParam", self._context.uri, subscription.name)

    def _drop(self, subscription: "ParameterSubscription") -> None:
        others = self._subscriptions.get(subscription.name, [])
        if subscription in others:
            others.remove(subscription)
        if not others:
            self._subscriptions.pop(subscription.name, None)

    async def _ask(self, method: str, *params: object) -> object:
        # Call the master; a fault because it cannot parse the call counts as a refusal.
        try:
            return await self._context.call(method, *params)
        except Fault as fault:
            raise AnswerRefused(
                f"the master cannot parse this {method}: {fault.faultString}",
                "XML carries no control characters; send such text as bytes",
                code=fault.faultCode,
            ) from fault

    def _key(self, name: str) -> str:
        return name if name == SEPARATOR else self._resolve(name)


class ParameterSubscription:
    """A subscription to one parameter. Made by `NodeParameters.subscribe`."""

    def __init__(self, name: str, on_close: Callable[["ParameterSubscription"], Awaitable[None]]) -> None:
        self.name = name
        self.value: Value = {}  # the newest; do not change it in place
        self.updates = 0
        self._on_close = on_close
        self._updated = asyncio.Event()
        self._ended = False

    def take(self, value: Value) -> None:
        # Take a value; the same one again is not yielded.
        fresh = self.updates == 0 or value != self.value
        self.updates += 1
        if fresh:
            self.value = value
            self._updated.set()

    async def __aiter__(self) -> AsyncIterator[Value]:
        # The current value, then the newest one whenever it has changed.
        while True:
            await self._updated.wait()
            if self._ended:
                return
            self._updated.clear()
            yield self.value

    async def close(self) -> None:
        if not self._ended:
            self.end()
            await self._on_close(self)

    def end(self) -> None:
        self._ended = True
        self._updated.set()


def _unset(key: str) -> ParameterUnset:
    return ParameterUnset(
        f"the parameter {shown(key)} is not set", "see those that are: rossec param list --as NODE"
    )


def _is_below(name: str, above: str) -> bool:
    return name.startswith(above.removesuffix(SEPARATOR) + SEPARATOR) and name != above


def _path(name: str, above: str) -> list[str]:
    return [part for part in name.removeprefix(above).split(SEPARATOR) if part]


def _found(tree: Value, path: list[str]) -> Value:
    for part in path:
        tree = tree.get(part, {}) if isinstance(tree, dict) else {}
    return tree


def _replaced(tree: Value, path: list[str], value: Value) -> Value:
    if not path:
        return deepcopy(value)
    new = dict(tree) if isinstance(tree, dict) else {}
    head, *rest = path
    below = _replaced(new.get(head), rest, value)
    # The master tells an unset parameter as an empty mapping: it goes out of the tree.
    if below == {}:
        new.pop(head, None)
    else:
        new[head] = below
    return new
