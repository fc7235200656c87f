"""Who may call which method of a node's slave API. Pure; every kind of node shares it.

Only the master controls a node (attacks N1-N3). An operator with the admin right may shut it down,
one with the graph right may read its state (N4); both present their grants first, with
`rossec.presentGrants`. Any authenticated node may call `requestTopic`: the answer is the same for
every topic, and the topic connection requires the grant (N5). A relay of the own domain learns the
TCPROS port, to which it leads connections from other sites. Every other method is refused (L1).
"""

from collections.abc import Mapping
from typing import Final

from ca.certificates import Identity
from ca.names import is_relay_name
from grants.model import Right
from rossec.errors import CallRefused
from rossec.participant.access_interfaces import HandshakeAccess
from rossec.ros.names import PORTS

OPEN: Final = frozenset({"requestTopic"})
MASTER_ONLY: Final = frozenset({"publisherUpdate", "paramUpdate"})
RELAY_ONLY: Final = frozenset({PORTS})
SLAVE_CALLS: Final[Mapping[str, Right]] = {
    "shutdown": Right.ADMIN,
    "getPid": Right.GRAPH,
    "getBusInfo": Right.GRAPH,
    "getBusStats": Right.GRAPH,
    "getSubscriptions": Right.GRAPH,
    "getPublications": Right.GRAPH,
    "getMasterUri": Right.GRAPH,
    "getName": Right.GRAPH,
    "getUri": Right.GRAPH,
}


def is_relay(peer: Identity) -> bool:
    """Whether `peer` is a relay of the own domain."""
    return is_relay_name(peer.name) and not peer.is_foreign


def check_slave_call(
    method: str,
    peer: Identity,
    node: str,
    presented: bytes | None,
    access: HandshakeAccess,
    now: int,
) -> None:
    """Return if `peer`, with the grants `presented`, may call `method` of the node `node`.

    Raises:
        CallRefused: only the master or a relay may call it, or there is no such method.
        GrantError, CAError: the right is missing, or the peer is revoked.
    """
    access.check_peer(peer, now)
    known = method in MASTER_ONLY or method in SLAVE_CALLS
    if method in OPEN or (known and access.is_master(peer)):
        return
    if method in RELAY_ONLY and is_relay(peer):
        return
    right = SLAVE_CALLS.get(method)
    if right is None:
        raise CallRefused(_reason(method))
    access.authorize(peer, presented, right, node, now)


def _reason(method: str) -> str:
    if method in MASTER_ONLY:
        return f"{method} is for the master alone"
    return f"{method} is for a relay alone" if method in RELAY_ONLY else "no such method"
