"""The rows of the authority's record, as values."""

from typing import NamedTuple


class CertificateRow(NamedTuple):
    """One identity that was signed; times in seconds, inclusive."""

    serial: int
    name: str
    thumbprint: bytes
    der: bytes
    not_before: int
    not_after: int


class GrantRow(NamedTuple):
    """One grant that was signed."""

    id: bytes
    name: str
    data: bytes
    not_before: int
    expires: int


class RevocationRow(NamedTuple):
    """One grant id or key thumbprint that was revoked, why and when."""

    entry: bytes
    reason: str
    at: int
