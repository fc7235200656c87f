"""Carries out what the console asks: each operation of `messages` by its handler.

Handlers come in parts. Each part is called in a thread of its own, one task after the other: so it
needs no lock, and none waits for a master that does not answer but those who ask for it.
"""

import asyncio
import logging
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Protocol

from ca.encoding import Value
from rossec.authority.console.messages import OPERATIONS, checked
from rossec.authority.keyservice.caller import Caller
from rossec.authority.keyservice.messages import Request
from rossec.errors import KeyServiceRefused

_log = logging.getLogger("rossec.authority.service")

Handler = Callable[..., Value]


class Part(Protocol):
    """Some of the operations."""

    def handlers(self) -> Mapping[str, Handler]:
        """By the operation: called with its arguments. Raises `HintedError` to refuse."""


class ConsoleService:
    """All operations.

    Args:
        parts: which have one handler for each operation of the table between them.
    """

    def __init__(self, *parts: Part) -> None:
        self._threads = [ThreadPoolExecutor(1, thread_name_prefix="console") for _ in parts]
        self._handlers: dict[str, tuple[ThreadPoolExecutor, Handler]] = {}
        for part, thread in zip(parts, self._threads, strict=True):
            for operation, handler in part.handlers().items():
                if operation in self._handlers or operation not in OPERATIONS:
                    raise ValueError(f"{operation} is not an operation, or has two handlers")
                self._handlers[operation] = thread, handler

    @property
    def missing(self) -> frozenset[str]:
        """The operations without a handler."""
        return frozenset(OPERATIONS) - self._handlers.keys()

    async def carry_out(self, request: Request, _: Caller) -> Value:
        """Carry out a request.

        Raises:
            HintedError: refused; the text is for the person at the console.
        """
        if request.operation not in self._handlers:
            raise KeyServiceRefused(
                f"this service does not do {request.operation}", "restart it: rossec ca serve"
            )
        thread, handler = self._handlers[request.operation]
        call = partial(_answer, handler, request.arguments)
        return await asyncio.get_running_loop().run_in_executor(thread, call)

    async def close(self) -> None:
        """End the threads; what runs is finished first."""
        for thread in self._threads:
            await asyncio.to_thread(thread.shutdown, cancel_futures=True)


def _answer(handler: Handler, arguments: tuple[Value, ...]) -> Value:
    return checked(handler(*arguments))
