"""An enrollment, sans-IO: the node's side, the authority's side, and what both compute.

The node answers *one* valid offer, which has no effect until a person has confirmed it there.
Everything the authority gets is checked against the code, which came from the node itself; the node
is enrolled when it says so in a signed statement. A message that is not in the tables changes
nothing. docs/spec/enrollment.md has the steps.
"""

import hmac
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from hashlib import sha256
from typing import Final

from ca import encoding, errors
from ca.certificates import TrustAnchor
from ca.enrollment import NONCE_SIZE, WINDOW, qr
from ca.enrollment.messages import (
    Abort,
    Acknowledgement,
    Delivery,
    Done,
    EnrollmentOffer,
    Fetch,
    Machine,
    Message,
    Reason,
    check_issued,
    check_nonce,
    given,
    read,
    write,
)
from ca.enrollment.qr import Code
from ca.keys.signing import Profile, PublicKey, Signer
from ca.svid import IdentityRequest, check_request

_CONTEXT: Final = "rossec-enroll-v1"
_OFFER: Final = "rossec-enroll-offer-v1"
_DIGITS: Final = "rossec-enroll-digits-v1"
_ACKNOWLEDGEMENT: Final = Profile("rossec-enroll-ack+cbor")
_DONE: Final = Profile("rossec-enroll-done+cbor")
_MAX_STATEMENT: Final = 512

MAX_BAD_TAGS: Final = 5
MAX_BAD_DIGITS: Final = 3
_RESTART_HINT: Final = "start again: rossec node enroll NAME"

_ABORTS: Final[dict[Reason, tuple[type[errors.EnrollmentRefused], str, str]]] = {
    Reason.REFUSED: (
        errors.EnrollmentOver,
        "the node refused the offer",
        "does it show a new code, or is its clock wrong? `rossec node enroll` says why",
    ),
    Reason.OVER: (errors.EnrollmentOver, "the node has ended the enrollment", "show a new code on the node"),
    Reason.CONFLICT: (
        errors.ConflictingOffer,
        "the node received two different offers: another party has its code",
        "the node accepted none; find the other party, then show a new code",
    ),
}


def transcript(csr: bytes, chain: Sequence[bytes], root: bytes, nonce: bytes) -> bytes:
    # Request, certificates, anchor and a fresh nonce: nothing signed over it can be replayed or taken for
    # another statement, and no peer chooses the octets that a node signs.
    certificates = [_digest(certificate) for certificate in chain]
    return _digest(encoding.encode([_CONTEXT, _digest(csr), [*certificates], _digest(root), nonce]))


def tag(secret: bytes, transcript_hash: bytes) -> bytes:
    return hmac.digest(secret, encoding.encode([_OFFER, transcript_hash]), "sha256")


def verify_tag(secret: bytes, transcript_hash: bytes, given: bytes) -> bool:
    return hmac.compare_digest(tag(secret, transcript_hash), given)


def digits(transcript_hash: bytes, contribution: bytes) -> str:
    # `contribution` is revealed only *after* the offer is fixed: otherwise an attacker posing as the
    # authority could try a million nonces until the digits match.
    number = int.from_bytes(_digest(encoding.encode([_DIGITS, transcript_hash, contribution]))[:8])
    return f"{number % 1_000_000:06}"


def group_digits(six: str) -> str:
    return f"{six[:3]} {six[3:]}"


def sign_acknowledgement(signer: Signer, transcript_hash: bytes, contribution: bytes) -> bytes:
    return _ACKNOWLEDGEMENT.sign(signer, [transcript_hash, contribution])


def open_acknowledgement(data: bytes, key: PublicKey, transcript_hash: bytes) -> bytes:
    match _open(_ACKNOWLEDGEMENT, data, key):
        case [bytes() as acknowledged, bytes() as contribution] if (
            acknowledged == transcript_hash and len(contribution) == NONCE_SIZE
        ):
            return contribution
        case _:
            raise _replayed()


def sign_done(signer: Signer, transcript_hash: bytes) -> bytes:
    return _DONE.sign(signer, [transcript_hash])


def check_done(data: bytes, key: PublicKey, transcript_hash: bytes) -> None:
    if _open(_DONE, data, key) != [transcript_hash]:
        raise _replayed()


def _open(profile: Profile, data: bytes, key: PublicKey) -> object:
    try:
        return profile.open(data, key, limit=_MAX_STATEMENT)
    except (errors.SignatureError, errors.EncodingError) as error:
        raise errors.EnrollmentRefused(
            f"the answer is not signed by the node: {error}", "possible attacker in between: start again"
        ) from error


