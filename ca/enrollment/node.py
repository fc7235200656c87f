"""The node's side of an enrollment, sans-IO.

It shows a code, sends its request to any peer, and answers *one* valid offer. The offer has no
effect until a person has confirmed it here. A second valid offer means that another party has the
code, or is in the middle: both are dropped. Five offers with a wrong tag lock a screen code. Every
state has a deadline. `TABLE` has all transitions; any other message changes nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final

from ca.certificates import TrustAnchor
from ca.enrollment import NONCE_SIZE, WINDOW, qr, transcript
from ca.enrollment.issued import check_issued
from ca.enrollment.messages import (
    Acknowledgement,
    Delivery,
    Done,
    Fetch,
    Message,
    Offer,
    read,
    write,
)
from ca.errors import (
    ConflictingOffer,
    DigitsRefused,
    EnrollmentExpired,
    EnrollmentLocked,
    EnrollmentMessageRefused,
    EnrollmentOver,
    EnrollmentRefused,
    OfferRefused,
)
from ca.keys.signer import Signer
from ca.requests import check_request

MAX_BAD_TAGS: Final = 5
MAX_BAD_DIGITS: Final = 3
_RESTART_HINT: Final = "start again: rossec node enroll NAME"


class NodeState(Enum):
    """The state of one enrollment, at the node."""

    SHOWING = "waiting for an offer"
    PENDING = "waiting for confirmation"
    CONFIRMED = "confirmed"
    ENROLLED = "enrolled"
    OVER = "ended"


TABLE: Final[dict[tuple[NodeState, type[Message]], tuple[str, tuple[NodeState, ...]]]] = {
    (NodeState.SHOWING, Fetch): ("_deliver", (NodeState.SHOWING,)),
    (NodeState.SHOWING, Offer): (
        "_check_first_offer",
        (NodeState.SHOWING, NodeState.PENDING, NodeState.OVER),
    ),
    (NodeState.PENDING, Fetch): ("_deliver", (NodeState.PENDING,)),
    (NodeState.PENDING, Offer): ("_compare", (NodeState.PENDING, NodeState.OVER)),
    (NodeState.CONFIRMED, Offer): ("_compare", (NodeState.CONFIRMED, NodeState.OVER)),
    (NodeState.ENROLLED, Offer): ("_repeat_answers", (NodeState.ENROLLED,)),
}


@dataclass(frozen=True)
class Pending:
    """A valid offer to be confirmed by a person.

    `chain` and `root` are DER; `anchor` is the root as it will be trusted; `digits` are those the
    authority must show too.
    """

    chain: tuple[bytes, ...]
    root: bytes
    anchor: TrustAnchor
    digits: str
    transcript: bytes
    acknowledgement: bytes


class NodeEnrollment:
    """One enrollment of one node; used once."""

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

        Raises:
            RequestRefused: `csr` is invalid.
            EnrollmentRefused: wrong sizes.
        """
        if len(secret) not in {0, qr.SECRET_SIZE} or len(contribution) != NONCE_SIZE:
            raise EnrollmentRefused("an enrollment needs 16 octets of each random value")
        self.request = check_request(csr, domain, wildcard=wildcard)
        self.state = NodeState.SHOWING
        self.end_reason: EnrollmentRefused | None = None
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
        """The offer that was acknowledged.

        Raises:
            EnrollmentOver: there is none, or it was dropped.
        """
        if self._pending is None:
            raise EnrollmentOver("there is no offer to confirm", "first, at the authority: enroll")
        return self._pending

    def receive(self, data: bytes, now: int) -> list[bytes]:
        """Process one message; returns the answers. On an error the connection must be closed.

        Raises:
            EnrollmentRefused: a subclass for each error; `state` says whether the enrollment ended.
        """
        self.tick(now)
        self._check_not_over()
        message = read(data)
        entry = TABLE.get((self.state, type(message)))
        if entry is None:
            raise EnrollmentMessageRefused(
                f"unexpected {type(message).__name__} in state {self.state.value!r}"
            )
        method, followers = entry
        action: Callable[[Message, int], list[bytes]] = getattr(self, method)
        before = self.state
        answers = action(message, now)
        assert self.state in {before, *followers}  # noqa: S101 - the table is the truth
        return answers

    def confirm(self, digits: str, now: int) -> Pending:
        """A person read `digits` at the authority: returns the offer to write to disk now.

        Raises:
            DigitsRefused: they are wrong; the third time ends the enrollment.
            EnrollmentRefused: there is no offer, or it is too late.
        """
        self.tick(now)
        self._check_not_over()
        pending = self.pending
        if self.state is not NodeState.PENDING:
            raise EnrollmentOver("this was confirmed already")
        if digits != pending.digits:  # not secret: they can be computed from the messages
            self._count_bad_digits()
        self.state = NodeState.CONFIRMED
        return pending

    def activated(self) -> list[bytes]:
        """The confirmed identity is on the disk; returns the message for the authority."""
        if self.state is not NodeState.CONFIRMED:
            raise EnrollmentOver("nothing was confirmed")
        self.state = NodeState.ENROLLED
        return [self._done()]

    def stop(self, why: EnrollmentRefused) -> None:
        """End the enrollment; an enrolled node stays enrolled."""
        if self.state not in {NodeState.ENROLLED, NodeState.OVER}:
            self.state, self.end_reason, self._pending = NodeState.OVER, why, None

    def tick(self, now: int) -> None:
        """Check the deadline at `now`."""
        if self.state in {NodeState.SHOWING, NodeState.PENDING} and now > self.expires:
            self.stop(EnrollmentExpired("the enrollment was not finished in time", _RESTART_HINT))

    def _check_not_over(self) -> None:
        if self.state is NodeState.OVER:
            raise EnrollmentOver(f"the enrollment is over: {self.end_reason}", _RESTART_HINT)

    def _count_bad_digits(self) -> None:
        self._bad_digits += 1
        error = DigitsRefused(
            "these are not the digits of the offer of this node",
            "possible attacker in between: if the authority shows these digits, do not continue",
        )
        if self._bad_digits >= MAX_BAD_DIGITS:
            self.stop(error)
        raise error

    def _deliver(self, _: Fetch, __: int) -> list[bytes]:
        return [write(Delivery(self._csr))]

    def _check_first_offer(self, offer: Offer, now: int) -> list[bytes]:
        """Accept the first valid offer; an invalid one changes nothing."""
        transcript_hash = self._check_tag(offer)
        anchor = check_issued(offer.root, offer.chain, self.request, now)
        self._pending = Pending(
            offer.chain,
            offer.root,
            anchor,
            transcript.digits(transcript_hash, self._contribution),
            transcript_hash,
            transcript.sign_acknowledgement(self._signer, transcript_hash, self._contribution),
        )
        self.state, self.expires = NodeState.PENDING, now + WINDOW
        return [self._acknowledged()]

    def _compare(self, offer: Offer, now: int) -> list[bytes]:
        """Answer a repeated offer, whose answer was lost; refuse a different one."""
        if self._is_pending_offer(offer):
            return [self._acknowledged()]
        self._check_tag(offer)
        check_issued(offer.root, offer.chain, self.request, now)
        error = ConflictingOffer(
            "this node received two different offers: another party has its code",
            f"nothing was accepted; find the other party, then {_RESTART_HINT}",
        )
        self.stop(error)
        raise error

    def _repeat_answers(self, offer: Offer, _: int) -> list[bytes]:
        if not self._is_pending_offer(offer):
            raise EnrollmentOver("the node is enrolled already", _RESTART_HINT)
        return [self._acknowledged(), self._done()]

    def _transcript(self, offer: Offer) -> bytes:
        return transcript.transcript(self._csr, offer.chain, offer.root, offer.nonce)

    def _is_pending_offer(self, offer: Offer) -> bool:
        return self._transcript(offer) == self.pending.transcript

    def _acknowledged(self) -> bytes:
        return write(Acknowledgement(self.pending.acknowledgement))

    def _done(self) -> bytes:
        return write(Done(transcript.sign_done(self._signer, self.pending.transcript)))

    def _check_tag(self, offer: Offer) -> bytes:
        transcript_hash = self._transcript(offer)
        if not self._secret:
            if offer.tag:
                raise OfferRefused("an offer with a tag, but the code is a label")
        elif not transcript.verify_tag(self._secret, transcript_hash, offer.tag):
            self._count_bad_tag()
        return transcript_hash

    def _count_bad_tag(self) -> None:
        if (
            self.state is NodeState.SHOWING
        ):  # a wrong tag must not disturb an offer that waits for confirmation
            self._bad_tags += 1
        if self._bad_tags >= MAX_BAD_TAGS:
            error = EnrollmentLocked(
                f"{MAX_BAD_TAGS} offers without the code's secret", _RESTART_HINT
            )
            self.stop(error)
            raise error
        raise OfferRefused("the sender of the offer has not read the code")
