"""What every page gets: the service, this console's settings, and what it remembers.

Nothing here is written to a disk: a console that is started again knows nobody, and asks again.
"""

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Final, Protocol

from ca.errors import HintedError
from rossec import clock
from rossec.authority.console.client import ConsoleClient
from rossec.authority.console.messages import Status
from rossec.clock import Seconds, counter
from rossec.console.approvals import ProposedAct
from rossec.console.enrollments import Enrollments
from rossec.console.matrix import Endings
from rossec.console.samples import Preview
from rossec.console.server import WebSettings
from rossec.console.sessions import FailureLimit, KnownPhones, LoginTurns, Sessions, SessionTable
from rossec.errors import HttpRefused
from rossec.host.runner import TaskSet

PERIOD: Final = 1.0  # seconds between two questions
BEAT: Final = 5.0  # seconds after which a stream without news shows that it lives
MAX_STREAMS: Final = 100
MAX_CODES: Final = 64
MAX_PENDING: Final = 256
_COMMENT: Final = b":\n\n"  # ignored by browsers; a connection that is gone shows at the write
ALIVE: Final = b"event: alive\ndata: 1\n\n"
SILENT: Final = b"event: silent\ndata: 1\n\n"  # the service does not answer this console
_log = logging.getLogger("rossec.console")


class NewsFeed:
    """The newest `Status.number`, and the streams that wait for it: one question a second for all pages."""

    # A stream has numbers only, so it tells nothing that the page itself would not: the service's number, and
    # how often something changed in this console. Between them it says every few seconds whether the service
    # answers (`alive`, `silent`), so that a page knows when it is old. The service is asked only while a page
    # waits.

    def __init__(self, status: Callable[[], Awaitable[Status]], period: float = PERIOD) -> None:
        self._status, self._period = status, period
        self._news = asyncio.Condition()
        self._tasks = TaskSet()
        self.streams = 0
        self._number: int | None = None
        self._own = self._told_own = 0
        self._answered = float("-inf")  # when the service did last, by the loop's clock

    @property
    def number(self) -> str | None:
        # As of the last question; None: nobody waits, so nobody asked.
        return None if self._number is None else f"{self._number}.{self._own}"

    async def ask(self) -> str:
        # What changes while the page is made is news to it then.
        try:
            return f"{(await self._status()).number}.{self._own}"
        except HintedError:
            return ""

    def changed(self) -> None:
        # Note that something changed in this console; the streams say so within a second.
        self._own += 1

    def open(self, is_valid: Callable[[], bool], beat: float = BEAT) -> AsyncIterator[bytes]:
        if self.streams >= MAX_STREAMS:
            raise HttpRefused("too many pages are open", "close some of them", status=503)
        return self._events(is_valid, beat)

    async def close(self) -> None:
        await self._tasks.close()

    async def _events(self, is_valid: Callable[[], bool], beat: float) -> AsyncIterator[bytes]:
        self.streams += 1
        try:
            told: str | None = None
            yield _COMMENT
            while is_valid():
                if not len(self._tasks):
                    self._tasks.spawn(self._poll(), "news")
                if self.number is not None and self.number != told:
                    told = self.number
                    yield f"data: {told}\n\n".encode()
                elif not await self._wait(told, beat):
                    silent_for = asyncio.get_running_loop().time() - self._answered
                    yield ALIVE if silent_for < BEAT + 2 * self._period else SILENT
        finally:
            self.streams -= 1

    async def _wait(self, told: str | None, beat: float) -> bool:
        try:
            async with asyncio.timeout(beat), self._news:
                await self._news.wait_for(lambda: self.number not in {None, told})
        except TimeoutError:
            return False
        return True

    async def _poll(self) -> None:
        while self.streams:
            before = self.number
            try:
                self._number = (await self._status()).number
                self._answered = asyncio.get_running_loop().time()
            except HintedError as error:  # the page that is loaded next says so
                _log.info("no news: %s", error)
            if self.number != before or self._own != self._told_own:
                self._told_own = self._own
                async with self._news:
                    self._news.notify_all()
            await asyncio.sleep(self._period)
        self._number = None


class Scanner(Protocol):
    async def read(self, frame: bytes) -> str | None: ...


class ConsoleContext:
    def __init__(
        self,
        service: ConsoleClient,
        settings: WebSettings,
        scanner: Scanner | None = None,
        preview: Preview | None = None,
        clock: Callable[[], int] = clock.now,
        elapsed: Seconds | None = None,
    ) -> None:
        self.service, self.settings = service, settings
        self.scanner = scanner  # reads codes; None: this console has none
        self.preview = preview  # gives real messages; None: pictures show made-up ones, and say so
        # What ends after some time ends by a clock that cannot be set (docs/threat-model.md, clock-ahead).
        self.clock, self.elapsed = clock, elapsed or counter()
        self.sessions = Sessions(settings.lifetime, settings.idle)
        self.phones = KnownPhones(service.phones)
        self.news = NewsFeed(service.status)
        self.failures = FailureLimit()
        # Acts that are shown to a phone, not approved yet; approvals of join codes, not shown yet. Both are
        # bounded, in shares by who fills them (looker-floods).
        self.pending: SessionTable[ProposedAct] = SessionTable(MAX_PENDING)
        self.made_codes: SessionTable[bool] = SessionTable(MAX_CODES)
        self.turns = LoginTurns()
        self.endings = Endings()
        self.enrollments = Enrollments(service, settings.domain, clock, self.news.changed)