def _replayed() -> errors.EnrollmentRefused:
    return errors.EnrollmentRefused(
        "the node's answer is for another offer",
        "it was replayed, or there was a second offer: do not confirm at the node, start again",
    )


def _digest(data: bytes) -> bytes:
    return sha256(data).digest()


class NodeState(Enum):
    SHOWING = "waiting for an offer"
    PENDING = "waiting for confirmation"
    CONFIRMED = "confirmed"
    ENROLLED = "enrolled"
    OVER = "ended"


_S = NodeState
NODE_TABLE: Final[dict[tuple[_S, type[Message]], tuple[str, tuple[_S, ...]]]] = {
    (_S.SHOWING, Fetch): ("_deliver", (_S.SHOWING,)),
    (_S.SHOWING, EnrollmentOffer): ("_check_first_offer", (_S.SHOWING, _S.PENDING, _S.OVER)),
    (_S.PENDING, Fetch): ("_deliver", (_S.PENDING,)),
    (_S.PENDING, EnrollmentOffer): ("_compare", (_S.PENDING, _S.OVER)),
    (_S.CONFIRMED, EnrollmentOffer): ("_compare", (_S.CONFIRMED, _S.OVER)),
    (_S.ENROLLED, EnrollmentOffer): ("_repeat_answers", (_S.ENROLLED,)),
}


@dataclass(frozen=True)
class Pending:
    chain: tuple[bytes, ...]  # DER
    root: bytes  # DER
    anchor: TrustAnchor  # the root as it will be trusted
    digits: str  # those that the authority must show too
    transcript: bytes
    acknowledgement: bytes


