"""The authority's side of an enrollment, sans-IO.

The code comes from the node itself, read by a person or a camera; everything else comes over the
network and is checked against it. The node is enrolled when it says so in a statement signed over
this transcript; the authority does not report it as enrolled before.
"""

from collections.abc import Callable, Sequence
from enum import Enum
from typing import Final

from ca.certificates import TrustAnchor
from ca.enrollment import NONCE_SIZE, WINDOW, transcript
from ca.enrollment.messages import (
    Abort,
    Acknowledgement,
    Delivery,
    Done,
    Fetch,
    Message,
    Offer,
    Reason,
    read,
    write,
)
from ca.enrollment.qr import Code
from ca.errors import (
    AcknowledgementRefused,
    ConflictingOffer,
    EnrollmentExpired,
    EnrollmentMessageRefused,
    EnrollmentOver,
    EnrollmentRefused,
    RequestSwapped,
)
from ca.requests import IdentityRequest, check_request

_ABORTS: Final[dict[Reason, tuple[type[EnrollmentRefused], str, str]]] = {
    Reason.REFUSED: (
        EnrollmentOver, "the node refused the offer",
        "does it show a new code, or is its clock wrong? `rossec node enroll` says why",
    ),
    Reason.OVER: (
        EnrollmentOver, "the node has ended the enrollment", "show a new code on the node",
    ),
    Reason.CONFLICT: (
        ConflictingOffer, "the node received two different offers: another party has its code",
        "the node accepted none; find the other party, then show a new code",
    ),
}  # fmt: skip


class AuthorityState(Enum):
    """The state of one enrollment, at the authority."""

    FETCHING = "fetching the request"
    COMPARED = "request verified"
    APPROVED = "approved"
    OFFERED = "waiting for the acknowledgement"
    ACKNOWLEDGED = "waiting for confirmation at the node"
    ENROLLED = "enrolled"
    OVER = "ended"


TABLE: Final[dict[tuple[AuthorityState, type[Message]], tuple[str, tuple[AuthorityState, ...]]]] = {
    (AuthorityState.FETCHING, Delivery): (
        "_compare",
        (AuthorityState.COMPARED, AuthorityState.OVER),
    ),
    (AuthorityState.FETCHING, Abort): ("_aborted", (AuthorityState.OVER,)),
    (AuthorityState.OFFERED, Acknowledgement): (
        "_acknowledged",
        (AuthorityState.ACKNOWLEDGED, AuthorityState.OVER),
    ),
    (AuthorityState.OFFERED, Abort): ("_aborted", (AuthorityState.OVER,)),
    (AuthorityState.ACKNOWLEDGED, Acknowledgement): (
        "_acknowledged_again",
        (AuthorityState.ACKNOWLEDGED,),
    ),
    (AuthorityState.ACKNOWLEDGED, Done): (
        "_done",
        (AuthorityState.ENROLLED, AuthorityState.OVER),
    ),
    (AuthorityState.ACKNOWLEDGED, Abort): ("_aborted", (AuthorityState.OVER,)),
    (AuthorityState.ENROLLED, Acknowledgement): ("_acknowledged_again", (AuthorityState.ENROLLED,)),
    (AuthorityState.ENROLLED, Done): ("_done", (AuthorityState.ENROLLED,)),
}


