"""An attacker: the secure protocol step by step, with any identity and grants."""

import contextlib
import dataclasses
import logging
import secrets
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import pytest

from ca.encoding import encode
from ca.errors import HintedError
from ca.keys.signing import Signer
from grants import document
from grants.model import Draft, Permission, Right
from rossec.channel.edhoc.credentials import Credentials
from rossec.demo.intruder import UnverifiedPeer, accept_any
from rossec.errors import ChannelError
from rossec.net.aio import SecureStream, WireProtocol, connect
from rossec.net.rpc.calls import RpcClient
from rossec.participant.access import FIELD
from rossec.ros import tcpros
from tests.support.contexts import unlimited
from tests.support.site import DAY, Site
from tests.support.witness import TOPIC, Witness, until

HOST: Final = "127.0.0.1"
EVE: Final = "/eve"


@dataclass(frozen=True)
class Reply:
    """A reply: the fields of the connection header, and what followed it."""

    fields: Mapping[str, bytes]
    after: bytes

    @property
    def error(self) -> str:
        return self.fields["error"].decode()


def fields_for(name: str, topic: str, grants: list[bytes] | None, **changes: str) -> dict[str, str | bytes]:
    """A subscriber's connection header; `*` fits every type (attack N5)."""
    fields: dict[str, str | bytes] = {"callerid": name, "topic": topic, "type": "*", "md5sum": "*", **changes}
    if grants is not None:
        fields[FIELD] = encode(list(grants))
    return fields


async def send_header(
    port: int, credentials: Credentials, fields: Mapping[str, str | bytes], at_most: int = 1 << 20
) -> Reply:
    """Send a connection header to a topic port and receive everything until the end."""
    stream = await connect(HOST, port, unlimited(credentials, accept_any))
    data = b""
    try:
        await stream.send(tcpros.encode(fields))
        while len(data) < at_most:
            data += await stream.receive()
    except ChannelError:
        if not data:
            raise
    finally:
        stream.abort("heard enough")
    end = 4 + int.from_bytes(data[:4], "little")
    return Reply(tcpros.decode(data[4:end]), data[end:])


async def dial(uri: str, credentials: Credentials) -> SecureStream[UnverifiedPeer]:
    """A secure connection to the XML-RPC port in `uri`."""
    port = int(uri.rstrip("/").rpartition(":")[2])
    return await connect(HOST, port, unlimited(credentials, accept_any), WireProtocol.HTTP)


async def call(uri: str, credentials: Credentials, method: str, *params: object) -> object:
    """One XML-RPC call; the whole answer."""
    stream = await dial(uri, credentials)
    try:
        return await RpcClient(stream).call(method, *params)
    finally:
        await stream.close()


async def expect_no_room(stream: SecureStream[Any], size: int) -> None:
    """A unit of `size` from a peer without a right ends the connection."""
    with contextlib.suppress(ChannelError):  # it may be closed before all is sent
        await stream.send(bytes(size))
    with pytest.raises(ChannelError):
        await stream.receive()  # a readable refusal would mean that the whole unit was buffered
    stream.abort("done")


def refusals(caplog: pytest.LogCaptureFixture) -> list[HintedError]:
    """The errors by which nodes of this process refused connections, oldest first."""
    found = (argument for record in caplog.records for argument in record.args or ())
    return [error for error in found if isinstance(error, HintedError)]


def listen(caplog: pytest.LogCaptureFixture) -> None:
    """Record refusals at every level."""
    caplog.set_level(logging.INFO, "rossec")


def credentials(site: Site, name: str = EVE) -> Credentials:
    return site.enroll(name).credentials()


def drafted(
    site: Site, name: str = EVE, pattern: str = TOPIC, right: Right = Right.SUBSCRIBE, **changes: Any
) -> Draft:
    now = int(time.time())
    draft = Draft(
        domain=site.anchor.domain,
        subject=name,
        holder=site.identity(name).thumbprint,
        not_before=now,
        expires=now + DAY,
        cap=now + DAY,
        serial=secrets.token_bytes(16),
        permissions=(Permission(pattern, right),),
    )
    return dataclasses.replace(draft, **changes)


def signed(site: Site, signer: Signer | None = None, **changes: Any) -> bytes:
    """A grant for Eve; only the authority's signer makes a valid one."""
    return document.sign(signer or site.authority.signer, drafted(site, **changes))


def flip(data: bytes, position: int, mask: int = 1) -> bytes:
    """`data` with one byte changed."""
    changed = bytearray(data)
    changed[position] ^= mask
    return bytes(changed)


async def revoke(site: Site, witness: Witness, grant_or_key: bytes) -> None:
    """Revoke, send the list to the master, and wait until both nodes have it."""
    data = site.revoke(grant_or_key)
    await witness.robot._membership.session.call("rossec.updateRevocations", data)
    nodes = witness.robot, witness.viewer
    await until(lambda: all(node.revocations.data == data for node in nodes))


def expect_refused(
    heard: Reply, caplog: pytest.LogCaptureFixture, kind: type[HintedError], said: str
) -> None:
    """The refused peer got one readable line and no message; the refusing side logs `kind`."""
    assert set(heard.fields) == {"error"}
    assert heard.error.startswith("rossec: ")
    assert said in heard.error
    assert heard.error.isprintable()
    assert heard.after == b""
    refused = refusals(caplog)[-1]
    assert type(refused) is kind
    assert str(refused) in heard.error
