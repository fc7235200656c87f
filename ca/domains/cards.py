"""A domain's card: what one authority hands to another, which may then trust the domain.

It is signed by the root key it contains. So it proves that its maker has the key and wants what it
says, and nothing about who that is: the fingerprint of the root, or the digest of the card in a
code, is compared over another way. It is no secret. Names and addresses are proposals; what is
admitted is decided by who accepts.
"""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from ca.certificates import MAX_CERTIFICATE, TrustAnchor
from ca.cose import Profile
from ca.encoding import Value
from ca.errors import CAError, CardRefused, EncodingError, SignatureError
from ca.keys.publickey import thumbprint
from ca.keys.signer import Signer
from ca.patterns import check_pattern

CARD: Final = Profile("rossec-card+cwt")
LIFETIME: Final = 7 * 86400
MAX_LIFETIME: Final = 30 * 86400
MAX_NAMES: Final = 16
MAX_MASTERS: Final = 8
MAX_CARD: Final = MAX_CERTIFICATE + 8 * 1024
SKEW: Final = 300  # seconds that another site's clock may be behind
_EXP, _IAT, _ROOT, _NAMES, _MASTERS = 4, 6, -70037, -70038, -70039
_INT_LIMIT: Final = 1 << 53
_URI: Final = re.compile(r"http://[A-Za-z0-9.:\[\]-]{1,255}/?", re.ASCII)
_HINT: Final = "ask for the file that `rossec domain card` wrote"


@dataclass(frozen=True)
class Card:
    """What a card says.

    Args:
        root: the root certificate of the domain, DER.
        names: patterns of the nodes for which admission is asked; at most 16.
        masters: where its masters are, `http://host:port`; at most 8.
        issued, expires: seconds; at most 30 days.
    """

    root: bytes
    names: tuple[str, ...]
    masters: tuple[str, ...]
    issued: int
    expires: int

    def __post_init__(self) -> None:
        times = type(self.issued), type(self.expires)
        if times != (int, int) or not 0 <= self.issued < self.expires < _INT_LIMIT:
            raise CardRefused("a card that is never valid", _HINT)
        if self.expires - self.issued > MAX_LIFETIME:
            raise CardRefused("a card that is valid for more than 30 days", _HINT)
        if not 1 <= len(self.names) <= MAX_NAMES or len(self.masters) > MAX_MASTERS:
            raise CardRefused("a card with no names, or with too many names or masters", _HINT)
        for pattern in self.names:
            check_pattern(pattern)
        for uri in self.masters:
            if _URI.fullmatch(uri) is None:
                raise CardRefused(f"{uri[:300]!a} is not a master's address", "http://HOST:PORT")

    @cached_property
    def anchor(self) -> TrustAnchor:
        """The root, as an anchor."""
        return TrustAnchor.load(self.root)


def sign_card(signer: Signer, card: Card) -> bytes:
    """Sign a card with the key of its root.

    Raises:
        CardRefused: the key is another one.
    """
    if thumbprint(signer.public_key) != card.anchor.thumbprint:
        raise CardRefused("the card is not about this authority", "an intermediate signs no cards")
    names: list[Value] = [*card.names]
    claims: dict[int | str, Value] = {
        _EXP: card.expires, _IAT: card.issued, _ROOT: card.root, _NAMES: names,
    }  # fmt: skip
    if card.masters:
        claims[_MASTERS] = [*card.masters]
    return CARD.sign(signer, claims)


def open_card(data: bytes, now: int) -> Card:
    """Verify a card by the root in it, and read it.

    Raises:
        CardRefused: not a card, not signed by its own root, expired, or from the future.
    """
    try:
        card = _read(CARD.peek(data, limit=MAX_CARD))  # the key to verify with is in it
        CARD.open(data, card.anchor.public_key, limit=MAX_CARD)
    except CardRefused:
        raise
    except (SignatureError, EncodingError) as error:
        raise CardRefused(f"this is not a domain's card: {error}", _HINT) from None
    except CAError as error:
        raise CardRefused(f"in the card: {error}", _HINT) from error
    if now >= card.expires:
        raise CardRefused(f"the card expired {now - card.expires} s ago", "ask for a new one")
    if now < card.issued - SKEW:
        raise CardRefused("the card is from the future", "check the clocks of both computers")
    return card


def _read(payload: Value) -> Card:
    match payload:
        case {
            4: int() as exp, 6: int() as iat, -70037: bytes() as root, -70038: list() as names,
            **rest,
        } if rest.keys() <= {_MASTERS}:  # fmt: skip
            masters = rest.get(_MASTERS, [])
        case _:
            raise CardRefused("the card has missing or unknown fields", _HINT)
    if not isinstance(masters, list) or (_MASTERS in rest and not masters):
        raise CardRefused("the masters of the card are not a list of addresses", _HINT)
    return Card(root, _texts(names), _texts(masters), iat, exp)


def _texts(items: list[Value]) -> tuple[str, ...]:
    texts = tuple(each for each in items if isinstance(each, str))
    if len(texts) != len(items) or len(items) > MAX_NAMES:
        raise CardRefused("the card has a name or an address that is not one", _HINT)
    return texts
