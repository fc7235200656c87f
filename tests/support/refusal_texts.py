"""Which check refused, as expressions for `match`: the refusals that have no class of their own."""

from typing import Final

APPROVAL_OUTDATED: Final = (
    "the approval did not come in time|"
    "the record was restored or replaced since it was shown|"
    "this is not waiting for a touch, or not any more|"
    "the touch came too late, or the clock was set"
)
APPROVAL_USED: Final = "this was approved already"
ASSERTION_FORGED: Final = "did not sign this"
ASSERTION_MALFORMED: Final = (
    "the browser sent|"
    "a signature of|"
    "bytes of attestation|"
    "bytes of authenticator data|"
    "authenticator data of another length than it says|"
    "the device's key is not a key of P-256|"
    "an attestation of an unknown form|"
    "the device's key is of an unknown form|"
    "the device's key is not an ES256 key"
)
CODE_EXPIRED: Final = "the code expired|the invitation expired"
CONSOLE_EXTRA_MISSING: Final = "passkeys need the package fido2"
DIGITS_REFUSED: Final = "these are not the digits of the offer of this node"
ISSUE_REFUSED: Final = (
    "a serial is a positive number of 128 bits|"
    "the authority's certificate belongs to another key|"
    "this intermediate may renew identities, not enroll nodes|"
    "this authority may have no intermediates|"
    "s where 1 to|"
    "the authority's own certificate is not valid now"
)
KEY_CHANGED: Final = "has an identity with another key until it expires"
NOT_THE_AUTHORITY: Final = (
    "the peer does not have the key of the authority's node:|"
    ", a node of this site, and not its authority|"
    "another authority answers at the address of the invitation|"
    ", which the invitation does not allow|"
    "the authority's node cannot be verified:|"
    "the peer is not the authority:"
)
NOT_VERIFIED: Final = "the passkey was used without a finger, face or PIN"
OFFER_REFUSED: Final = (
    "an identity for another key|"
    "an identity for another name than the one asked for|"
    "invalid offer:|"
    "an offer with a tag, but the code is a label|"
    "the sender of the offer has not read the code"
)
OTHER_CHALLENGE: Final = (
    "the passkey was not used for|"
    "the passkey signed something else|"
    "this was answered before, or took too long"
)
OTHER_ORIGIN: Final = (
    "the passkey was used at|"
    "the passkey was used inside another page|"
    "the passkey does not belong to|"
    "the phones here belong to"
)
PASSKEY_CLONED: Final = "the counter of the passkey"
PASSKEY_REFUSED: Final = (
    "the device made no passkey|"
    "the name of a phone has 1 to|"
    "is no address of a console|"
    "passkeys cannot belong to|"
    "has no passkeys of"
)
PASSKEY_UNKNOWN: Final = (
    "the assertion is of another passkey|"
    "the passkey of this approval is not known|"
    "this passkey is not registered here, or was removed|"
    "no phone was registered at|"
    "this phone does not wait to be approved, or not any more|"
    "this phone does not wait any more|"
    "there is no phone that could approve this"
)
STATEMENT_REFUSED: Final = (
    "the approval is recorded with another's statement|"
    "a statement of kind|"
    "a field of the statement is not of its form|"
    "a statement is valid for at most|"
    "the payload of the approval is too large|"
    "what was approved is not what was shown|"
    "this is not a statement:|"
    "this is not a statement of a known form|"
    "a statement of an unknown kind"
)
THING_CHANGED: Final = "has a statement in force with|this key is that of|at this border router"
THING_UNKNOWN: Final = "no statement about a thing|there is no thing|no statement about"
