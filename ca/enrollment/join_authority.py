"""The authority's side of a join, sans-IO: the process that talks to strangers.

It shows that it is `/ca` now, by a signature over both nonces, and hands the request on: it has no
record and not the authority's key, and decides nothing. What it is given as the answer it sends.
A session is one hello, at most one claim, one request, one answer; any other message ends it.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Final

from ca.enrollment import NONCE_SIZE, join_transcript
from ca.enrollment.join_claim import JoinClaim
from ca.enrollment.join_messages import (
    Claim,
    Hello,
    Join,
    JoinAnswer,
    JoinMessage,
    NameAnswer,
    Named,
    Welcome,
    read,
    write,
)
from ca.enrollment.join_request import JoinRequest
from ca.errors import EnrollmentMessageRefused, EnrollmentOver, EnrollmentRefused
from ca.keys.signer import Signer


class AuthorityJoinState(Enum):
    """The state of one session, at the authority."""

    GREETING = "waiting for a node"
    WELCOMED = "waiting for the request"
    NAMING = "a name is being found"
    NAMED = "waiting for the request with that name"
    DECIDING = "the request is being decided"
    ANSWERED = "answered"
    OVER = "ended"


_S = AuthorityJoinState
TABLE: Final[dict[tuple[_S, type[JoinMessage]], tuple[str, tuple[_S, ...]]]] = {
    (_S.GREETING, Hello): ("_welcome", (_S.WELCOMED,)),
    (_S.WELCOMED, Claim): ("_take_claim", (_S.NAMING,)),
    (_S.WELCOMED, Join): ("_accept", (_S.DECIDING, _S.OVER)),
    (_S.NAMED, Join): ("_accept", (_S.DECIDING, _S.OVER)),
}
WITHOUT_MESSAGE: Final = (
    (_S.NAMING, _S.NAMED, "name()"),
    (_S.NAMING, _S.ANSWERED, "name()"),
    (_S.DECIDING, _S.ANSWERED, "answer()"),
)
"""The transitions that no message causes."""


@dataclass(frozen=True)
class LiveIdentity:
    """The identity of `/ca` with which the authority shows that it is there (DER)."""

    signer: Signer
    chain: tuple[bytes, ...]
    root: bytes


class AuthorityJoin:
    """One session with one node; used once."""

    def __init__(self, identity: LiveIdentity, nonce: bytes) -> None:
        """Answer as `identity`; `nonce` are 16 fresh random octets."""
        if len(nonce) != NONCE_SIZE:
            raise EnrollmentRefused(f"a nonce has {NONCE_SIZE} octets")
        self.state = AuthorityJoinState.GREETING
        self.invitation = b""
        self._identity = identity
        self._nonce = nonce
        self._transcript = b""
        self._request: JoinRequest | None = None
        self._claim: JoinClaim | None = None

    @property
    def claim(self) -> JoinClaim:
        """The claim to be named; nothing of it is verified.

        Raises:
            EnrollmentOver: there is none.
        """
        if self._claim is None:
            raise EnrollmentOver("there is no claim")
        return self._claim

    @property
    def request(self) -> JoinRequest:
        """The request to be decided; nothing of it is verified.

        Raises:
            EnrollmentOver: there is none.
        """
        if self._request is None:
            raise EnrollmentOver("there is no request yet")
        return self._request

    def receive(self, data: bytes) -> bytes | None:
        """Process one message of a node; returns what to send, or None: see `claim`, `request`.

        Raises:
            EnrollmentMessageRefused: the connection must be closed.
        """
        try:
            message = read(data)
            entry = TABLE.get((self.state, type(message)))
            if entry is None:
                raise EnrollmentMessageRefused(
                    f"unexpected {type(message).__name__} in state {self.state.value!r}"
                )
            method, followers = entry
            sent: bytes | None = getattr(self, method)(message)
        except EnrollmentRefused:
            self.state = AuthorityJoinState.OVER
            raise
        assert self.state in followers  # noqa: S101 - the table is the truth
        return sent

    def name(self, answer: NameAnswer) -> bytes:
        """The answer to the claim; after a refusal the connection is closed.

        Raises:
            EnrollmentOver: there is no claim, or it was answered.
        """
        if self.state is not AuthorityJoinState.NAMING:
            raise EnrollmentOver(f"not possible in state {self.state.value!r}")
        is_named = isinstance(answer, Named)
        self.state = AuthorityJoinState.NAMED if is_named else AuthorityJoinState.ANSWERED
        return write(answer)

    def answer(self, answer: JoinAnswer) -> bytes:
        """The last message; the connection is closed after it.

        Raises:
            EnrollmentOver: there is no request, or it was answered.
        """
        if self.state is not AuthorityJoinState.DECIDING:
            raise EnrollmentOver(f"not possible in state {self.state.value!r}")
        self.state = AuthorityJoinState.ANSWERED
        return write(answer)

    def _welcome(self, message: Hello) -> bytes:
        own = self._identity
        self.invitation = message.invitation
        self._transcript = join_transcript.transcript(
            message.invitation, message.nonce, self._nonce, own.chain, own.root
        )
        statement = join_transcript.sign_live(own.signer, self._transcript)
        self.state = AuthorityJoinState.WELCOMED
        return write(Welcome(self._nonce, own.chain, own.root, statement))

    def _take_claim(self, message: Claim) -> None:
        self._claim = JoinClaim(self.invitation, self._transcript, message.metadata, message.proof)
        self.state = AuthorityJoinState.NAMING

    def _accept(self, message: Join) -> None:
        self._request = JoinRequest(
            self.invitation, self._transcript, message.name, message.csr, message.proof,
            message.metadata,
        )  # fmt: skip
        self.state = AuthorityJoinState.DECIDING
