"""The rows of the authority's record, as values."""

from typing import Final, NamedTuple

from ca import names, svid

INTERMEDIATE: Final = "intermediate/"  # prefix of the key; not a prefix of any node name


class CertificateRow(NamedTuple):
    """One signed identity; times in seconds, inclusive."""

    serial: int
    name: str
    thumbprint: bytes
    der: bytes
    not_before: int
    not_after: int

    @property
    def wildcard(self) -> bool:
        """Whether it also covers anonymous nodes."""
        return svid.is_wildcard(self.der)

    def covers(self, name: str) -> bool:
        """Whether its holder may use `name`."""
        related = names.covers(self.name, name, wildcard=True)
        return related and (self.name == name or self.wildcard)

    def is_signed_by(self, issuer: "CertificateRow") -> bool:
        """Whether the key of `issuer`, an intermediate, signed it."""
        by = svid.parse(issuer.der)
        return svid.is_signed_by(svid.parse(self.der), svid.subject(by), svid.key_of(by))


class GrantRow(NamedTuple):
    """One signed grant."""

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
