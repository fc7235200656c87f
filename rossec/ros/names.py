"""ROS names as programs write them: relative, private and global, resolved against a node's name.

The syntax of a complete name is `ca.names`'s; here is only the resolution, equal to
`rosgraph.names` so that stock callers get the names they expect. Command line and environment are
read in `rossec.ros.settings`.
"""

from collections.abc import Iterator, Mapping
from typing import Final

from ca import names
from ca.names import check_name

SEPARATOR: Final = "/"
PRIVATE: Final = "~"
ANY_TYPE: Final = "*"
MASTER: Final = names.MASTER  # the name a domain's first master is certified for
AUTHORITY: Final = "/ca"  # the name the authority's own node is certified for
PRESENT_GRANTS: Final = "rossec.presentGrants"  # to the master, and to the slave API of a node
REVOCATION_UPDATE: Final = "rossec.revocationUpdate"  # from the master to a node
DOMAINS: Final = "rossec.domains"  # to the master
UPDATE_DOMAINS: Final = "rossec.updateDomains"
FOREIGN_REVOCATIONS: Final = "rossec.foreignRevocations"
FOREIGN_PROOFS: Final = "rossec.foreignRevocationProofs"
RENEW_IDENTITY: Final = "rossec.renewIdentity"
WATCH_RENEWALS: Final = "rossec.watchRenewals"  # to the master, from the authority's service
SETTLE_RENEWALS: Final = "rossec.settleRenewals"
RELAY_DOORS: Final = "rossec.relayDoors"  # to the master, from a relay
RELAY_TARGET: Final = "rossec.relayTarget"
PORTS: Final = "rossec.ports"  # from a relay to a node
DOMAINS_UPDATE: Final = "rossec.domainsUpdate"  # from the master to a node
FOREIGN_UPDATE: Final = "rossec.foreignRevocationUpdate"
# What the master pushes that others signed: taken also while revocations are stale.
SIGNED_UPDATES: Final = frozenset({REVOCATION_UPDATE, DOMAINS_UPDATE, FOREIGN_UPDATE})


def canonical(name: str) -> str:
    """`name` without doubled and trailing slashes; a leading one stays."""
    if not name or name == SEPARATOR:
        return name
    if name[-1] != SEPARATOR and "//" not in name:  # the usual case
        return name
    lead = SEPARATOR if name.startswith(SEPARATOR) else ""
    return lead + SEPARATOR.join(part for part in name.split(SEPARATOR) if part)


def namespace(name: str) -> str:
    """The namespace a node lives in, with a trailing slash: `/robot1/camera` -> `/robot1/`."""
    head, _, _ = name.removesuffix(SEPARATOR).rpartition(SEPARATOR)
    return head + SEPARATOR


def join(prefix: str, name: str) -> str:
    """`name` under `prefix`; a private or global name is returned as it is."""
    if not prefix or name.startswith((PRIVATE, SEPARATOR)):
        return name
    return prefix.removesuffix(SEPARATOR) + SEPARATOR + name


def resolve(name: str, node: str, remappings: Mapping[str, str] | None = None) -> str:
    """The global form of `name` for the node `node`. The result's syntax is not checked.

    The empty name is the node's namespace. `remappings` maps resolved names to resolved names.
    """
    if not name:
        return namespace(node)
    name = canonical(name)
    if name.startswith(PRIVATE):
        resolved = canonical(node + SEPARATOR + name[1:])
    elif name.startswith(SEPARATOR):
        resolved = name
    else:
        resolved = namespace(node) + name
    return resolved if remappings is None else remappings.get(resolved, resolved)


def search_paths(space: str, key: str) -> Iterator[tuple[str, str]]:
    """As searchParam, from `space`, innermost first: what must exist, and what is then found."""
    above = [part for part in space.split(SEPARATOR) if part]
    first, *_ = key.split(SEPARATOR)
    for length in range(len(above), -1, -1):
        prefix = SEPARATOR + SEPARATOR.join(above[:length])
        yield join(prefix, first), join(prefix, key)


def resolve_checked(name: str, node: str, remappings: Mapping[str, str] | None = None) -> str:
    """Like `resolve`, for names that must be well-formed.

    Raises:
        NameRefused: the result is not an absolute ROS name.
    """
    return check_name(resolve(name, node, remappings))
