"""By which name a topic is asked of a publisher, and which name its grants speak of. Pure.

A subscriber of the alias `/remote/hospital/pose` is told addresses by its master; who is there, and
so which of two names counts, only the authenticated peer decides. A gateway of the own domain
serves the topic as `/gateway/hospital/pose`: a name of the own domain, on the wire and in its
grants. To every other peer, a foreign domain's `/gateway` too, the alias is the origin's name, by
the origin's grants. So neither authority's grants count for what the other one's are about.
"""

from ca.certificates import Identity
from ca.domains.aliases import is_alias, origin_of
from ca.domains.served import is_gateway, served_name
from ca.errors import NameRefused


def is_own_gateway(peer: Identity) -> bool:
    """Whether `peer` is a gateway of the own domain; a name with a tail is none."""
    return is_gateway(peer.name) and not peer.is_foreign and not peer.wildcard


def granted_name(peer: Identity, topic: str, own: str = "") -> str:
    """The local name whose grants decide on the subscribed `topic` with the publisher `peer`.

    Args:
        own: the certified name of this node, if it may be a gateway. To a gateway an alias is the
            origin's alone: it could be led to forward what it serves itself.

    Raises:
        NameRefused: a gateway cannot serve it: no alias of a name, or one that is too long.
    """
    served = is_alias(topic) and is_own_gateway(peer) and not is_gateway(own)
    return served_name(topic) if served else topic


def wire_name(peer: Identity, topic: str, own: str = "") -> str:
    """The name by which `peer` is asked for the subscribed `topic`; `own` as of `granted_name`.

    Raises:
        NameRefused: below `/remote`, but no alias; or as `granted_name`.
    """
    return origin_of(granted_name(peer, topic, own))


def possible_names(topic: str) -> tuple[str, ...]:
    """The names of which one must be granted to subscribe to `topic` at all."""
    try:
        return (topic, served_name(topic)) if is_alias(topic) else (topic,)
    except NameRefused:
        return (topic,)