class NodeEnrollment(Machine[NodeState]):
    def __init__(
        self,
        signer: Signer,
        csr: bytes,
        domain: str,
        *,
        secret: bytes,
        contribution: bytes,
        expires: int,
        wildcard: bool = False,
    ) -> None:
        """Offer `csr`, this node's own request.

        `secret` is that of the screen code, 16 fresh random octets, or empty for a label;
        `contribution` are 16 fresh random octets, not revealed before there is an offer; `expires`
        is the last second for an offer; `wildcard`: the request is for anonymous nodes too.
        """
        if len(secret) not in {0, qr.SECRET_SIZE} or len(contribution) != NONCE_SIZE:
            raise errors.EnrollmentRefused("an enrollment needs 16 octets of each random value")
        super().__init__(_S.SHOWING, NODE_TABLE)
        self.request = check_request(csr, domain, wildcard=wildcard)
        self.end_reason: errors.EnrollmentRefused | None = None
        self.expires = expires
        self._signer = signer
        self._csr = csr
        self._secret = secret
        self._contribution = contribution
        self._pending: Pending | None = None
        self._bad_tags = 0
        self._bad_digits = 0

    def code(self, address: str = "") -> str:
        """The text to show; `address` is where this node listens, for screen codes."""
        if not self._secret:
            return qr.label_code(self._csr)
        return qr.screen_code(self._csr, self._secret, self.expires, address)

    @property
    def pending(self) -> Pending:
        return given(self._pending, "there is no offer to confirm", "first, at the authority: enroll")

    def receive(self, data: bytes, now: int) -> list[bytes]:
        """Process one message; returns the answers. On an error the connection must be closed."""
        self.tick(now)
        self._check_not_over()
        answers: list[bytes] = self._take(read(data), now)
        return answers

    def confirm(self, digits: str, now: int) -> Pending:
        """A person read `digits` at the authority: returns the offer to write to disk now."""
        self.tick(now)
        self._check_not_over()
        pending = self.pending
        if self.state is not _S.PENDING:
            raise errors.EnrollmentOver("this was confirmed already")
        if digits != pending.digits:  # not secret: they can be computed from the messages
            self._bad_digits += 1
            error = errors.EnrollmentRefused(
                "these are not the digits of the offer of this node",
                "possible attacker in between: if the authority shows these digits, do not continue",
            )
            if self._bad_digits >= MAX_BAD_DIGITS:
                self.stop(error)
            raise error
        self.state = _S.CONFIRMED
        return pending

    def activated(self) -> list[bytes]:
        """The confirmed identity is on the disk; returns the message for the authority."""
        if self.state is not _S.CONFIRMED:
            raise errors.EnrollmentOver("nothing was confirmed")
        self.state = _S.ENROLLED
        return [self._done()]

    def stop(self, why: errors.EnrollmentRefused) -> None:
        if self.state not in {_S.ENROLLED, _S.OVER}:
            self.state, self.end_reason, self._pending = _S.OVER, why, None

    def tick(self, now: int) -> None:
        if self.state in {_S.SHOWING, _S.PENDING} and now > self.expires:
            self.stop(errors.EnrollmentExpired("the enrollment was not finished in time", _RESTART_HINT))

    def _check_not_over(self) -> None:
        if self.state is _S.OVER:
            raise errors.EnrollmentOver(f"the enrollment is over: {self.end_reason}", _RESTART_HINT)

    def _deliver(self, _: Fetch, __: int) -> list[bytes]:
        return [write(Delivery(self._csr))]

    def _check_first_offer(self, offer: EnrollmentOffer, now: int) -> list[bytes]:
        # 1. The sender has read the code; 2. it is the identity asked for; 3. only then is the contribution
        # revealed, from which both sides compute the digits.
        transcript_hash = self._check_tag(offer)
        anchor = check_issued(offer.root, offer.chain, self.request, now)
        self._pending = Pending(
            offer.chain,
            offer.root,
            anchor,
            digits(transcript_hash, self._contribution),
            transcript_hash,
            sign_acknowledgement(self._signer, transcript_hash, self._contribution),
        )
        self.state, self.expires = _S.PENDING, now + WINDOW
        return [self._acknowledged()]

    def _compare(self, offer: EnrollmentOffer, now: int) -> list[bytes]:
        if self._is_pending_offer(offer):
            return [self._acknowledged()]
        # A second valid offer: another party has the code, and nobody knows which. Both are dropped.
        self._check_tag(offer)
        check_issued(offer.root, offer.chain, self.request, now)
        error = errors.ConflictingOffer(
            "this node received two different offers: another party has its code",
            f"nothing was accepted; find the other party, then {_RESTART_HINT}",
        )
        self.stop(error)
        raise error

    def _repeat_answers(self, offer: EnrollmentOffer, _: int) -> list[bytes]:
        if not self._is_pending_offer(offer):
            raise errors.EnrollmentOver("the node is enrolled already", _RESTART_HINT)
        return [self._acknowledged(), self._done()]

    def _is_pending_offer(self, offer: EnrollmentOffer) -> bool:
        return self._transcript(offer) == self.pending.transcript

    def _transcript(self, offer: EnrollmentOffer) -> bytes:
        return transcript(self._csr, offer.chain, offer.root, offer.nonce)

    def _acknowledged(self) -> bytes:
        return write(Acknowledgement(self.pending.acknowledgement))

    def _done(self) -> bytes:
        return write(Done(sign_done(self._signer, self.pending.transcript)))

    def _check_tag(self, offer: EnrollmentOffer) -> bytes:
        transcript_hash = self._transcript(offer)
        if not self._secret:
            if offer.tag:
                raise errors.EnrollmentRefused("an offer with a tag, but the code is a label")
        elif not verify_tag(self._secret, transcript_hash, offer.tag):
            # A wrong tag must not disturb an offer that waits for confirmation.
            self._bad_tags += self.state is _S.SHOWING
            if self._bad_tags >= MAX_BAD_TAGS:
                error = errors.EnrollmentOver(
                    f"{MAX_BAD_TAGS} offers without the code's secret", _RESTART_HINT
                )
                self.stop(error)
                raise error
            raise errors.EnrollmentRefused("the sender of the offer has not read the code")
        return transcript_hash


class AuthorityState(Enum):
    FETCHING = "fetching the request"
    COMPARED = "request verified"
    APPROVED = "approved"
    OFFERED = "waiting for the acknowledgement"
    ACKNOWLEDGED = "waiting for confirmation at the node"
    ENROLLED = "enrolled"
    OVER = "ended"


_A = AuthorityState
AUTHORITY_TABLE: Final[dict[tuple[_A, type[Message]], tuple[str, tuple[_A, ...]]]] = {
    (_A.FETCHING, Delivery): ("_compare", (_A.COMPARED, _A.OVER)),
    (_A.FETCHING, Abort): ("_aborted", (_A.OVER,)),
    (_A.OFFERED, Acknowledgement): ("_acknowledged", (_A.ACKNOWLEDGED, _A.OVER)),
    (_A.OFFERED, Abort): ("_aborted", (_A.OVER,)),
    (_A.ACKNOWLEDGED, Acknowledgement): ("_acknowledged_again", (_A.ACKNOWLEDGED,)),
    (_A.ACKNOWLEDGED, Done): ("_done", (_A.ENROLLED, _A.OVER)),
    (_A.ACKNOWLEDGED, Abort): ("_aborted", (_A.OVER,)),
    (_A.ENROLLED, Acknowledgement): ("_acknowledged_again", (_A.ENROLLED,)),
    (_A.ENROLLED, Done): ("_done", (_A.ENROLLED,)),
}


