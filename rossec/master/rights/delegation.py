"""Renewing grants for the authority, within what it delegated. Pure.

The authority's delegation names the master's key, the trust domain, and the longest validity of a
ticket. A ticket is signed for a grant that its holder presents, expired or not, as long as its cap
is not reached and nothing is revoked. The renewed grant is first verified as every node will.
"""

from collections.abc import Callable
from typing import Final

from ca.certificates import TrustAnchor
from ca.keys.publickey import thumbprint
from ca.keys.signer import Signer
from ca.revocation.state import SKEW
from grants import renewal
from grants.decision import RevocationCheck
from grants.document import verify
from grants.errors import GrantNotHeld, RenewalForOther, RenewalNotInTime, RenewalTooWide
from grants.model import Grant
from grants.renewal import OpenDelegation, Ticket, open_delegation, sign_ticket
from grants.token import pack, unpack
from grants.validity import format_time

_HINT: Final = "at the authority: rossec master delegate"


def discard(_: bytes) -> None:
    """Persist nothing."""


class Delegate:
    """Signs tickets while the authority has delegated that.

    Args:
        anchor: the authority.
        signer: the master's own key.
        persist: makes a delegation durable; called before it takes effect.
    """

    def __init__(
        self, anchor: TrustAnchor, signer: Signer, persist: Callable[[bytes], None] = discard
    ) -> None:
        self._anchor = anchor
        self._signer = signer
        self._own = thumbprint(signer.public_key)
        self._persist = persist
        self._data = b""
        self._held: OpenDelegation | None = None

    def take(self, data: bytes) -> bool:
        """Accept a delegation; returns whether it is newer than the one held.

        Raises:
            RenewalForged, RenewalMalformed: not a delegation of the authority.
            RenewalForOther: for another key or trust domain.
        """
        new = open_delegation(data, self._anchor.public_key)
        if new.holder != self._own or new.domain != self._anchor.domain:
            raise RenewalForOther(
                "the delegation is for another key or trust domain than this master's", _HINT
            )
        if self._held is not None and new.not_before <= self._held.not_before:
            return False
        self._persist(data)
        self._held, self._data = new, data
        return True

    @property
    def id(self) -> bytes | None:
        """The id of the delegation held, by which it is revoked; None: none is held."""
        return None if self._held is None else self._held.id

    def renew(
        self, token: bytes, holder: bytes, now: int, *, seq: int, check: RevocationCheck
    ) -> tuple[Grant, bytes]:
        """The renewed grant in `token` and its new token.

        Raises:
            GrantError: a subclass that names the reason.
        """
        if self._held is None:
            raise RenewalNotInTime("the authority has not delegated renewal to this master", _HINT)
        data = unpack(token).grant
        grant = verify(data, self._anchor.public_key, domain=self._anchor.domain)
        if grant.holder != holder:
            raise GrantNotHeld(
                "the grant is bound to another key", f"it was issued to {grant.subject}"
            )
        ticket = sign_ticket(self._signer, self._ticket(grant, self._held, now, seq))
        key = self._signer.public_key
        renewed = renewal.renew(grant, ticket, self._held, key, now=now, seq=seq, check=check)
        return renewed, pack(data, ticket, self._data)

    def _ticket(self, grant: Grant, held: OpenDelegation, now: int, seq: int) -> Ticket:
        """Valid from `SKEW` ago: nodes whose clocks lag by less accept it at once."""
        if now >= grant.cap:
            raise RenewalTooWide(
                f"grant {grant.short_id} has reached its cap, {format_time(grant.cap)}",
                "ask the authority for a new grant",
            )
        if now >= held.expires:
            raise RenewalNotInTime(f"the delegation expired at {format_time(held.expires)}", _HINT)
        ends = min(now - SKEW + held.max_ttl, grant.cap, held.expires)
        if ends <= grant.expires:
            raise RenewalTooWide(
                f"grant {grant.short_id} expires later than any ticket would: ask again later"
            )
        return Ticket(grant.id, now - SKEW, ends, seq)
