"""Every way an identity, a key or a signed statement can be refused.

One line says what happened, `hint` says what to do about it. The leaves say whose fault it
is: the file's owner, the peer, or the operator. `HintedError` is the common shape of the three
error roots (`CAError`, `GrantError`, `RossecError`); a command line needs to catch only that.
"""


class HintedError(Exception):
    """A refusal with a remedy.

    Args:
        message: one line, lower case, no full stop: what happened.
        hint: one line: what the reader can do about it. May be empty.
    """

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.hint = hint


class CAError(HintedError):
    """Root of everything `ca` refuses."""


class EncodingError(CAError):
    """Bytes that are not the one deterministic CBOR encoding of an allowed value."""


class SignatureError(CAError):
    """A signed statement whose frame is wrong or whose signature does not verify."""


class NameRefused(CAError):
    """A text that is not an absolute ROS name, a trust domain or a SPIFFE ID."""


class KeyRefused(CAError):
    """A key, or the file it lives in, that may not be used."""


class PathRefused(CAError):
    """A file or directory that somebody else owns or can write, where what it says is believed."""


class PassphraseRefused(KeyRefused):
    """The passphrase is missing, wrong, or given for a key that has none."""


class RequestRefused(CAError):
    """A certificate request that asks for anything but one name for one proven key."""


class IssueRefused(CAError):
    """The authority may not issue this: its own time, the serial or the lifetime forbids it."""


class CertificateRefused(CAError):
    """A certificate that is malformed or not of the one form rossec accepts."""


class CertificateExpired(CertificateRefused):
    """A certificate, or the authority's, whose time is over."""


class CertificateNotYetValid(CertificateRefused):
    """A certificate, or the authority's, whose time has not come."""


class ForeignCertificate(CertificateRefused):
    """A certificate not signed by the authority this node trusts: a stranger's."""


class RevocationRefused(CAError):
    """A revocation list or timestamp that is malformed or does not belong to what is held."""


class ClocksDisagree(RevocationRefused):
    """A timestamp for the list held, and of another time."""


class RollbackRefused(RevocationRefused):
    """A revocation list older than one already seen, or a second one under the same number."""


class Revoked(CAError):
    """The grant or key is on the revocation list."""


class RevocationsStale(CAError):
    """Nobody entitled has confirmed lately that the revocation list held is the newest."""


class CodeRefused(CAError):
    """A text that is not an enrollment code."""


class CodeExpired(CodeRefused):
    """An enrollment code whose time is over."""


class EnrollmentRefused(CAError):
    """An enrollment that may not go on."""


class EnrollmentMessageRefused(EnrollmentRefused):
    """A message that is malformed, or that nobody waits for now."""


class RequestSwapped(EnrollmentRefused):
    """The request that came over the network is not the one the code was made for."""


class OfferRefused(EnrollmentRefused):
    """An offer that is not for this node, or made by somebody who has not seen its code."""


class ConflictingOffer(EnrollmentRefused):
    """A second, different offer that is valid too: somebody else has the code."""


class EnrollmentLocked(EnrollmentRefused):
    """Too many offers by somebody who has not seen the code."""


class EnrollmentExpired(EnrollmentRefused):
    """Nobody finished the enrollment in time."""


class EnrollmentOver(EnrollmentRefused):
    """The enrollment has ended already, or the other side ended it."""


class AcknowledgementRefused(EnrollmentRefused):
    """The node's answer is not signed by its key, or not about this offer."""


class DigitsRefused(EnrollmentRefused):
    """The two sides do not show the same six digits."""


class StoreError(CAError):
    """The authority's database is missing, foreign, damaged, or refuses the entry."""


class RecordUnusable(StoreError):
    """The authority's record cannot be used now: a full disk, another command, or it is damaged."""


class NameCovered(StoreError):
    """A name that a living identity of another key stands for, or that would stand for its name."""


class KeyChanged(StoreError):
    """A name that is alive with one key asks for a certificate with another."""


class ProofRefused(CAError):
    """A Merkle proof that does not show what it should."""


class LogDamaged(StoreError):
    """The authority's log is not what was written, or not what was signed."""


class RequestClosed(StoreError):
    """A request that was denied, answered or forgotten cannot be used for this."""


class NameContested(StoreError):
    """Two keys ask for one name, and nobody has said which of them is right."""


class RenewalRefused(CAError):
    """A renewal that the identity it renews does not prove, or that is not due."""


class TokenRefused(KeyRefused):
    """The token that holds the key is missing, locked, or holds no such key."""


class BackupRefused(CAError):
    """A file that is no backup of an authority, or one that must not be restored here."""
