"""Two trust domains in memory: what one authority says of the other, and its revocations."""

from secrets import token_bytes
from typing import Any

from cryptography.hazmat.primitives.asymmetric import ec

from ca.certificates import Identity, TrustAnchor
from ca.domains import Anchors, DomainList, ForeignDomain, sign_domains
from ca.keys.signing import KeySigner
from ca.revocation.lists import (
    MAX_AGE,
    RevocationList,
    RevocationTree,
    Timestamp,
    TreeEntries,
    digest,
    sign_list,
    sign_timestamp,
    sign_tree,
)
from ca.revocation.trust_status import Revocations, TrustStatus
from ca.svid import build_request
from grants import document
from grants.model import Draft, Permission, Right
from tests.support.pki import DAY, NOW, Site, new_signer


def foreign(site: Site, label: str = "hospital", **changes: Any) -> ForeignDomain:
    """An entry of a list for all nodes of `site`, fresh for an hour, for ten days."""
    fields: dict[str, Any] = {"admitted": ("/rounds/*", "/master"), "fresh": 3600, "until": NOW + 10 * DAY}
    return ForeignDomain(site.anchor.domain, label, site.root, **(fields | changes))


def domains(
    home: Site,
    *entries: ForeignDomain,
    seq: int = 1,
    masters: tuple[bytes, ...] = (),
    life: int = 30 * DAY,
    issued: int = NOW,
) -> bytes:
    """A list, signed by `home`."""
    found = tuple(sorted(entries, key=lambda each: each.domain))
    listed = DomainList(1, seq, issued, issued + life, found, tuple(sorted(masters)))
    return sign_domains(KeySigner(home.key), listed, home.anchor.domain)


def alone(anchor: TrustAnchor, own: Revocations) -> TrustStatus:
    """What a node knows that has no list of foreign domains."""
    return TrustStatus(Anchors(anchor), own)


def grant(
    signed_by: Site,
    holder: bytes,
    right: Right,
    pattern: str,
    *,
    subject: str = "/somebody",
    domain: str = "",
    **changes: Any,
) -> bytes:
    """A grant for a day, signed by one site; `domain` is by default its own."""
    fields: dict[str, Any] = {
        "not_before": NOW - 60,
        "expires": NOW + DAY,
        "cap": NOW + DAY,
        "serial": token_bytes(16),
        "permissions": (Permission(pattern, right),),
    }
    draft = Draft(
        domain=domain or signed_by.anchor.domain, subject=subject, holder=holder, **(fields | changes)
    )
    return document.sign(KeySigner(signed_by.key), draft)


class SomeNode:
    """A node of a site, with its key."""

    def __init__(self, site: Site, name: str, now: int = NOW) -> None:
        self.signer = new_signer()
        csr = build_request(self.signer, site.anchor.domain, name)
        self.leaf = site.authority.issue(csr, now=now, serial=9)
        self.identity: Identity = site.anchor.verify((self.leaf,), now)

    @property
    def key(self) -> ec.EllipticCurvePublicKey:
        return self.signer.public_key

    def stamp(self, revocations: bytes, seq: int = 1, issued: int = NOW, max_age: int = MAX_AGE) -> bytes:
        """Its word, as a master, that a list is the newest."""
        return sign_timestamp(self.signer, Timestamp(seq, digest(revocations), issued, max_age))


def revoked(site: Site, *entries: bytes, seq: int = 1, issued: int = NOW) -> bytes:
    """A revocation list of `site`."""
    return sign_list(
        KeySigner(site.key), RevocationList(1, seq, issued, issued + 30 * DAY, frozenset(entries))
    )


def revoked_tree(site: Site, *entries: bytes, seq: int = 1) -> tuple[bytes, TreeEntries]:
    """A tree of revocations of `site`, and its entries."""
    leaves = TreeEntries(entries)
    size, root = leaves.size_and_root
    tree = RevocationTree(1, seq, NOW, NOW + 30 * DAY, size, root)
    return sign_tree(KeySigner(site.key), tree), leaves


class Pair:
    """A home that has listed a hospital, and what a node of the home knows of both."""

    def __init__(self, **changes: Any) -> None:
        self.home, self.hospital = Site.create("home"), Site.create("hospital.example")
        self.own_master = SomeNode(self.home, "/master")
        self.master = SomeNode(self.hospital, "/master")
        self.robot = SomeNode(self.hospital, "/rounds/robot3")
        self.own = Revocations(self.home.anchor.public_key)
        self.anchors = Anchors(self.home.anchor)
        self.anchors.update(domains(self.home, foreign(self.hospital, **changes)))
        self.trust_status = TrustStatus(self.anchors, self.own)

    def peer(self, member: SomeNode | None = None) -> Identity:
        """A node of the hospital, as this side sees it: `/rounds/robot3` by default."""
        return self.anchors.verify(((member or self.robot).leaf,), NOW)

    def confirm_own(self, *entries: bytes, seq: int = 1, now: int = NOW) -> None:
        """The own list, and a word of the own master that it is the newest."""
        data = revoked(self.home, *entries, seq=seq)
        self.own.update(data, now)
        self.own.confirm(Timestamp(seq, digest(data), now, MAX_AGE), now)

    def confirm_foreign(self, *entries: bytes, seq: int = 1, now: int = NOW) -> frozenset[bytes]:
        """The hospital's list, and its master's word."""
        data = revoked(self.hospital, *entries, seq=seq)
        stamp = self.master.stamp(data, seq, issued=now)
        domain = self.hospital.anchor.domain
        return self.trust_status.take_foreign(domain, data, stamp, [self.master.leaf], now)
