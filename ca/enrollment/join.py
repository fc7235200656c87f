"""A join, sans-IO: from the code of an invitation to an identity; both sides and their messages.

The node says nothing of itself before the peer has shown that it is the authority *now*. Then it
proves the secret and sends its request, once a session. The authority's side talks to strangers:
it has no record and not the authority's key, hands the request on and sends what it is given. A
message that is not in the tables ends the session.
"""

from dataclasses import dataclass
from enum import Enum, IntEnum
from hashlib import sha256
from hmac import compare_digest
from typing import Final, TypeAlias

from ca import errors
from ca.certificates import TrustAnchor
from ca.enrollment import invitation
from ca.enrollment.invitation import (
    ID_SIZE,
    MAX_METADATA,
    MAX_STATEMENT,
    InvitationCode,
    JoinClaim,
    JoinRequest,
)
from ca.enrollment.messages import (
    NONCE,
    Codec,
    Machine,
    chain,
    check_issued,
    check_nonce,
    given,
    octets,
    text,
)
from ca.keys.signing import Signer
from ca.names import AUTHORITY, MAX_NAME, check_name, is_reserved, pattern_covers
from ca.svid import MAX_REQUEST, IdentityRequest, check_request

_AGAIN: Final = "then run `rossec node join` again: the same request gets its answer"

_CLOCK: Final = "check this computer's clock; if it is right, at the authority: rossec ca renew /ca"


class WaitReason(IntEnum):
    LOCKED = 1
    PERSON = 2


class RefuseReason(IntEnum):
    """Why a join was refused. A peer that did not prove the secret is told REFUSED or BUSY."""

    # One word for both: a stranger does not learn which invitations there are.
    REFUSED = 1  # no such invitation, or the proof is wrong
    ENDED = 2  # it has expired, was ended or is used up
    NAME = 3  # it does not allow the name
    REQUEST = 4  # the request is invalid
    DENIED = 5  # by a person, or its key is revoked
    BUSY = 6  # too many at once
    UNNAMED = 7  # metadata, but the authority has no rules for names
    METADATA = 8  # its rules give no name for them


@dataclass(frozen=True)
class Hello:
    invitation: bytes
    nonce: bytes


@dataclass(frozen=True)
class Welcome:
    nonce: bytes
    chain: tuple[bytes, ...]
    root: bytes
    statement: bytes


@dataclass(frozen=True)
class Join:
    """Node to authority: the name, the request (CSR, DER), and the proof of the secret."""

    name: str
    csr: bytes
    proof: bytes
    metadata: bytes = b""  # with them the authority issues only the name that its rules give


@dataclass(frozen=True)
class ClaimMessage:
    """Node to authority: its metadata, to be told its name, and the proof of the secret."""

    metadata: bytes
    proof: bytes


@dataclass(frozen=True)
class Named:
    name: str


@dataclass(frozen=True)
class Issued:
    chain: tuple[bytes, ...]


@dataclass(frozen=True)
class WaitingMessage:
    """Authority to node: not yet; the same request may be sent again."""

    reason: WaitReason


@dataclass(frozen=True)
class RefusedMessage:
    reason: RefuseReason


JoinAnswer: TypeAlias = Issued | WaitingMessage | RefusedMessage
NameAnswer: TypeAlias = Named | RefusedMessage
JoinMessage: TypeAlias = Hello | Welcome | Join | ClaimMessage | Named | JoinAnswer


# Their numbers continue those of an enrollment, so that no message of one mode is one of the other.
_CODEC: Final = Codec[JoinMessage](
    "a join",
    7,
    (Hello, octets(ID_SIZE, ID_SIZE), NONCE),
    (Welcome, NONCE, chain, octets(), octets(MAX_STATEMENT)),
    (Join, text(MAX_NAME), octets(MAX_REQUEST), octets(MAX_STATEMENT), octets(MAX_METADATA)),
    (Issued, chain),
    (WaitingMessage, WaitReason),
    (RefusedMessage, RefuseReason),
    (ClaimMessage, octets(MAX_METADATA, least=1), octets(MAX_STATEMENT)),
    (Named, text(MAX_NAME)),
)
write, read = _CODEC.write, _CODEC.read


