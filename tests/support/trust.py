"""Sites of `site.Site` that trust each other, or one the other, as the command makes it."""

import secrets
from collections.abc import Sequence

from ca.domains import ForeignDomain, NameRights, open_domains
from ca.names import alias_of
from grants import document
from grants.model import Draft, Permission, Restriction, Right
from tests.support.site import DAY, HOUR, Site


def accept(
    site: Site,
    other: Site,
    label: str = "",
    *,
    admitted: Sequence[str] = ("/**",),
    fresh: int = HOUR,
    lifetime: int = DAY,
    exported: Sequence[NameRights] | None = None,
    imported: Sequence[NameRights] | None = None,
) -> bytes:
    """`site` trusts the domain of `other`, called `label` (default: as it is); the new list."""
    domain = ForeignDomain(
        other.anchor.domain,
        label or other.anchor.domain,
        other.anchor.certificate,
        tuple(admitted),
        fresh,
        site.now() + lifetime,
        None if exported is None else tuple(exported),
        None if imported is None else tuple(imported),
    )
    site.authority.store.domains.accept(domain, site.now())
    return newest(site)


def remove(site: Site, label: str) -> bytes:
    """`site` ends its trust in the domain `label`; the new list."""
    site.authority.store.domains.end(label, "test", site.now())
    return newest(site)


def newest(site: Site) -> bytes:
    """The list of domains that `site` has to have now, signed."""
    site.authority.sign_domains(site.now())
    return site.authority.store.domains.newest_list()


def share(
    origin: Site, holder: Site, name: str, right: Right, pattern: str, restriction: Restriction | None = None
) -> bytes:
    """Give a node of `holder` a right on names of `origin`; the grant is put into its home."""
    label = next(
        each.label
        for each in open_domains(newest(origin), origin.anchor).domains
        if each.domain == holder.anchor.domain
    )
    now = origin.now()
    draft = Draft(
        domain=origin.anchor.domain,
        subject=alias_of(label, name),
        holder=holder.identity(name).thumbprint,
        not_before=now - 60,
        expires=now + DAY,
        cap=now + DAY,
        serial=secrets.token_bytes(16),
        permissions=(Permission(pattern, right, restriction),),
    )
    data = document.sign(origin.authority.signer, draft)
    holder.enroll(name).add_grant(document.grant_id(data), data)
    return data


def carry(site: Site) -> None:
    """Put the newest list of domains into the home of every node, as delivered."""
    data = newest(site)
    for node in (site.root / "nodes").rglob("node.pem"):
        (node.parent / "domains.cose").write_bytes(data)
