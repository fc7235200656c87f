"""The TCPROS handshake of a service inside the channel, both sides, as pure functions on fields.

As for topics: names come from certificates, rights from the grants presented, and the peer is
authorized before this node looks up the service. Probes (`probe=1`) need the right as well (N6).
Access gets the local name of a service, the header the origin's.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from ca.certificates import Identity
from ca.domains.aliases import origin_of, shown
from grants.decision import Decision
from grants.model import Right
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.access import FIELD
from rossec.participant.access_interfaces import HandshakeAccess
from rossec.participant.header_fields import Fields, check_caller, refuse_on_wire, text
from rossec.ros.names import ANY_TYPE


@dataclass(frozen=True)
class ExpectedService:
    """Name and md5sum of a service type; `*` matches any."""

    type_name: str
    md5sum: str


ANY: ExpectedService = ExpectedService(ANY_TYPE, ANY_TYPE)


def client_header(
    caller: str,
    service: str,
    kind: ExpectedService,
    access: HandshakeAccess,
    now: int,
    *,
    persistent: bool = False,
    probe: bool = False,
) -> Fields:
    """Fields a client sends first; they prove its right to call."""
    flags = {"persistent": persistent, "probe": probe}
    return {
        "callerid": caller.encode(),
        "service": origin_of(service).encode(),
        "type": kind.type_name.encode(),
        "md5sum": kind.md5sum.encode(),
        **{key: b"1" for key, wanted in flags.items() if wanted},
        **caller_proof(service, access, now),
    }


def server_header(
    caller: str, service: str, kind: ExpectedService, access: HandshakeAccess, now: int
) -> Fields:
    """Fields a server answers with; they prove its right to provide."""
    return {
        "callerid": caller.encode(),
        "service": service.encode(),
        "type": kind.type_name.encode(),
        "md5sum": kind.md5sum.encode(),
        "request_type": f"{kind.type_name}Request".encode(),
        "response_type": f"{kind.type_name}Response".encode(),
        **provider_proof(service, access, now),
    }


def caller_proof(service: str, access: HandshakeAccess, now: int) -> Fields:
    """The field a client adds to its header; it proves the right to call."""
    return {FIELD: access.present(Right.CALL, service, now)}


def provider_proof(service: str, access: HandshakeAccess, now: int) -> Fields:
    """The field a server adds to its answer; it proves the right to provide."""
    return {FIELD: access.present(Right.PROVIDE, service, now)}


def requested_service(fields: Mapping[str, bytes]) -> str:
    """Service a connecting client asks for.

    Raises:
        ConnectionHeaderRefused: no service, a name that is not text, or an alias.
    """
    return refuse_on_wire(text(fields, "service"))


def admit_caller(
    fields: Mapping[str, bytes], peer: Identity, access: HandshakeAccess, now: int
) -> Decision:
    """Decide on a client from its header, before anything about the service is looked up.

    A decision with restrictions must be applied to each request, or refused with
    `Decision.require_unrestricted`: the header of a service carries no definition to apply them by.

    Raises:
        CallerMismatch, ConnectionHeaderRefused: the header does not fit the peer.
        GrantError, CAError: the peer may not call.
    """
    check_caller(fields, peer)
    return access.authorize(peer, fields.get(FIELD), Right.CALL, requested_service(fields), now)


def admit_provider(
    fields: Mapping[str, bytes], peer: Identity, service: str, access: HandshakeAccess, now: int
) -> Decision:
    """Decide on a server from the header it answered with.

    Raises:
        CallerMismatch, ConnectionHeaderRefused: it refuses, or its callerid does not match.
        GrantError, CAError: the peer may not provide.
    """
    if "error" in fields:
        raise ConnectionHeaderRefused(f"{shown(peer.name)} refuses: {text(fields, 'error')}")
    check_caller(fields, peer)
    return access.authorize(peer, fields.get(FIELD), Right.PROVIDE, service, now)


def check_md5(fields: Mapping[str, bytes], service: str, md5sum: str) -> None:
    """Compare the md5sums as ROS does, which ignores the type's name; `*` matches any.

    Raises:
        ConnectionHeaderRefused: the two sides have different definitions.
    """
    peer_md5sum = text(fields, "md5sum")
    if peer_md5sum != md5sum and ANY_TYPE not in {peer_md5sum, md5sum}:
        raise ConnectionHeaderRefused(
            f"{shown(service)} has the md5sum {md5sum} here, {peer_md5sum} at the peer",
            "both sides need the same version of the service's package",
        )


def is_set(fields: Mapping[str, bytes], flag: str) -> bool:
    """Whether the header sets `persistent` or `probe`; stock clients write 1 or true."""
    return fields.get(flag, b"").lower() in {b"1", b"true"}
