"""Who may call which method of a node's slave API. Pure; every kind of node shares it.

Only the master controls a node (attacks N1-N3). An operator with the admin right may shut it down,
one with the graph right may read its state (N4); both present their grants first, with
`rossec.presentGrants`. Any authenticated node may call `requestTopic`: the answer is the same for
every topic, and the topic connection requires the grant (N5). Every other method is refused (L1).
"""

from collections.abc import Mapping
from typing import Final

from ca.certificates import Identity
from grants.model import Right
from rossec.errors import CallRefused
from rossec.participant.access_interfaces import HandshakeAccess

OPEN: Final = frozenset({"requestTopic"})
MASTER_ONLY: Final = frozenset({"publisherUpdate", "paramUpdate"})
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
        CallRefused: only the master may call it, or there is no such method.
        GrantError, CAError: the right is missing, or the peer is revoked.
    """
    access.check_peer(peer, now)
    known = method in MASTER_ONLY or method in SLAVE_CALLS
    if method in OPEN or (known and access.is_master(peer)):
        return
    right = SLAVE_CALLS.get(method)
    if right is None:
        known = method in MASTER_ONLY
        raise CallRefused(f"{method} is for the master alone" if known else "no such method")
    access.authorize(peer, presented, right, node, now)
