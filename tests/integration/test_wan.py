"""The network of the tests between sites: NAT, loss, delay and the capture, by plain TCP."""

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from tests.support.hosts import Host
from tests.support.wan import wan_of

PORT: Final = 7447
SERVER: Final = """
import socket, sys
server = socket.create_server(("", int(sys.argv[1])))
print("ready", flush=True)
while True:
    near, (address, _) = server.accept()
    with near:
        near.sendall(address.encode() + b" " + near.recv(100))
"""
CLIENT: Final = """
import socket, sys
with socket.create_connection((sys.argv[1], int(sys.argv[2])), timeout=float(sys.argv[3])) as far:
    far.sendall(sys.argv[4].encode())
    print(far.recv(1000).decode(), end="")
"""


@contextlib.contextmanager
def served(host: Host) -> Iterator[None]:
    command = host.at(sys.executable, "-c", SERVER, str(PORT))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        assert server.stdout.readline()
        try:
            yield
        finally:
            server.kill()


def call(host: Host, address: str, words: str = "hello", within: float = 20) -> str:
    """What a server said to `words`, or nothing."""
    command = host.at(sys.executable, "-c", CLIENT, address, str(PORT), str(within), words)
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


def test_the_wan_lets_sites_out_and_nobody_in() -> None:
    """Both sites have the same addresses; what a router sees is the gateway."""
    sites = {"home": ("home",), "cottage": ("cottage", "shed")}
    with wan_of(sites, ("router", "second")) as wan, served(wan["router"]), served(wan["cottage"]):
        assert wan["home"].ipv4 == wan["cottage"].ipv4
        assert call(wan["home"], wan["router"].ipv4) == "203.0.113.100 hello"
        assert call(wan["cottage"], wan["router"].ipv4) == "203.0.113.101 hello"
        assert call(wan["second"], wan["router"].ipv4) == f"{wan['second'].ipv4} hello"
        assert call(wan["shed"], wan["cottage"].ipv4) == f"{wan['shed'].ipv4} hello"
        assert call(wan["second"], "203.0.113.101", within=0.5) == ""
        assert call(wan["home"], "203.0.113.101", within=0.5) == ""


async def test_the_wan_records_what_routers_see_and_nothing_else(tmp_path: Path) -> None:
    sites = {"home": ("home",), "cottage": ("cottage", "shed")}
    with wan_of(sites, ("router",)) as wan, served(wan["router"]), served(wan["cottage"]):
        async with wan.recorded(tmp_path / "capture") as found:
            assert call(wan["home"], wan["router"].ipv4, "through the router")
            assert call(wan["shed"], wan["cottage"].ipv4, "inside the site")
    (recording,) = found
    assert recording.dropped == 0
    assert recording.holds(b"through the router")
    assert not recording.holds(b"inside the site")


def test_the_wan_delays_cuts_and_loses() -> None:
    """A call needs two round trips: 80 ms; with one packet of three lost it still comes."""
    with wan_of({"home": ("home",)}, ("router",), delay_ms=20) as wan, served(wan["router"]):
        begin = time.monotonic()
        assert call(wan["home"], wan["router"].ipv4)
        assert time.monotonic() - begin >= 0.08
        with wan.without("home"):
            assert call(wan["home"], wan["router"].ipv4, within=0.5) == ""
        with wan.lossy(one_of=5):
            assert all(call(wan["home"], wan["router"].ipv4) for _ in range(3))
