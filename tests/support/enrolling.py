"""Both sides of an enrollment in memory, and a person between them."""

import asyncio
import itertools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Self

from ca.enrollment import qr
from ca.enrollment.sides import AuthorityEnrollment, NodeEnrollment, NodeState, Pending
from ca.errors import CAError, EnrollmentOver
from ca.keys.signing import KeySigner
from ca.svid import build_request
from rossec.enrollment.enroll import WaitingNode
from rossec.host.addresses import join
from tests.support.pki import NOW, Site, new_signer

NAME = "/robot1/camera"
ADDRESS = "127.0.0.1:9"
WINDOW = 300
_numbers = itertools.count(1)


def fresh(size: int = 16) -> bytes:
    """Bytes that are not repeated."""
    return next(_numbers).to_bytes(size)


@dataclass
class Robot:
    """A node's key and request, and successive enrollments."""

    name: str = NAME
    signer: KeySigner = field(default_factory=new_signer)
    wildcard: bool = False

    def __post_init__(self) -> None:
        self.csr = build_request(self.signer, "home", self.name, wildcard=self.wildcard)

    def enrollment(
        self, *, label: bool = False, now: int = NOW, contribution: bytes | None = None
    ) -> NodeEnrollment:
        return NodeEnrollment(
            self.signer,
            self.csr,
            "home",
            secret=b"" if label else fresh(),
            contribution=contribution or fresh(),
            expires=now + WINDOW,
            wildcard=self.wildcard,
        )


def scanned(node: NodeEnrollment) -> AuthorityEnrollment:
    """An authority that has read the node's code."""
    return AuthorityEnrollment(qr.parse(node.code(ADDRESS)), "home")


def compared(node: NodeEnrollment, now: int = NOW) -> AuthorityEnrollment:
    """As `scanned`, with the request fetched."""
    enrollment = scanned(node)
    for answer in node.receive(enrollment.fetch(), now):
        enrollment.receive(answer, now)
    return enrollment


def offered(
    node: NodeEnrollment, site: Site, now: int = NOW, nonce: bytes | None = None
) -> tuple[AuthorityEnrollment, bytes]:
    """As `compared`, approved, with the offer that was made."""
    enrollment = compared(node, now)
    enrollment.approve(now)
    certificate = site.authority.issue(enrollment.csr, now=now, serial=next(_numbers))
    return enrollment, enrollment.offer([certificate], site.root, nonce or fresh(), now)


def acknowledged(node: NodeEnrollment, site: Site, now: int = NOW) -> tuple[AuthorityEnrollment, bytes]:
    """As `offered`, with the node's answer delivered."""
    enrollment, offer = offered(node, site, now)
    for answer in node.receive(offer, now):
        enrollment.receive(answer, now)
    return enrollment, offer


class WaitingRobot:
    """A robot in a thread of its own that waits to be enrolled, and a person who confirms.

    `person` receives the pending offer and returns the digits to confirm, or None to cancel.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        label: bool = False,
        host: str = "127.0.0.1",
        person: Callable[[Pending], str | None] = lambda pending: pending.digits,
    ) -> None:
        self.core = robot.enrollment(label=label, now=clock())
        self.complaints: list[str] = []
        self.trusted: list[Pending] = []
        self.error: Exception | None = None
        self._host, self._person = host, person
        self._listening, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))

    def __enter__(self) -> Self:
        self._thread.start()
        assert self._listening.wait(20)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    @property
    def where(self) -> str:
        return join(self._host, self.port)

    @property
    def code(self) -> str:
        return self.core.code(self.where)

    async def _run(self) -> None:
        async with WaitingNode(self.core, clock, self.complaints.append) as node:
            await node.listen(self._host, 0)
            self.port = node.port
            self._listening.set()
            try:
                await self._wait(node, NodeState.PENDING)
                digits = self._person(self.core.pending)
                if digits is not None:
                    node.confirm(digits, self.trusted.append)
                await self._wait(node, NodeState.ENROLLED)
            except CAError as error:
                self.error = error
            node.stop(EnrollmentOver("the test is over"))

    async def _wait(self, node: WaitingNode, state: NodeState) -> None:
        while self.core.state is not state:
            if self._stop.is_set() or self.core.end_reason is not None:
                raise self.core.end_reason or EnrollmentOver("the test is over")
            await asyncio.sleep(0.01)


def clock() -> int:
    return int(time.time())