class AuthorityEnrollment(Machine[AuthorityState]):
    def __init__(self, code: Code, domain: str, *, wildcard: bool = False) -> None:
        super().__init__(_A.FETCHING, AUTHORITY_TABLE)
        self.digits = ""
        self._code = code
        self._domain = domain
        self._wildcard = wildcard
        self._request: IdentityRequest | None = None
        self.csr = b""
        self._transcript = b""
        self._statement = b""
        self.deadline = code.expires if code.secret else 0

    def fetch(self) -> bytes:
        return write(Fetch())

    @property
    def request(self) -> IdentityRequest:
        """The request: checked against the code, with proof of possession."""
        return given(self._request, "there is no request yet")

    def receive(self, data: bytes, now: int) -> None:
        self.tick(now)
        self._take(read(data), now)

    def approve(self, now: int) -> None:
        self.tick(now)
        self._require(_A.COMPARED)
        self.state = _A.APPROVED

    def deny(self) -> None:
        self._require(_A.COMPARED)
        self.state = _A.OVER

    def offer(self, chain: Sequence[bytes], root: bytes, nonce: bytes, now: int) -> bytes:
        """Return the offer to send, and to send again unchanged when the connection breaks."""
        # `chain` is the certificate issued for `csr`, and an intermediate if there is one; `nonce` are 16
        # fresh random octets.
        self.tick(now)
        # The authority checks its own work: what a person approved is what is sent.
        identity, request = TrustAnchor.load(root).verify(chain, now), self.request
        ours = (request.domain, request.name, request.wildcard, request.thumbprint)
        offered = (identity.domain, identity.name, identity.wildcard, identity.thumbprint)
        if offered != ours:
            raise errors.EnrollmentRefused("the certificate is not the one that was asked for")
        check_nonce(nonce)
        self._require(_A.APPROVED)
        self.state = _A.OFFERED
        self.deadline = now + WINDOW
        self._transcript = transcript(self.csr, chain, root, nonce)
        secret = self._code.secret
        proof = tag(secret, self._transcript) if secret else b""
        return write(EnrollmentOffer(tuple(chain), root, nonce, proof))

    def tick(self, now: int) -> None:
        if self.state in {_A.ENROLLED, _A.OVER}:
            return
        if self.deadline and now > self.deadline:
            self.state = _A.OVER
            raise errors.EnrollmentExpired(
                "the enrollment was not finished in time", "show a new code on the node"
            )

    def _compare(self, message: Delivery, _: int) -> None:
        # Check the hash first: a request that does not match the code is not parsed.
        self.state = _A.OVER  # whatever is raised below
        if not self._code.matches(message.csr):
            raise errors.RequestSwapped(
                "the request is not the one the code was made for",
                "it was replaced on the network, or this is another node: scan the code again",
            )
        self._request = check_request(message.csr, self._domain, wildcard=self._wildcard)
        self.csr = message.csr
        self.state = _A.COMPARED

    def _acknowledged(self, message: Acknowledgement, now: int) -> None:
        self.state = _A.OVER
        contribution = open_acknowledgement(message.statement, self.request.public_key, self._transcript)
        self.digits = digits(self._transcript, contribution)
        self._statement = message.statement
        self.deadline = now + WINDOW
        self.state = _A.ACKNOWLEDGED

    def _acknowledged_again(self, message: Acknowledgement, _: int) -> None:
        if message.statement != self._statement:
            raise errors.EnrollmentRefused("a second, different answer of the node", "start again")

    def _done(self, message: Done, _: int) -> None:
        if self.state is _A.ACKNOWLEDGED:  # in ENROLLED, an invalid one changes nothing
            self.state = _A.OVER
        check_done(message.statement, self.request.public_key, self._transcript)
        self.state = _A.ENROLLED

    def _aborted(self, message: Abort, _: int) -> None:
        self.state = _A.OVER
        error, text, hint = _ABORTS[message.reason]
        raise error(text, hint)
