"""What a host on the link can do to a node that discovers its master: real links and programs."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rossec.discovery.announcement import Announcement, sign
from tests.support.hosts import Host, Hosts, two_hosts
from tests.support.site import Site

ROSSEC = (sys.executable, "-m", "rossec")
FLOOD = """
import sys, time
from rossec.discovery.local_links import MulticastSocket
group, data = MulticastSocket(listen=False), bytes.fromhex(sys.argv[1])
print("flooding", flush=True)
while True:
    group.send(data)
    time.sleep(0.001)
"""

pytestmark = [pytest.mark.attack("discovery-flood"), pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def hosts() -> Iterator[Hosts]:
    with two_hosts() as made:
        if not made.real:
            pytest.skip("NOT RUN: network namespaces are not permitted here")
        yield made


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory, hosts: Hosts) -> Iterator[Site]:
    site = Site(tmp_path_factory.mktemp("found") / "home")
    for name in ("/master", "/robot"):
        site.enroll(name)
    env = {**os.environ, "ROSSEC_HOME": str(site.root), "ROS_IP": hosts.near.ipv4}
    command = hosts.near.at(*ROSSEC, "master", "--port", "0", "--json", "--announce")
    with subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        assert running.stdout.readline().startswith('{"ready"')
        yield site
        running.send_signal(signal.SIGTERM)
        assert running.wait(60) == 0


@contextlib.contextmanager
def flooded(host: Host, data: bytes) -> Iterator[None]:
    """Some hundred datagrams a second, to every host on the link."""
    command = host.at(sys.executable, "-c", FLOOD, data.hex())
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "flooding\n"
        try:
            yield
        finally:
            running.kill()


def announcement(site: Site) -> bytes:
    own = site.enroll("/master").credentials()
    said = Announcement("192.0.2.66", 1, b"forgery!", 1, site.now())
    return sign(own.signer, own.chain, said)


def forged(site: Site, elsewhere: Path) -> bytes:
    """The master's own chain, copied from the link, with an invalid signature."""
    data = bytearray(announcement(site))
    data[-1] ^= 1
    return bytes(data)


FLOODS = {
    "one byte": lambda site, elsewhere: b"x",
    "zeros": lambda site, elsewhere: bytes(1232),
    "another authority": lambda site, elsewhere: announcement(Site(elsewhere / "other", "other")),
    "a forged signature": forged,
}


@pytest.mark.parametrize("data", FLOODS.values(), ids=FLOODS)
def test_a_master_is_found_in_a_flood(hosts: Hosts, home: Site, tmp_path: Path, data: object) -> None:
    assert callable(data)
    env = {**os.environ, "ROSSEC_HOME": str(home.root)}
    with flooded(hosts.far, data(home, tmp_path)):
        for _ in range(2):
            done = subprocess.run(
                hosts.far.at(*ROSSEC, "discover", "--as", "/robot", "--json"),
                env=env,
                capture_output=True,
                text=True,
                check=False,
                timeout=300,
            )
            assert done.returncode == 0, done.stderr
            (row,) = [json.loads(line) for line in done.stdout.splitlines()]
            assert row["key"] == home.identity("/master").thumbprint.hex()