class AuthorityEnrollment:
    """One enrollment of the node whose code was read; used once."""

    def __init__(self, code: Code, domain: str, *, wildcard: bool = False) -> None:
        """Enroll the node with this `code`; `wildcard`: it may ask for a wildcard tail."""
        self.state = AuthorityState.FETCHING
        self.digits = ""
        self._code = code
        self._domain = domain
        self._wildcard = wildcard
        self._request: IdentityRequest | None = None
        self._csr = b""
        self._transcript = b""
        self._statement = b""
        self._deadline = code.expires if code.secret else 0

    def fetch(self) -> bytes:
        """The first message."""
        return write(Fetch())

    @property
    def request(self) -> IdentityRequest:
        """The request: checked against the code, with proof of possession.

        Raises:
            EnrollmentOver: there is no request yet.
        """
        if self._request is None:
            raise EnrollmentOver("there is no request yet")
        return self._request

    @property
    def csr(self) -> bytes:
        """The request as received (DER)."""
        return self._csr

    def receive(self, data: bytes, now: int) -> None:
        """Process one message of the node.

        Raises:
            EnrollmentRefused, RequestRefused: a subclass for each error; an unexpected message
                changes nothing, every other error ends the enrollment.
        """
        self.tick(now)
        message = read(data)
        entry = TABLE.get((self.state, type(message)))
        if entry is None:
            raise EnrollmentMessageRefused(
                f"unexpected {type(message).__name__} in state {self.state.value!r}"
            )
        method, followers = entry
        action: Callable[[Message, int], None] = getattr(self, method)
        before = self.state
        action(message, now)
        assert self.state in {before, *followers}  # noqa: S101 - the table is the truth

    def approve(self, now: int) -> None:
        """The operator, or an automatic rule, has approved `request`."""
        self.tick(now)
        self._move(AuthorityState.COMPARED, AuthorityState.APPROVED)

    def deny(self) -> None:
        """The operator has denied the request."""
        self._move(AuthorityState.COMPARED, AuthorityState.OVER)

    def offer(self, chain: Sequence[bytes], root: bytes, nonce: bytes, now: int) -> bytes:
        """Return the offer to send, and to send again unchanged when the connection breaks.

        `chain` is the certificate issued for `csr`, and an intermediate if there is one; `nonce`
        are 16 fresh random octets.

        Raises:
            CertificateRefused: the chain is invalid.
            EnrollmentRefused: not approved, too late, or the chain is for another request.
        """
        self.tick(now)
        identity = TrustAnchor.load(root).verify(chain, now)
        request = self.request
        ours = (request.domain, request.name, request.wildcard, request.thumbprint)
        offered = (identity.domain, identity.name, identity.wildcard, identity.thumbprint)
        if offered != ours:
            raise EnrollmentRefused("the certificate is not the one that was asked for")
        if len(nonce) != NONCE_SIZE:
            raise EnrollmentRefused(f"a nonce has {NONCE_SIZE} octets")
        self._move(AuthorityState.APPROVED, AuthorityState.OFFERED)
        self._deadline = now + WINDOW
        self._transcript = transcript.transcript(self._csr, chain, root, nonce)
        secret = self._code.secret
        proof = transcript.tag(secret, self._transcript) if secret else b""
        return write(Offer(tuple(chain), root, nonce, proof))

    @property
    def deadline(self) -> int:
        """The last second for the next step; 0 for none."""
        return self._deadline

    def tick(self, now: int) -> None:
        """Check the deadline at `now`.

        Raises:
            EnrollmentExpired: it is over.
        """
        if self.state in {AuthorityState.ENROLLED, AuthorityState.OVER}:
            return
        if self._deadline and now > self._deadline:
            self.state = AuthorityState.OVER
            raise EnrollmentExpired(
                "the enrollment was not finished in time", "show a new code on the node"
            )

    def _move(self, begin: AuthorityState, end: AuthorityState) -> None:
        if self.state is not begin:
            raise EnrollmentOver(f"not possible in state {self.state.value!r}")
        self.state = end

    def _compare(self, message: Delivery, _: int) -> None:
        """Check the hash first: a request that does not match the code is not parsed."""
        self.state = AuthorityState.OVER
        if not self._code.matches(message.csr):
            raise RequestSwapped(
                "the request is not the one the code was made for",
                "it was replaced on the network, or this is another node: scan the code again",
            )
        self._request = check_request(message.csr, self._domain, wildcard=self._wildcard)
        self._csr = message.csr
        self.state = AuthorityState.COMPARED

    def _acknowledged(self, message: Acknowledgement, now: int) -> None:
        self.state = AuthorityState.OVER
        contribution = transcript.open_acknowledgement(
            message.statement, self.request.public_key, self._transcript
        )
        self.digits = transcript.digits(self._transcript, contribution)
        self._statement = message.statement
        self._deadline = now + WINDOW
        self.state = AuthorityState.ACKNOWLEDGED

    def _acknowledged_again(self, message: Acknowledgement, _: int) -> None:
        if message.statement != self._statement:
            raise AcknowledgementRefused("a second, different answer of the node", "start again")

    def _done(self, message: Done, _: int) -> None:
        if self.state is AuthorityState.ACKNOWLEDGED:  # in ENROLLED, an invalid one changes nothing
            self.state = AuthorityState.OVER
        transcript.check_done(message.statement, self.request.public_key, self._transcript)
        self.state = AuthorityState.ENROLLED

    def _aborted(self, message: Abort, _: int) -> None:
        self.state = AuthorityState.OVER
        error, text, hint = _ABORTS[message.reason]
        raise error(text, hint)
