"""Links between relays through a real router."""

import asyncio
from pathlib import Path

from ca.certificates import Identity
from rossec.net.aio import SecureContext, SecureStream
from rossec.overlay.endpoint import LinkTransport, RouterNetwork
from rossec.overlay.link_frames import inbox
from rossec.overlay.relay import measured
from tests.support.overlay import carrier, router
from tests.support.site import Site

BOX = inbox("open", bytes(range(16)))


async def test_a_link_goes_from_an_inbox_to_who_reads_it(tmp_path: Path) -> None:
    site = Site(tmp_path)
    names = ("/relay", "/relay/attic")
    homes = [site.enroll(name) for name in names]
    contexts: list[SecureContext[Identity]] = [
        SecureContext(home.credentials(), home.anchor().verify) for home in homes
    ]
    with router() as locator:
        async with carrier(locator) as one, carrier(locator) as two:
            calling, called = (
                RouterNetwork(each, each.routers, context)
                for each, context in zip((one, two), contexts, strict=True)
            )
            assert (calling.account, calling.router) == ("open", locator)

            async def echo(stream: SecureStream[Identity]) -> None:
                assert stream.peer.name == "/relay"
                while True:
                    await stream.send(await stream.receive())

            listener = called.listen(BOX, echo, "attic")
            async with asyncio.timeout(30):
                stream = await calling.dial(BOX)
                assert stream.peer.name == "/relay/attic"
                assert isinstance(stream.transport, LinkTransport)
                await stream.send(b"ping")
                assert await stream.receive() == b"ping"
            rtt, _ = measured(stream)
            assert 0 < rtt < 10_000
            await stream.close()
            await listener.close()
            assert measured(stream)[0] >= 0
