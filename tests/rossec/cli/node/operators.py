"""The people of an enrollment: one at the authority, one at the terminal of the node."""

import asyncio
import os
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ca.enrollment import qr
from ca.enrollment.sides import AuthorityEnrollment
from ca.errors import HintedError
from rossec.enrollment import enroll
from rossec.enrollment.enroll import code_in
from rossec.host import addresses
from tests.support.commands import Shell
from tests.support.enrolling import clock, fresh
from tests.support.pki import Site

SITE = Site.create(now=clock())


class Operator(threading.Thread):
    """Somebody at the authority, who sees the node's code and calls it; `then` gets the digits."""

    def __init__(self, shell: Shell, then: Callable[["Operator", str], object], *, site: Site = SITE) -> None:
        super().__init__()
        self.png = shell.root / "code.png"
        self.node = shell.node("/robot")
        self.port = 0
        self.site = site
        self.core: AuthorityEnrollment | None = None
        self.error: Exception | None = None
        self._then = then

    @property
    def words(self) -> tuple[str, ...]:
        return ("node", "enroll", "/robot", "--address", "127.0.0.1", "--png", str(self.png))

    def show(self, digits: str) -> None:
        self._then(self, digits)

    def confirm(self, digits: str) -> None:
        enroll.ask(self.node, {"do": "confirm", "digits": digits})

    def run(self) -> None:
        until = time.monotonic() + 30
        while not self.png.exists():
            assert time.monotonic() < until
            time.sleep(0.01)
        code = qr.parse(code_in(self.png.read_bytes()))
        host, port = addresses.split(code.address) if code.address else ("127.0.0.1", self.port)
        self.core = AuthorityEnrollment(code, "home")
        try:
            asyncio.run(self.enroll(self.core, host, port))
        except (HintedError, OSError) as error:
            self.error = error

    async def enroll(self, core: AuthorityEnrollment, host: str, port: int) -> None:
        await enroll.fetch(core, host, port, clock)
        core.approve(clock())
        leaf = self.site.authority.issue(
            core.csr, now=clock(), serial=secrets.randbits(120), wildcard=core.request.wildcard
        )
        offer = core.offer([leaf], self.site.root, fresh(), clock())
        await enroll.deliver(core, offer, host, port, clock, self.show)


def after(action: Callable[[], object], until: Callable[[], bool]) -> threading.Thread:
    """Do something as soon as something else has happened."""

    def work() -> None:
        limit = time.monotonic() + 30
        while not until():
            assert time.monotonic() < limit
            time.sleep(0.01)
        action()

    thread = threading.Thread(target=work)
    thread.start()
    return thread


@contextmanager
def typist(keyboard: int, answer: str) -> Iterator[Callable[..., None]]:
    """Gives what makes a person answer, again and again: what comes before a question is lost."""
    asked, ended = threading.Event(), threading.Event()

    def types() -> None:
        asked.wait()
        while not ended.wait(0.05):
            os.write(keyboard, answer.encode())

    person = threading.Thread(target=types)
    person.start()
    try:
        yield lambda *_: asked.set()
    finally:
        ended.set()
        asked.set()
        person.join()
