"""A claim of a node that joins, as it reaches the authority's key: its metadata, and its proof.

As with a request to join (`join_request`), its octets are cut and not parsed, and the proof is
verified over hashes. The metadata are parsed by no process that has a key.
"""

from dataclasses import dataclass
from typing import Final, Self

from ca.enrollment import join_transcript
from ca.enrollment.invitation import ID_SIZE, public_key
from ca.enrollment.join_transcript import MAX_METADATA, MAX_STATEMENT
from ca.errors import EnrollmentMessageRefused

_HASH: Final = 32
_HEAD: Final = ID_SIZE + _HASH + 2  # and the size of the proof
MAX_SIZE: Final = _HEAD + MAX_STATEMENT + MAX_METADATA


@dataclass(frozen=True)
class JoinClaim:
    """The invitation's id, the transcript, metadata, and the proof; untrusted until `verify`."""

    invitation: bytes
    transcript: bytes
    metadata: bytes
    proof: bytes

    def __post_init__(self) -> None:
        exact = len(self.invitation) == ID_SIZE and len(self.transcript) == _HASH
        fits = 0 < len(self.metadata) <= MAX_METADATA and len(self.proof) <= MAX_STATEMENT
        if not exact or not fits:
            raise EnrollmentMessageRefused("the parts of a claim have wrong sizes")

    def to_bytes(self) -> bytes:
        """The claim for the process that has the key."""
        size = len(self.proof).to_bytes(2)
        return b"".join((self.invitation, self.transcript, size, self.proof, self.metadata))

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The claim that `to_bytes` wrote.

        Raises:
            EnrollmentMessageRefused: too long, too short, or a part is too long.
        """
        metadata = _HEAD + int.from_bytes(data[_HEAD - 2 : _HEAD])
        if not metadata < len(data) <= MAX_SIZE:
            raise EnrollmentMessageRefused("a claim of a wrong size")
        transcript = data[ID_SIZE : ID_SIZE + _HASH]
        return cls(data[:ID_SIZE], transcript, data[metadata:], data[_HEAD:metadata])

    def verify(self, point: bytes) -> None:
        """Return if it was made with the secret of the invitation whose key is `point`.

        Raises:
            JoinRefused: it was not.
        """
        join_transcript.check_claim(self.proof, public_key(point), self.transcript, self.metadata)