WAITING: Final = {
    WaitReason.LOCKED: ("the authority is locked", f"at the authority: rossec ca unlock; {_AGAIN}"),
    WaitReason.PERSON: (
        "a person has to approve this: the name is known with another key",
        f"at the authority: rossec ca requests, and approve; {_AGAIN}",
    ),
}
REFUSED: Final = {
    RefuseReason.REFUSED: (
        "the authority does not know this invitation",
        "of another authority, or from before a restore? another one: rossec ca invite PATTERN",
    ),
    RefuseReason.ENDED: (
        "the invitation has expired, was revoked, or is used up",
        "at the authority: rossec ca invitations; another one: rossec ca invite PATTERN",
    ),
    RefuseReason.NAME: (
        "the invitation does not allow this name",
        "give a name within its pattern that no other node has: --name",
    ),
    RefuseReason.REQUEST: (
        "the authority does not accept this request",
        "move the node's directory away and try again",
    ),
    RefuseReason.DENIED: (
        "this request was denied, or its key is revoked",
        "move the node's directory away and join with a new key",
    ),
    RefuseReason.BUSY: ("too many nodes are joining, or too many requests wait", "try again in a minute"),
    RefuseReason.UNNAMED: (
        "the authority has no rules that give names",
        "give the name: --name; or at the authority: rossec ca serve --rules FILE",
    ),
    RefuseReason.METADATA: (
        "the authority's rules give no name for these metadata",
        "try them with the same rules: rossec namespace name FILE; its log says why",
    ),
}
CLAIM_REFUSED: Final = {
    **REFUSED,
    RefuseReason.REFUSED: (
        "the authority does not know this invitation, or is too old to give names",
        "join with a name: --name; or update the authority",
    ),
    RefuseReason.NAME: (
        "the authority's rules give another name, or one that the invitation does not allow",
        "see which: rossec namespace name FILE; then correct the metadata or the invitation",
    ),
}


class NodeJoinState(Enum):
    GREETING = "waiting for the authority"
    WELCOMED = "the authority is verified"
    CLAIMED = "waiting for a name"
    NAMED = "has a name"
    PROVED = "waiting for the answer"
    JOINED = "joined"
    WAITING = "not answered yet"
    OVER = "ended"


_S = NodeJoinState
NODE_TABLE: Final[dict[tuple[_S, type[JoinMessage]], tuple[str, tuple[_S, ...]]]] = {
    (_S.GREETING, Welcome): ("_verify", (_S.WELCOMED, _S.OVER)),
    (_S.GREETING, RefusedMessage): ("_refused", (_S.OVER,)),
    (_S.CLAIMED, Named): ("_named", (_S.NAMED, _S.OVER)),
    (_S.CLAIMED, RefusedMessage): ("_refused", (_S.OVER,)),
    (_S.PROVED, Issued): ("_issued", (_S.JOINED, _S.OVER)),
    (_S.PROVED, WaitingMessage): ("_waiting", (_S.WAITING,)),
    (_S.PROVED, RefusedMessage): ("_refused", (_S.OVER,)),
}


@dataclass(frozen=True)
class JoinedIdentity:
    """The identity of a node that joined (DER); `anchor` is the root as it will be trusted."""

    chain: tuple[bytes, ...]
    root: bytes
    anchor: TrustAnchor


