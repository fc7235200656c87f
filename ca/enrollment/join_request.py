"""A request to join, as it reaches the authority's key, and its proof.

The process that has the key gets it from one that talks to strangers. So its octets have a fixed
layout, which is cut and not parsed, and nothing in it is looked at before the proof is verified
over its hashes: whoever does not know an invitation's secret reaches no parser.
"""

from dataclasses import dataclass
from hashlib import sha256
from typing import Final, Self

from ca.enrollment import join_transcript
from ca.enrollment.invitation import ID_SIZE, public_key
from ca.errors import EnrollmentMessageRefused
from ca.names import MAX_NAME
from ca.requests import MAX_REQUEST

_HASH: Final = 32
_SIZES: Final = ID_SIZE + _HASH  # where those of proof, name and metadata are
_HEAD: Final = _SIZES + 5
MAX_METADATA: Final = join_transcript.MAX_METADATA
MAX_SIZE: Final = _HEAD + join_transcript.MAX_STATEMENT + MAX_NAME + MAX_METADATA + MAX_REQUEST


@dataclass(frozen=True)
class JoinRequest:
    """A node's request to join: the invitation's id, the transcript, what is asked, the proof.

    `csr` is DER of at most 2048 octets, `name` is ASCII, `metadata` are empty if the node chose its
    name itself; everything is untrusted until `verify`.
    """

    invitation: bytes
    transcript: bytes
    name: str
    csr: bytes
    proof: bytes
    metadata: bytes = b""

    def __post_init__(self) -> None:
        exact = len(self.invitation) == ID_SIZE and len(self.transcript) == _HASH
        fits = (
            self.name.isascii()
            and len(self.name) <= MAX_NAME
            and len(self.csr) <= MAX_REQUEST
            and len(self.proof) <= join_transcript.MAX_STATEMENT
            and len(self.metadata) <= MAX_METADATA
        )
        if not exact or not fits:
            raise EnrollmentMessageRefused("the parts of a request to join have wrong sizes")

    @property
    def digest(self) -> bytes:
        """The SHA-256 of `csr`, by which the record knows it."""
        return sha256(self.csr).digest()

    def to_bytes(self) -> bytes:
        """The request for the process that has the key."""
        name, parts = self.name.encode(), (self.invitation, self.transcript)
        sizes = len(self.proof).to_bytes(2) + len(name).to_bytes(1) + len(self.metadata).to_bytes(2)
        return b"".join((*parts, sizes, self.proof, name, self.metadata, self.csr))

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The request that `to_bytes` wrote.

        Raises:
            EnrollmentMessageRefused: too long, too short, or a part is too long.
        """
        name = _HEAD + int.from_bytes(data[_SIZES : _SIZES + 2])
        metadata = name + int.from_bytes(data[_SIZES + 2 : _SIZES + 3])
        csr = metadata + int.from_bytes(data[_SIZES + 3 : _HEAD])
        if not csr <= len(data) <= MAX_SIZE or not data[name:metadata].isascii():
            raise EnrollmentMessageRefused("a request to join of a wrong size")
        return cls(
            data[:ID_SIZE], data[ID_SIZE:_SIZES], data[name:metadata].decode(), data[csr:],
            data[_HEAD:name], data[metadata:csr],
        )  # fmt: skip

    def verify(self, point: bytes) -> None:
        """Return if it was made with the secret of the invitation whose key is `point`.

        Raises:
            JoinRefused: it was not.
        """
        key = public_key(point)
        join_transcript.check_proof(
            self.proof, key, self.transcript, self.csr, self.name, self.metadata
        )
