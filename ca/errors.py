"""The errors of `ca`: why an identity, a key or a signed statement is refused.

The message says what happened, `hint` what to do about it. `HintedError` is the common base of the
three error roots (`CAError`, `GrantError`, `RossecError`); a command line catches only that.
"""

from copy import copy
from typing import Self


class HintedError(Exception):
    """A refusal: one line of what happened, and one, perhaps empty, of what the reader can do about it."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.hint = hint

    def bare(self) -> Self:
        """The same error without traceback, cause and context, for whoever keeps one."""
        # Those refer to frames, and so to everything that was received when it was raised.
        return copy(self)


class CAError(HintedError):
    """Root of everything `ca` refuses."""


class EncodingError(CAError):
    """Bytes that are not the one deterministic CBOR encoding of an allowed value."""


class SignatureError(CAError):
    """A signed statement whose frame is wrong or whose signature does not verify."""


class NameRefused(CAError):
    """A text that is not an absolute ROS name, a trust domain or a SPIFFE ID."""


class PatternRefused(NameRefused):
    """A pattern that is not a name in which whole segments may be wildcards."""


class KeyRefused(CAError):
    """A key, or a key file, that may not be used."""


class PathRefused(CAError):
    """A file or directory that another user owns or can write, where it must be trusted."""


class PassphraseRefused(KeyRefused):
    """The passphrase is missing, wrong, or given for a key that has none."""


class RequestRefused(CAError):
    """A certificate request that asks for anything but one name for one proven key."""


class CertificateRefused(CAError):
    """A certificate that is malformed or not of the one form rossec accepts."""


class CertificateExpired(CertificateRefused):
    """A certificate, or the authority's, that has expired."""


class CertificateNotYetValid(CertificateRefused):
    """A certificate, or the authority's, that is not valid yet."""


class ForeignCertificate(CertificateRefused):
    """A certificate that was not signed by the authority this node trusts."""


class RevocationRefused(CAError):
    """A revocation list or timestamp that is malformed, older than one seen, or not for the current list."""


class ClocksDisagree(RevocationRefused):
    """A timestamp for the current list that is too old, or in the future."""


class DomainsRefused(CAError):
    """A list of foreign domains that is malformed, forged, or older than one already seen."""


class BundleRefused(CAError):
    """A domain's bundle that is malformed, forged or expired, or not the one that is meant."""


class ThingRefused(CAError):
    """A thing's credential, or a statement about a thing, that is malformed or forged."""


class ThingOutdated(ThingRefused):
    """A statement about a thing that has expired, or is not valid yet."""


class NotAdmitted(CertificateRefused):
    """A node of a foreign domain that is not listed, not any more, or not with this name."""


class Revoked(CAError):
    """The grant or key is on the revocation list."""


class RevocationsStale(CAError):
    """The master has not confirmed recently that the current revocation list is the newest."""


class CodeRefused(CAError):
    """A text that is not an enrollment code."""


class EnrollmentRefused(CAError):
    """An enrollment that cannot continue."""


class EnrollmentMessageRefused(EnrollmentRefused):
    """A message that is malformed, or unexpected in this state."""


class RequestSwapped(EnrollmentRefused):
    """The received request is not the one the code was made for."""


class ConflictingOffer(EnrollmentRefused):
    """A second, different, valid offer: another party has the code."""


class EnrollmentExpired(EnrollmentRefused):
    """The enrollment was not finished in time."""


class EnrollmentOver(EnrollmentRefused):
    """The enrollment has ended: before, by the other side, or by too many offers made without the code."""


class JoinRefused(EnrollmentRefused):
    """The authority lets no node join by this invitation: unknown, ended, used up, or not for this one."""


class JoinBusy(JoinRefused):
    """The authority decides nothing now: the same request may be sent again soon."""


class JoinWaiting(EnrollmentRefused):
    """The authority is locked, or a person has to approve: the same request may be sent again."""


class StoreError(CAError):
    """The authority's database is missing, foreign, damaged, or refuses the entry: a request was answered."""


class RecordUnusable(StoreError):
    """The authority's record cannot be used now: a full disk, another command, or it is damaged."""


class DomainUnknown(StoreError):
    """No foreign domain is trusted under this label."""


class NameCovered(StoreError):
    """A name covered by a valid identity with another key, or that would cover its name."""


class LogDamaged(StoreError):
    """The authority's log differs from what was written or signed."""


class TooManyRequests(StoreError):
    """So many requests wait for an answer that no other is recorded."""


class TokenRefused(KeyRefused):
    """The token that holds the key is missing, locked, or holds no such key."""


class ApprovalRefused(CAError):
    """Root of why a passkey's approval, or the passkey, is refused."""


class ApprovalOver(ApprovalRefused):
    """An approval that is unknown, or was carried out or ended already."""