class NodeJoin(Machine[NodeJoinState]):
    def __init__(self, code: InvitationCode, nonce: bytes) -> None:
        super().__init__(_S.GREETING, NODE_TABLE)
        self._code = code
        self._nonce = check_nonce(nonce)
        self._transcript = b""
        self._anchor: TrustAnchor | None = None
        self._request: IdentityRequest | None = None
        self._identity: JoinedIdentity | None = None
        self._metadata = b""
        self._name = ""

    def hello(self) -> bytes:
        return write(Hello(self._code.id, self._nonce))

    @property
    def anchor(self) -> TrustAnchor:
        """The authority's root, once the peer is verified; not trusted before the identity is."""
        return given(self._anchor, "the authority is not verified yet")

    @property
    def name(self) -> str:
        return given(self._name or None, "the authority has given no name")

    @property
    def identity(self) -> JoinedIdentity:
        """What to write to the disk, in the state JOINED."""
        return given(self._identity, "the node has not joined")

    def receive(self, data: bytes, now: int) -> None:
        try:
            self._take(read(data), now)
        except errors.CAError:
            if self.state is not _S.WAITING:
                self.state = _S.OVER
            raise

    def claim(self, metadata: bytes) -> bytes:
        """Ask which name the authority's rules give for `metadata`, of 1 to 4096 octets."""
        self._require(_S.WELCOMED)
        self._metadata = _checked(metadata)
        proof = invitation.sign_claim(self._code.signer, self._transcript, metadata)
        self.state = _S.CLAIMED
        return write(ClaimMessage(metadata, proof))

    def join(self, csr: bytes, metadata: bytes = b"") -> bytes:
        """The request with its proof; `csr` is for a name within the invitation, or `name`."""
        # With `metadata`, those of the claim if there was one, the name must be the one that the authority's
        # rules give for them.
        self._require(_S.WELCOMED, _S.NAMED)
        if metadata and not self._metadata:
            self._metadata = _checked(metadata)
        self._request = check_request(csr, self.anchor.domain, wildcard=self._code.wildcard)
        name, signer, metadata = self._request.name, self._code.signer, self._metadata
        if self._name and name != self._name:
            raise errors.RequestRefused(f"the request is not for {self._name}")
        proof = invitation.sign_proof(signer, self._transcript, csr, name, metadata)
        self.state = _S.PROVED
        return write(Join(name, csr, proof, metadata))

    def _verify(self, message: Welcome, now: int) -> None:
        # 1. The hash first: a root that is not the code's is not parsed.
        if not compare_digest(sha256(message.root).digest(), self._code.root):
            raise errors.EnrollmentRefused(
                "another authority answers at the address of the invitation",
                "is the invitation of this site? find out who answers there",
            )
        anchor = TrustAnchor.load(message.root)
        # 2. A chain to that root, for `/ca`: every node has one, none but the authority's is taken.
        try:
            live = anchor.verify(message.chain, now)
        except (errors.CertificateExpired, errors.CertificateNotYetValid) as error:
            raise errors.EnrollmentRefused(
                f"the authority's node cannot be verified: {error}", _CLOCK
            ) from error
        except errors.CAError as error:
            raise errors.EnrollmentRefused(
                f"the peer is not the authority: {error}", "find out who answers at that address"
            ) from error
        if live.name != AUTHORITY or live.wildcard:
            raise errors.EnrollmentRefused(
                f"the peer is {live.name}, a node of this site, and not its authority",
                "it may be an attack: find out who answers at that address",
            )
        # 3. Signed now: its transcript has this node's nonce, so nothing recorded serves.
        transcript_hash = invitation.transcript(
            self._code.id, self._nonce, message.nonce, message.chain, message.root
        )
        invitation.check_live(message.statement, live.public_key, transcript_hash)
        self._anchor, self._transcript = anchor, transcript_hash
        self.state = _S.WELCOMED

    def _named(self, message: Named, _: int) -> None:
        # The code is what a person gave this node: the rules of a server may narrow it, not widen it.
        name = check_name(message.name)
        if is_reserved(name) or not pattern_covers(self._code.pattern, name):
            raise errors.EnrollmentRefused(
                f"the peer gives the name {name}, which the invitation does not allow",
                "the authority gives none outside of it: find out who answers at that address",
            )
        self._name, self.state = name, _S.NAMED

    def _issued(self, message: Issued, now: int) -> None:
        assert self._request is not None  # noqa: S101 - in PROVED there is one
        root = self.anchor.certificate
        anchor = check_issued(root, message.chain, self._request, now)
        self._identity = JoinedIdentity(message.chain, root, anchor)
        self.state = _S.JOINED

    def _waiting(self, message: WaitingMessage, _: int) -> None:
        self.state = _S.WAITING
        raise errors.JoinWaiting(*WAITING[message.reason])

    def _refused(self, message: RefusedMessage, _: int) -> None:
        kind = errors.JoinBusy if message.reason is RefuseReason.BUSY else errors.JoinRefused
        texts = CLAIM_REFUSED if self._metadata else REFUSED
        raise kind(*texts[message.reason])


