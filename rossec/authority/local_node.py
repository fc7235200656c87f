"""A node of the authority's own host: enrolled in place, without a request to carry."""

from ca.authority import LIFETIME
from rossec.authority.signing import SigningAuthority
from rossec.errors import ConfigurationError
from rossec.home import NodeHome


def check_new(node: NodeHome) -> None:
    """Return if `node` has nothing in this ROSSEC_HOME yet.

    Raises:
        ConfigurationError: it has; nothing of it is replaced.
    """
    if node.path.exists():
        raise ConfigurationError(
            f"{node.name} is in {node.path} already",
            "move that away, or enroll it as every other node: rossec node request",
        )


def enroll_here(authority: SigningAuthority, node: NodeHome, now: int) -> int:
    """Make the key of `node`, sign its identity and install it; returns when it expires.

    Raises:
        ConfigurationError: as `check_new`.
        HintedError: as `SigningAuthority.issue`.
    """
    check_new(node)
    node.create_request(authority.domain)
    bundle = authority.issue(node.request(), now, LIFETIME, source="this host")
    return node.install(bundle, now).not_after
