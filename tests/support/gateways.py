"""A home that trusts a hospital, subscribers of a hospital's topic there, and false publishers.

The subscriber may have the topic from a gateway of the home, and from the hospital. A publisher of
this module records what it was asked, and answers what it was told to.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from ca.encoding import Value, encode
from ca.revocation.lists import MAX_AGE, Timestamp, digest, open_list, sign_timestamp
from grants.model import Restriction, Right
from rossec.channel.edhoc.credentials import Credentials
from rossec.demo.intruder import UnverifiedPeer, accept_any
from rossec.errors import ChannelError
from rossec.net.aio import SecureStream, WireProtocol, serve
from rossec.net.rpc.calls import serve_calls
from rossec.node import message_type
from rossec.participant.access import FIELD
from rossec.ros import tcpros
from rossec.ros.names import MASTER
from tests.support.attacker import HOST, call, credentials
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.trust import accept, carry, share

HOSPITAL: Final = "hospital"
ORIGIN: Final = "/ward/word"
ALIAS: Final = f"/remote/{HOSPITAL}{ORIGIN}"
SERVED: Final = f"/gateway/{HOSPITAL}{ORIGIN}"
SUBSCRIBER: Final = "/viewer"
STRING: Final = "std_msgs/String"


@dataclass
class Sites:
    """Both sides; the subscriber at home holds the right by each of the two authorities.

    Attributes:
        gateway_grant, subscriber_grant: those that the home has signed.
    """

    home: Site
    hospital: Site
    gateway_grant: bytes
    subscriber_grant: bytes

    def told(self) -> None:
        """The home's master hears that the hospital has revoked nothing."""
        data = self.hospital.authority.store.newest_list()
        assert data is not None
        signer = self.hospital.enroll(MASTER).credentials()
        seq = open_list(data, self.hospital.anchor.public_key).seq
        stamp = Timestamp(seq, digest(data), self.hospital.now(), MAX_AGE)
        assert self.home.master is not None
        self.home.master.effects.take_foreign(
            self.hospital.anchor.domain, data, sign_timestamp(signer.signer, stamp), signer.chain
        )

    async def lead(self, uri: str, *publishers: str) -> None:
        """The home's master tells the subscriber at `uri` these publishers of the alias."""
        own = credentials(self.home, MASTER)
        answer = await call(uri, own, "publisherUpdate", MASTER, ALIAS, list(publishers))
        assert isinstance(answer, list)
        assert answer[0] == 1, answer


@contextlib.asynccontextmanager
async def two_sites(
    directory: Path, *names: str, restriction: Restriction | None = None
) -> AsyncIterator[Sites]:
    """The home's master runs.

    Args:
        names: nodes of the home beside the subscriber and `/gateway`.
        restriction: of what the subscriber may have from the gateway.
    """
    home, hospital = Site(directory / "home"), Site(directory / HOSPITAL, HOSPITAL)
    accept(home, hospital)
    accept(hospital, home)
    for name in (*names, SUBSCRIBER, "/gateway", MASTER):
        home.enroll(name)
    publishes = home.publish("/gateway", "/gateway/hospital/**")
    subscribes = home.subscribe(SUBSCRIBER, SERVED, restriction)
    share(hospital, home, SUBSCRIBER, Right.SUBSCRIBE, ORIGIN)
    for site in (home, hospital):
        carry(site)
    async with home.running():
        sites = Sites(home, hospital, publishes, subscribes)
        sites.told()
        yield sites


@dataclass
class FalsePublisher:
    """A node with any certificate, which answers each subscriber with `fields` and a message.

    Attributes:
        requested: the topics that it was asked for at its API.
        headers: what subscribers sent.
        left: how many of them closed the connection after the answer.
    """

    own: Credentials
    fields: Mapping[str, str | bytes]
    requested: list[str] = field(default_factory=list)
    headers: list[Mapping[str, bytes]] = field(default_factory=list)
    left: int = 0

    async def serve_topic(self, stream: SecureStream[UnverifiedPeer]) -> None:
        data = await stream.receive()
        self.headers.append(tcpros.decode(data[4:]))
        message = string("false")
        try:
            await stream.send(tcpros.encode(self.fields), message)
            while True:
                await stream.send(message)
                await asyncio.sleep(0.05)
        except ChannelError:
            self.left += 1

    async def answer(self, _method: str, params: tuple[object, ...], _: UnverifiedPeer) -> Sequence[object]:
        self.requested.append(str(params[1]))
        return [1, "", ["TCPROS", HOST, self.port]]

    def was_left(self) -> bool:
        """Whether a subscriber has closed its connection."""
        return self.left > 0

    async def serve_slave(self, stream: SecureStream[UnverifiedPeer]) -> None:
        await serve_calls(stream, self.answer)

    @contextlib.asynccontextmanager
    async def listening(self) -> AsyncIterator[str]:
        """Its API URI."""
        own = unlimited(self.own, accept_any)
        async with (
            serve(self.serve_topic, HOST, 0, own) as server,
            serve(self.serve_slave, HOST, 0, own, WireProtocol.HTTP) as api,
        ):
            self.port = server.port
            yield f"http://{HOST}:{api.port}/"


def string(text: str) -> bytes:
    """A String as it is sent, with its length."""
    kind = message_type(STRING)
    return tcpros.frame(bytes(kind.serialize(kind.create(data=text))))


def answering(name: str, topic: str, *grants: bytes) -> dict[str, str | bytes]:
    """The connection header of a publisher."""
    kind = message_type(STRING)
    return {
        "callerid": name,
        "topic": topic,
        "type": kind.name,
        "md5sum": kind.md5sum,
        "message_definition": kind.definition,
        FIELD: encode(list[Value](grants)),
    }
