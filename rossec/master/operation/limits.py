"""Limits on what one peer may use, each checked before memory is allocated for the peer."""

from dataclasses import dataclass

from rossec.master.state.parameters import SIZE_LIMIT
from rossec.master.state.registry import NODES_LIMIT
from rossec.net.bounds import UNSHOWN_BODY
from rossec.ros.xmlrpc import BODY_LIMIT


@dataclass(frozen=True)
class MasterLimits:
    """The limits; the defaults are for a site of a thousand nodes.

    Args:
        body: bytes of one call, and of one answer.
        parameters: bytes of all parameters together.
        connections_per_identity: open at a time; a node has two, and one for each watched graph.
        connections_per_domain: open at a time, of all nodes of one foreign domain.
        connections_without_right: of those of one identity or foreign domain, as long as no grant
            gives its nodes any right here.
        body_without_right: bytes of one call of such a node, but for calls with signed statements.
        nodes_per_identity: registered at a time; only a wildcard identity can have several.
        handshake_seconds: from the first byte of a connection to an authenticated peer.
        request_seconds: from the first byte of a call to its last.
        idle_seconds: between two calls on one connection; nodes call every ten seconds.
        unfinished_per_address, unfinished: handshakes at a time.
    """

    body: int = BODY_LIMIT
    parameters: int = SIZE_LIMIT
    connections_per_identity: int = 32
    connections_per_domain: int = 256
    connections_without_right: int = 16
    body_without_right: int = UNSHOWN_BODY
    nodes_per_identity: int = NODES_LIMIT
    handshake_seconds: int = 5
    request_seconds: int = 10
    idle_seconds: int = 120
    unfinished_per_address: int = 128
    unfinished: int = 512
