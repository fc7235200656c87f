"""The node's side of a join, sans-IO: from the code of an invitation to an identity.

The node says nothing of itself before the peer has shown that it is the authority *now*: a leaf for
`/ca` under the root that the code names, whose key signed a transcript with this node's fresh
nonce. Every node has a chain to that root; none but `/ca` is taken. Then it proves the secret and
sends its request, once a session; the answer is taken only if it is its own identity. `TABLE` has
all transitions; any other message ends the session.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from hashlib import sha256
from hmac import compare_digest
from typing import Final

from ca.certificates import Identity, TrustAnchor
from ca.enrollment import NONCE_SIZE, join_refusals, join_transcript
from ca.enrollment.invitation import InvitationCode
from ca.enrollment.issued import check_issued
from ca.enrollment.join_messages import (
    Claim,
    Hello,
    Issued,
    Join,
    JoinMessage,
    Named,
    Refused,
    RefuseReason,
    Waiting,
    Welcome,
    read,
    write,
)
from ca.enrollment.join_transcript import MAX_METADATA
from ca.errors import (
    CAError,
    CertificateExpired,
    CertificateNotYetValid,
    EnrollmentMessageRefused,
    EnrollmentOver,
    EnrollmentRefused,
    JoinBusy,
    JoinRefused,
    JoinWaiting,
    NotTheAuthority,
    RequestRefused,
)
from ca.names import AUTHORITY, check_name, is_reserved
from ca.patterns import covers
from ca.requests import IdentityRequest, check_request

_CLOCK: Final = "check this computer's clock; if it is right, at the authority: rossec ca renew /ca"


class NodeJoinState(Enum):
    """The state of one session, at the node."""

    GREETING = "waiting for the authority"
    WELCOMED = "the authority is verified"
    CLAIMED = "waiting for a name"
    NAMED = "has a name"
    PROVED = "waiting for the answer"
    JOINED = "joined"
    WAITING = "not answered yet"
    OVER = "ended"


_S = NodeJoinState
TABLE: Final[dict[tuple[_S, type[JoinMessage]], tuple[str, tuple[_S, ...]]]] = {
    (_S.GREETING, Welcome): ("_verify", (_S.WELCOMED, _S.OVER)),
    (_S.GREETING, Refused): ("_refused", (_S.OVER,)),
    (_S.CLAIMED, Named): ("_named", (_S.NAMED, _S.OVER)),
    (_S.CLAIMED, Refused): ("_refused", (_S.OVER,)),
    (_S.PROVED, Issued): ("_issued", (_S.JOINED, _S.OVER)),
    (_S.PROVED, Waiting): ("_waiting", (_S.WAITING,)),
    (_S.PROVED, Refused): ("_refused", (_S.OVER,)),
}
WITHOUT_MESSAGE: Final = (
    (_S.WELCOMED, _S.CLAIMED, "claim()"),
    (_S.WELCOMED, _S.PROVED, "join()"),
    (_S.NAMED, _S.PROVED, "join()"),
)
"""The transitions that no message causes."""


@dataclass(frozen=True)
class JoinedIdentity:
    """The identity of a node that joined (DER); `anchor` is the root as it will be trusted."""

    chain: tuple[bytes, ...]
    root: bytes
    anchor: TrustAnchor


class NodeJoin:
    """One session of one node with the authority of an invitation; used once."""

    def __init__(self, code: InvitationCode, nonce: bytes) -> None:
        """Join by `code`; `nonce` are 16 fresh random octets."""
        if len(nonce) != NONCE_SIZE:
            raise EnrollmentRefused(f"a nonce has {NONCE_SIZE} octets")
        self.state = NodeJoinState.GREETING
        self._code = code
        self._nonce = nonce
        self._transcript = b""
        self._anchor: TrustAnchor | None = None
        self._request: IdentityRequest | None = None
        self._identity: JoinedIdentity | None = None
        self._metadata = b""
        self._name = ""

    def hello(self) -> bytes:
        """The first message."""
        return write(Hello(self._code.id, self._nonce))

    @property
    def anchor(self) -> TrustAnchor:
        """The authority's root, once the peer is verified; not trusted before the identity is.

        Raises:
            EnrollmentOver: it is not.
        """
        if self._anchor is None:
            raise EnrollmentOver("the authority is not verified yet")
        return self._anchor

    @property
    def name(self) -> str:
        """The name that the authority's rules gave, within the invitation.

        Raises:
            EnrollmentOver: there is none.
        """
        if not self._name:
            raise EnrollmentOver("the authority has given no name")
        return self._name

    @property
    def identity(self) -> JoinedIdentity:
        """What to write to the disk, in the state JOINED.

        Raises:
            EnrollmentOver: there is none.
        """
        if self._identity is None:
            raise EnrollmentOver("the node has not joined")
        return self._identity

    def receive(self, data: bytes, now: int) -> None:
        """Process one message of the authority; a refusal ends the session.

        Raises:
            JoinWaiting: not yet; the same request may be sent again, in a new session.
            EnrollmentRefused: a subclass for each error.
        """
        try:
            message = read(data)
            entry = TABLE.get((self.state, type(message)))
            if entry is None:
                raise EnrollmentMessageRefused(
                    f"unexpected {type(message).__name__} in state {self.state.value!r}"
                )
            method, followers = entry
            action: Callable[[JoinMessage, int], None] = getattr(self, method)
            action(message, now)
        except CAError:
            if self.state is not NodeJoinState.WAITING:
                self.state = NodeJoinState.OVER
            raise
        assert self.state in followers  # noqa: S101 - the table is the truth

    def claim(self, metadata: bytes) -> bytes:
        """Ask which name the authority's rules give for `metadata`, of 1 to 4096 octets.

        Raises:
            EnrollmentOver: the authority is not verified, or this was done.
            EnrollmentMessageRefused: no metadata, or too long.
        """
        self._require(NodeJoinState.WELCOMED)
        self._metadata = _checked(metadata)
        proof = join_transcript.sign_claim(self._code.signer, self._transcript, metadata)
        self.state = NodeJoinState.CLAIMED
        return write(Claim(metadata, proof))

    def join(self, csr: bytes, metadata: bytes = b"") -> bytes:
        """The request with its proof; `csr` is for a name within the invitation, or `name`.

        With `metadata`, those of the claim if there was one, the name must be the one that the
        authority's rules give for them.

        Raises:
            EnrollmentOver: the authority is not verified, or this was done.
            RequestRefused: `csr` is invalid, for another trust domain, or not for `name`.
            EnrollmentMessageRefused: metadata that are too long.
        """
        self._require(NodeJoinState.WELCOMED, NodeJoinState.NAMED)
        if metadata and not self._metadata:
            self._metadata = _checked(metadata)
        wildcard = self._code.wildcard
        self._request = check_request(csr, self.anchor.domain, wildcard=wildcard)
        name, signer, metadata = self._request.name, self._code.signer, self._metadata
        if self._name and name != self._name:
            raise RequestRefused(f"the request is not for {self._name}")
        proof = join_transcript.sign_proof(signer, self._transcript, csr, name, metadata)
        self.state = NodeJoinState.PROVED
        return write(Join(name, csr, proof, metadata))

    def _require(self, *states: NodeJoinState) -> None:
        if self.state not in states:
            raise EnrollmentOver(f"not possible in state {self.state.value!r}")

    def _verify(self, message: Welcome, now: int) -> None:
        """Check the hash first: a root that is not the code's is not parsed."""
        if not compare_digest(sha256(message.root).digest(), self._code.root):
            raise NotTheAuthority(
                "another authority answers at the address of the invitation",
                "is the invitation of this site? find out who answers there",
            )
        anchor = TrustAnchor.load(message.root)
        live = _live_identity(anchor, message.chain, now)
        transcript_hash = join_transcript.transcript(
            self._code.id, self._nonce, message.nonce, message.chain, message.root
        )
        join_transcript.check_live(message.statement, live.public_key, transcript_hash)
        self._anchor, self._transcript = anchor, transcript_hash
        self.state = NodeJoinState.WELCOMED

    def _named(self, message: Named, _: int) -> None:
        """A name on the way may be forged: the authority issues none but that of its rules."""
        name = check_name(message.name)
        if is_reserved(name) or not covers(self._code.pattern, name):
            raise NotTheAuthority(
                f"the peer gives the name {name}, which the invitation does not allow",
                "the authority gives none outside of it: find out who answers at that address",
            )
        self._name, self.state = name, NodeJoinState.NAMED

    def _issued(self, message: Issued, now: int) -> None:
        assert self._request is not None  # noqa: S101 - in PROVED there is one
        root = self.anchor.certificate
        anchor = check_issued(root, message.chain, self._request, now)
        self._identity = JoinedIdentity(message.chain, root, anchor)
        self.state = NodeJoinState.JOINED

    def _waiting(self, message: Waiting, _: int) -> None:
        self.state = NodeJoinState.WAITING
        raise JoinWaiting(*join_refusals.WAITING[message.reason])

    def _refused(self, message: Refused, _: int) -> None:
        kind = JoinBusy if message.reason is RefuseReason.BUSY else JoinRefused
        texts = join_refusals.CLAIM_REFUSED if self._metadata else join_refusals.REFUSED
        raise kind(*texts[message.reason])


def _checked(metadata: bytes) -> bytes:
    if not 0 < len(metadata) <= MAX_METADATA:
        raise EnrollmentMessageRefused(
            f"{len(metadata)} bytes of metadata where 1 to {MAX_METADATA} are allowed",
            "a join takes what a name needs: leave the rest out",
        )
    return metadata


def _live_identity(anchor: TrustAnchor, chain: tuple[bytes, ...], now: int) -> Identity:
    """The identity of the peer, which must be the authority's own node."""
    try:
        found = anchor.verify(chain, now)
    except (CertificateExpired, CertificateNotYetValid) as error:
        raise NotTheAuthority(
            f"the authority's node cannot be verified: {error}", _CLOCK
        ) from error
    except CAError as error:
        raise NotTheAuthority(
            f"the peer is not the authority: {error}", "find out who answers at that address"
        ) from error
    if found.name != AUTHORITY or found.wildcard:
        raise NotTheAuthority(
            f"the peer is {found.name}, a node of this site, and not its authority",
            "it may be an attack: find out who answers at that address",
        )
    return found
