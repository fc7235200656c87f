"""What the authority's key signs: the table of its statements, and certificates. Pure.

The service signs for every program of its user, and so it must not become an oracle: bytes that are
none of these are refused, whoever asks. What nodes or the master sign (requests, renewals, tickets,
timestamps) is not in the table: those are never signed with this key.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

from cryptography import x509

from ca.cose import Profile
from ca.domains.cards import CARD
from ca.domains.lists import DOMAINS
from ca.errors import CertificateRefused, EncodingError, SignatureError
from ca.revocation.lists import LIST_PROFILE, MAX_LIST
from ca.revocation.tree import TREE
from ca.store.log_entries import HEAD_PROFILE
from ca.things.statement import THING
from ca.unsigned import read_unsigned
from grants.document import GRANT
from grants.renewal import DELEGATION
from rossec.errors import SigningRefused

MAX_MESSAGE: Final = MAX_LIST + 512  # the largest statement is a revocation list
_STATEMENTS: Final[Mapping[str, Profile]] = {
    "a grant": GRANT,
    "a delegation": DELEGATION,
    "a revocation list": LIST_PROFILE,
    "a revocation tree": TREE,
    "a head of the log": HEAD_PROFILE,
    "a list of domains": DOMAINS,
    "a card of its domain": CARD,
    "a statement about a thing": THING,
}
_HINT: Final = "the program that asked is of another version of rossec, or not rossec"


class Authority(NamedTuple):
    """Whose key it is: the issuer name in its certificates, and its trust domain."""

    subject: x509.Name
    domain: str


def kind_of(message: bytes, authority: Authority) -> str:
    """What `message` is, in words for the audit; it is what `Signer.sign` gets.

    Raises:
        SigningRefused: nothing that this authority signs.
    """
    if len(message) > MAX_MESSAGE:
        raise SigningRefused(f"{len(message)} bytes to sign are more than any statement", _HINT)
    for kind, profile in _STATEMENTS.items():
        try:
            profile.payload_to_sign(message, limit=MAX_MESSAGE)
        except (SignatureError, EncodingError):
            continue
        return kind
    try:
        found = read_unsigned(message, authority.subject, authority.domain)
    except CertificateRefused as error:
        raise SigningRefused("these bytes are nothing that an authority signs", _HINT) from error
    return f"a certificate of {'the intermediate of ' * found.is_intermediate}{found.name}"
