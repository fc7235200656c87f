"""Both sides of an enrollment in memory, and a person between them."""

import itertools
from dataclasses import dataclass, field

from ca import qr
from ca.certificates import build_request
from ca.enrollment.authority import AuthorityEnrollment
from ca.enrollment.node import NodeEnrollment
from ca.signer import KeySigner
from tests.support.pki import NOW, Site, new_signer

NAME = "/robot1/camera"
ADDRESS = "127.0.0.1:9"
WINDOW = 300
_numbers = itertools.count(1)


def fresh(size: int = 16) -> bytes:
    """Octets that come only once."""
    return next(_numbers).to_bytes(size)


@dataclass
class Robot:
    """A node's key and request, and one enrollment after the other."""

    name: str = NAME
    signer: KeySigner = field(default_factory=new_signer)

    def __post_init__(self) -> None:
        self.csr = build_request(self.signer, "home", self.name)

    def enrollment(
        self, *, label: bool = False, now: int = NOW, contribution: bytes | None = None
    ) -> NodeEnrollment:
        return NodeEnrollment(
            self.signer, self.csr, "home",
            secret=b"" if label else fresh(),
            contribution=contribution or fresh(),
            expires=now + WINDOW,
        )  # fmt: skip


def scanned(node: NodeEnrollment) -> AuthorityEnrollment:
    """An authority that read the node's code from its screen."""
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


def acknowledged(
    node: NodeEnrollment, site: Site, now: int = NOW
) -> tuple[AuthorityEnrollment, bytes]:
    """As `offered`, with the node's answer delivered."""
    enrollment, offer = offered(node, site, now)
    for answer in node.receive(offer, now):
        enrollment.receive(answer, now)
    return enrollment, offer
