"""A border router and a thing as processes, on hosts of their own; the line loses packets."""

import asyncio
import contextlib
import json
import os
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.things import ThingKey
from rossec.border.handshakes import StaticKey
from rossec.home import NodeHome
from rossec.saved_statements import ThingFiles
from tests.support.border import LAMP, BorderSite
from tests.support.hosts import Host
from tests.support.site import Site
from tests.support.stock import process
from tests.support.wan import wan_of

PORT = 5683
HERE = Path(__file__).parents[2]
MASTER = """
import asyncio, sys, time
from pathlib import Path
from rossec.home import NodeHome
from rossec.master.server.server import master_of

async def main():
    home = NodeHome.of(Path(sys.argv[1]), "/master")
    newest = home.load_revocations()
    master = master_of(home, host="127.0.0.1", port=0, newest=newest, now=int(time.time()))
    await master.start()
    print(master.uri, flush=True)
    await asyncio.sleep(3600)

asyncio.run(main())
"""
THING = """
import asyncio, json, sys
from ca.encoding import encode
from ca.things import read_ccs
from tests.support.constrained import Thing, Value
from cryptography.hazmat.primitives.serialization import load_pem_private_key

async def main():
    host, port, ccs, key = sys.argv[1:]
    peer = read_ccs(open(ccs, "rb").read())
    private = load_pem_private_key(open(key, "rb").read(), None)
    links = '</t>;rt="ros.pub";if="std_msgs/Float32";title="~temperature";ct=60'
    thing = Thing((host, int(port)), peer, links, b"\\x2c", private, own="::")
    value = thing.add("/t", Value(60, encode({"data": 0.5})))
    await thing.start()
    while True:
        try:
            async with asyncio.timeout(40):
                print((await thing.register()).dotted, flush=True)
            break
        except Exception as error:
            print("again", type(error).__name__, flush=True)
            thing.forget()
    for number in range(10_000):
        await asyncio.sleep(0.5)
        value.set(encode({"data": number + 0.5}))
        if number % 20 == 19:
            try:
                async with asyncio.timeout(40):
                    await thing.register()
            except Exception:
                thing.forget()

asyncio.run(main())
"""
READER = """
import asyncio, sys
from rossec.node import Node

async def main():
    async with Node("/heating") as node:
        seen = await node.subscriber(sys.argv[1], "std_msgs/Float32")
        async for message in seen:
            print(message.data, flush=True)

asyncio.run(main())
"""


@contextlib.asynccontextmanager
async def program(
    host: Host, environ: dict[str, str], text: str, *words: str
) -> AsyncIterator[asyncio.subprocess.Process]:
    command = host.at(sys.executable, "-c", text, *words)
    async with process(environ, *command) as running:
        yield running


async def line(running: asyncio.subprocess.Process, within: float = 90.0) -> str:
    """The next line that it prints."""
    assert running.stdout is not None
    async with asyncio.timeout(within):
        return (await running.stdout.readline()).decode().strip()


def set_up(root: Path) -> tuple[BorderSite, Path, Path]:
    """A site with a thing; the files for the thing's process."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    site = Site(root / "site")
    newest = site.authority.store.newest_list()
    assert newest is not None
    site.enroll("/master").save_revocations(newest)
    border = BorderSite(site)
    border.key = StaticKey(ThingFiles(NodeHome.of(site.root, "/border")).router_key())
    key = ec.generate_private_key(ec.SECP256R1())
    border.state(LAMP, ThingKey.of(key.public_key(), b"\x2c"))
    border.allow()
    site.subscribe("/heating", f"{LAMP}/temperature")
    pem, ccs = root / "lamp.pem", root / "border.ccs"
    pem.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
    )
    ccs.write_bytes(border.key.credential.ccs)
    return border, pem, ccs


@pytest.mark.timeout(280)
async def test_a_thing_is_served_while_a_fifth_of_all_packets_is_lost(tmp_path: Path) -> None:
    """Each packet passes a gateway, which drops one of five, either way."""
    border, pem, ccs = set_up(tmp_path)
    environ = {**os.environ, "PYTHONPATH": str(HERE), "ROSSEC_HOME": str(border.site.root)}
    with wan_of({"garden": ("thing",)}, ("house",)) as wan:
        house, thing = wan["house"], wan["thing"]
        async with program(house, environ, MASTER, str(border.site.root)) as master:
            inside = {**environ, "ROS_MASTER_URI": await line(master), "ROS_IP": "127.0.0.1"}
            command = "border", "--listen", house.ipv4, "--port", str(PORT), "--json"
            router = process(inside, *house.at(sys.executable, "-m", "rossec", *command))
            async with router as running, program(house, inside, READER, f"{LAMP}/temperature") as reader:
                assert json.loads(await line(running))["ready"] == [house.ipv4, PORT]
                with wan.lossy(one_of=5):
                    words = house.ipv4, str(PORT), str(ccs), str(pem)
                    async with program(thing, environ, THING, *words) as lamp:
                        while await line(lamp) != "2.04":
                            pass
                        values = [float(await line(reader)) for _ in range(10)]
    assert values == sorted(set(values))
