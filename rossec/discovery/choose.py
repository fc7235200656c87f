"""`ROS_MASTER_URI=discover:`: the master is found when the program starts, and does not change."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from ca.certificates import TrustAnchor
from ca.errors import CAError
from ca.names import check_name
from rossec import clock
from rossec.discovery.candidates import Candidate
from rossec.discovery.finder import PATIENCE, SETTLE, find
from rossec.environment import OWN_MASTER, own_home, own_master
from rossec.errors import ConfigurationError, MasterNotFound
from rossec.home import NodeHome
from rossec.saved_revocations import saved_revocations

VARIABLE: Final = "ROS_MASTER_URI"
DISCOVER: Final = "discover:"


async def discover_master(
    environ: Mapping[str, str], identity: str | NodeHome | None, settle: float = SETTLE
) -> dict[str, str]:
    """`environ`, with the URI of the best link to its master where discovery was asked for.

    Args:
        identity: the node that will use it, or its directory, whose authority certifies the master;
            None: any node of this home, if all of them trust the same authority.
        settle: seconds to measure the links, once a master is found.

    Raises:
        ConfigurationError, MasterNotFound: no trust anchor, or no master found.
    """
    if environ.get(VARIABLE) != DISCOVER:
        return dict(environ)
    wanted = own_master(environ)
    found = await masters(own_home(environ), identity, settle=settle)
    best = next((one for one in found if one.name == wanted), None)
    if best is None:
        others = ", ".join(sorted({one.name for one in found}))
        raise MasterNotFound(
            f"{wanted} does not announce itself, but {others}",
            f"to work with another master set {OWN_MASTER} to its name",
        )
    return {**environ, VARIABLE: uri_of(best)}


async def masters(
    home: Path,
    identity: str | NodeHome | None,
    patience: float = PATIENCE,
    settle: float = SETTLE,
) -> list[Candidate]:
    """The masters that a node of this home would trust, the best link first.

    Raises:
        ConfigurationError, MasterNotFound: no trust anchor, or no master found.
    """
    anchor, revoked = trusted(home, identity)
    return await find(anchor, revoked, patience=patience, settle=settle)


def uri_of(candidate: Candidate) -> str:
    """Where a candidate was reached, as ROS_MASTER_URI has it."""
    host, port = candidate.endpoint or candidate.endpoints[0]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def trusted(home: Path, identity: str | NodeHome | None) -> tuple[TrustAnchor, frozenset[bytes]]:
    """The trust anchor of the nodes of this home, and what they know to be revoked.

    Raises:
        ConfigurationError: no node is enrolled, or they trust different authorities.
    """
    nodes = _named(home, identity)
    anchors = {anchor.thumbprint: anchor for anchor in map(_anchor, nodes)}
    if not anchors:
        raise ConfigurationError(
            "no node is enrolled here, so no master can be trusted",
            "enroll one first: rossec node request NAME",
        )
    if len(anchors) > 1:
        raise ConfigurationError(
            "the nodes enrolled here trust different authorities",
            "name the one to find a master for, with --as NAME",
        )
    (anchor,) = anchors.values()
    return anchor, frozenset().union(*(_revoked(node, anchor) for node in nodes))


def _named(home: Path, identity: str | NodeHome | None) -> list[NodeHome]:
    match identity:
        case None:
            return _nodes(home)
        case str():
            return [NodeHome.find(home, check_name(identity))]
        case _:
            return [identity]


def _nodes(home: Path) -> list[NodeHome]:
    found = sorted((home / "nodes").glob("*/ca.pem"))
    return [NodeHome(path.parent, "/" + path.parent.name.replace(".", "/")) for path in found]


def _anchor(node: NodeHome) -> TrustAnchor:
    try:
        return node.anchor()
    except (CAError, ValueError) as error:  # the error must name the file
        raise ConfigurationError(
            f"{node.path / 'ca.pem'}: {error}", "enroll that node anew, or move its directory away"
        ) from error


def _revoked(node: NodeHome, anchor: TrustAnchor) -> frozenset[bytes]:
    """The entries of the newest list, even if stale: the handshake requires a fresh one."""
    return saved_revocations(node, anchor, clock.now()).entries