def _checked(metadata: bytes) -> bytes:
    if not 0 < len(metadata) <= MAX_METADATA:
        raise errors.EnrollmentMessageRefused(
            f"{len(metadata)} bytes of metadata where 1 to {MAX_METADATA} are allowed",
            "a join takes what a name needs: leave the rest out",
        )
    return metadata


class AuthorityJoinState(Enum):
    GREETING = "waiting for a node"
    WELCOMED = "waiting for the request"
    NAMING = "a name is being found"
    NAMED = "waiting for the request with that name"
    DECIDING = "the request is being decided"
    ANSWERED = "answered"
    OVER = "ended"


_A = AuthorityJoinState
AUTHORITY_TABLE: Final[dict[tuple[_A, type[JoinMessage]], tuple[str, tuple[_A, ...]]]] = {
    (_A.GREETING, Hello): ("_welcome", (_A.WELCOMED,)),
    (_A.WELCOMED, ClaimMessage): ("_take_claim", (_A.NAMING,)),
    (_A.WELCOMED, Join): ("_accept", (_A.DECIDING, _A.OVER)),
    (_A.NAMED, Join): ("_accept", (_A.DECIDING, _A.OVER)),
}


@dataclass(frozen=True)
class LiveIdentity:
    """The identity of `/ca` with which the authority shows that it is there (DER)."""

    signer: Signer
    chain: tuple[bytes, ...]
    root: bytes


class AuthorityJoin(Machine[AuthorityJoinState]):
    def __init__(self, identity: LiveIdentity, nonce: bytes) -> None:
        super().__init__(_A.GREETING, AUTHORITY_TABLE)
        self.invitation = b""
        self._identity = identity
        self._nonce = check_nonce(nonce)
        self._transcript = b""
        self._request: JoinRequest | None = None
        self._claim: JoinClaim | None = None

    @property
    def claim(self) -> JoinClaim:
        """The claim to be named; nothing of it is verified."""
        return given(self._claim, "there is no claim")

    @property
    def request(self) -> JoinRequest:
        """The request to be decided; nothing of it is verified."""
        return given(self._request, "there is no request yet")

    def receive(self, data: bytes) -> bytes | None:
        """Process one message of a node; returns what to send, or None: see `claim`, `request`."""
        try:
            sent: bytes | None = self._take(read(data))
        except errors.EnrollmentRefused:
            self.state = _A.OVER
            raise
        return sent

    def name(self, answer: NameAnswer) -> bytes:
        """The answer to the claim; after a refusal the connection is closed."""
        self._require(_A.NAMING)
        self.state = _A.NAMED if isinstance(answer, Named) else _A.ANSWERED
        return write(answer)

    def answer(self, answer: JoinAnswer) -> bytes:
        """The last message; the connection is closed after it."""
        self._require(_A.DECIDING)
        self.state = _A.ANSWERED
        return write(answer)

    def _welcome(self, message: Hello) -> bytes:
        own = self._identity
        self.invitation = message.invitation
        self._transcript = invitation.transcript(
            message.invitation, message.nonce, self._nonce, own.chain, own.root
        )
        statement = invitation.sign_live(own.signer, self._transcript)
        self.state = _A.WELCOMED
        return write(Welcome(self._nonce, own.chain, own.root, statement))

    def _take_claim(self, message: ClaimMessage) -> None:
        self._claim = JoinClaim(self.invitation, self._transcript, message.metadata, message.proof)
        self.state = _A.NAMING

    def _accept(self, message: Join) -> None:
        self._request = JoinRequest(
            self.invitation, self._transcript, message.name, message.csr, message.proof, message.metadata
        )
        self.state = _A.DECIDING
