"""Carries out what the console asks: each operation of `messages` by its handler.

Handlers come in parts. Each part is called in a thread of its own, one task after the other: so it
needs no lock, and none waits for a master that does not answer but those who ask for it.
"""

import asyncio
import logging
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Final, Protocol

from ca.encoding import Value
from rossec.authority.console.messages import OPERATIONS, checked
from rossec.authority.keyservice.caller import Caller
from rossec.authority.keyservice.messages import Request
from rossec.errors import KeyServiceRefused
from rossec.ros.text import printable

_log = logging.getLogger("rossec.authority.service")

Handler = Callable[..., Value]
CHANGES: Final = frozenset(
    {
        "deny-request", "deny-question", "revoke-grant", "revoke-node", "end-invitation",
        "remove-phone", "end-proposal", "approve",
    }
)  # fmt: skip


def _unaudited(_: str) -> None:
    """Nothing is written: for parts that change nothing."""


class Part(Protocol):
    """Some of the operations."""

    def handlers(self) -> Mapping[str, Handler]:
        """By the operation: called with its arguments. Raises `HintedError` to refuse."""


class ConsoleService:
    """All operations.

    Args:
        parts: which have one handler for each operation of the table between them.
        audit: writes a line. Raises `HintedError` if it cannot: then nothing is done.
    """

    def __init__(self, *parts: Part, audit: Callable[[str], None] = _unaudited) -> None:
        self._audit = audit
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

    async def carry_out(self, request: Request, caller: Caller) -> Value:
        """Carry out a request.

        Raises:
            HintedError: refused; the text is for the person at the console.
        """
        if request.operation not in self._handlers:
            raise KeyServiceRefused(
                f"this service does not do {request.operation}", "restart it: rossec ca serve"
            )
        if request.operation in CHANGES:
            self._audit(f"{_described(request)}, asked by the console of {caller}")
        thread, handler = self._handlers[request.operation]
        call = partial(_answer, handler, request.arguments)
        return await asyncio.get_running_loop().run_in_executor(thread, call)

    async def close(self) -> None:
        """End the threads; what runs is finished first."""
        for thread in self._threads:
            await asyncio.to_thread(thread.shutdown, cancel_futures=True)


def _described(request: Request) -> str:
    """The operation and what it is about; the rest of it is in the record."""
    about = request.arguments[0]
    shown = about.hex() if isinstance(about, bytes) else printable(str(about))
    return f"{request.operation} {shown}"


def _answer(handler: Handler, arguments: tuple[Value, ...]) -> Value:
    return checked(handler(*arguments))
