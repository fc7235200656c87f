"""Rights on aliases by what a gateway serves: by the served name, from own grants alone. Pure.

Who holds `subscribe` on `/gateway/LABEL/t` may subscribe `/remote/LABEL/t`, and is told the gateway
and nothing of the origin: neither its publishers nor its nodes. A right at the origin is another
one, and neither stands for the other (docs/spec/gateway.md). It ends with the trust in the domain
that the label stands for. A gateway itself is the origin's receiver: to it an alias is the origin's
alone, or it could forward to itself.
"""

from typing import Final

from ca.domains.aliases import is_alias, split_alias
from ca.domains.served import GATEWAY, is_gateway, is_in_gateway, served_name
from ca.errors import NameRefused
from grants.model import Right
from rossec.master.rights.caller import OWN_DOMAIN, Caller, Refused
from rossec.master.state.registry import Kind, NodeRef, Registry

MAX_GATEWAYS: Final = 64  # registered at one master; each costs a connection


def is_own_gateway(caller: Caller) -> bool:
    """Whether the certified name itself is a gateway's: the name of a visitor is an alias."""
    return is_gateway(caller.name) and not caller.certified and not caller.wildcard


def may_subscribe(caller: Caller, topic: str) -> bool:
    """Whether a caller may subscribe a topic: by its name, or an alias by its served name."""
    return caller.may(Right.SUBSCRIBE, topic) or may_be_served(caller, topic)


def may_be_served(caller: Caller, alias: str) -> bool:
    """Whether own grants let a caller subscribe what a gateway serves of an alias."""
    served = _served(caller, alias)
    return served is not None and caller.may(Right.SUBSCRIBE, served)


def may_see_served(caller: Caller, alias: str) -> bool:
    """Whether a caller may see what a gateway serves of an alias."""
    served = _served(caller, alias)
    return served is not None and caller.may_see(served)


def require_gateway(caller: Caller, name: str) -> None:
    """Raise `Refused` if `name` is offered below `/gateway` by a caller that is no gateway."""
    if is_in_gateway(name) and not is_own_gateway(caller):
        raise Refused(
            f"{name} is below {GATEWAY}, where only gateways of this domain publish and provide "
            "(choose another name)"
        )


def require_place(registry: Registry, topic: str, node: NodeRef) -> None:
    """Raise `Refused` if `node` is one gateway too many that publishes below `/gateway`."""
    if not is_in_gateway(topic):
        return
    if any(map(is_in_gateway, registry.keys_of(node.name, Kind.PUBLISHER))):
        return
    others = (other.name for other in registry.nodes() if other.name != node.name)
    if sum(map(is_gateway, others)) >= MAX_GATEWAYS:
        raise Refused(f"{MAX_GATEWAYS} gateways are registered, the limit of a master")


def _served(caller: Caller, alias: str) -> str | None:
    """The served name that decides for a caller on an alias; None: none does."""
    if not is_alias(alias) or caller.is_foreign or is_own_gateway(caller):
        return None
    try:
        found, served = split_alias(alias), served_name(alias)
    except NameRefused:
        return None
    domain = None if found is None else caller.domain_of(found[0])
    return None if domain is None or domain == OWN_DOMAIN else served
