"""The console's pages over views in memory, and requests as a browser sends them."""

import time
from typing import Any

from starlette.testclient import TestClient

from ca.encoding import Value
from rossec.authority.console.client import ConsoleClient
from rossec.authority.console.messages import checked
from rossec.console.app import create_app
from rossec.console.context import ConsoleContext
from rossec.console.server.control import WebSettings
from rossec.console.sessions import COOKIE, COOKIE_SIZE
from tests.support.consoleservice import FakeHome

ORIGIN = "http://localhost:7411"


class MemoryClient(ConsoleClient):
    """A client that asks the handlers themselves: no socket, no thread."""

    def __init__(self, home: FakeHome) -> None:
        self._handlers = home.handlers()

    async def ask(self, operation: str, *arguments: Value) -> Value:
        return checked(self._handlers[operation](*arguments))


class Browser(TestClient):
    """A browser at the console's address, whose time is `now`; it follows no redirect by itself.

    The clock that cannot be set is at `elapsed`; None: at `now` as well.

    `home` is what the service shows; `context` is the console.
    """

    def __init__(
        self, home: FakeHome | None = None, settings: WebSettings | None = None, **context: Any
    ) -> None:
        self.home = home or FakeHome()
        self.now = int(time.time())
        self.elapsed: float | None = None
        self.context = ConsoleContext(
            MemoryClient(self.home),
            settings or WebSettings("home", (ORIGIN,)),
            clock=lambda: self.now,
            elapsed=lambda: self.now if self.elapsed is None else self.elapsed,
            **context,
        )
        super().__init__(create_app(self.context), ORIGIN, follow_redirects=False)
        self.headers["Origin"] = ORIGIN

    def log_in(self, phone: str = "Anna's phone") -> "Browser":
        """Have a session, without the pages that begin one; an empty name: to look."""
        value = self.context.sessions.begin(b"s" * COOKIE_SIZE, phone, self.context.elapsed())
        self.headers["Cookie"] = f"{COOKIE}={value}"
        return self

    def asked(self, operation: str) -> list[tuple[Value, ...]]:
        """The arguments of every call of an operation of the service."""
        return [arguments for name, arguments in self.home.asked if name == operation]
