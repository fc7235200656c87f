"""The TCPROS handshake of a service inside the channel, both sides, as pure functions on fields.

As for topics: names come from certificates, rights from the grants shown, and authorization
precedes any look at what this node offers. Probes (`probe=1`) need the right as well (attack N6).
"""

from collections.abc import Mapping

from ca.certificates import Identity
from grants.decision import Decision
from grants.model import Right
from rossec.errors import TopicRefused
from rossec.node.access import FIELD, Access
from rossec.node.fields import Fields, check_caller, text


def caller_proof(service: str, access: Access, now: int) -> Fields:
    """The field a client adds to its header; it proves the right to call."""
    return {FIELD: access.present(Right.CALL, service, now)}


def provider_proof(service: str, access: Access, now: int) -> Fields:
    """The field a server adds to its answer; it proves the right to provide."""
    return {FIELD: access.present(Right.PROVIDE, service, now)}


def requested_service(fields: Mapping[str, bytes]) -> str:
    """Service a connecting client asks for.

    Raises:
        TopicRefused: no service, or a name that is not text.
    """
    return text(fields, "service")


def admit_caller(fields: Mapping[str, bytes], peer: Identity, access: Access, now: int) -> Decision:
    """Decide on a client from its header, before anything about the service is looked up.

    A decision with restrictions must be applied to each request, or refused with
    `Decision.require_unrestricted`: the header of a service carries no definition to apply them by.

    Raises:
        CallerMismatch, TopicRefused: the header does not fit the peer.
        GrantError, CAError: the peer may not call.
    """
    check_caller(fields, peer)
    return access.authorize(peer, fields.get(FIELD), Right.CALL, requested_service(fields), now)


def admit_provider(
    fields: Mapping[str, bytes], peer: Identity, service: str, access: Access, now: int
) -> Decision:
    """Decide on a server from the header it answered with.

    Raises:
        CallerMismatch, TopicRefused: it refuses, or calls itself by another name.
        GrantError, CAError: the peer may not provide.
    """
    if "error" in fields:
        raise TopicRefused(f"{peer.name} refuses: {text(fields, 'error')}")
    check_caller(fields, peer)
    return access.authorize(peer, fields.get(FIELD), Right.PROVIDE, service, now)
