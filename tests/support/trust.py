"""Sites of `site.Site` that trust each other, or one the other, as the command makes it."""

from collections.abc import Sequence

from ca.domains.lists import ForeignDomain, NameRights
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
        other.anchor.domain, label or other.anchor.domain, other.anchor.certificate,
        tuple(admitted), fresh, site.now() + lifetime,
        None if exported is None else tuple(exported),
        None if imported is None else tuple(imported),
    )  # fmt: skip
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
