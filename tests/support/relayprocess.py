"""Routers and relays as processes, started as their users start them."""

import contextlib
import subprocess
from collections.abc import Iterator
from typing import Final

from rossec.overlay.documents import OPEN_ACCOUNT, Routers
from tests.integration.sidecarworld import ROSSEC, Running, World
from tests.support.hosts import Host

RELAY = "/relay"
LOOPBACK: Final = Host((), "127.0.0.1", "::1")


def locator(port: int, host: Host = LOOPBACK) -> str:
    """Of a router on this host, or on that one."""
    return f"tcp/{host.ipv4}:{port}"


@contextlib.contextmanager
def router(world: World, port: int, host: Host = LOOPBACK) -> Iterator[Running]:
    """A router without accounts; its own files are in `world`'s directory."""
    home = str(world.directory / "router")
    command = ROSSEC, "router", "--home", home, "--listen", locator(port, host), "--open"
    with world.started(host, *command) as running:
        running.wait_for(str(port))
        yield running


def seated(world: World, port: int, host: Host = LOOPBACK) -> None:
    """Enroll the relay of a site, and keep its account at that router."""
    world.site.enroll(RELAY)
    file = world.directory / "account.json"
    file.write_bytes(Routers((locator(port, host),), OPEN_ACCOUNT).write())
    told(world, "account", str(file))


def exchange(one: World, one_label: str, other: World, other_label: str) -> None:
    """The relays take each other's descriptors; `one_label`: what the first one is called there."""
    for side, label, there in ((one, other_label, other), (other, one_label, one)):
        descriptor = side.directory / f"{label}.descriptor"
        descriptor.write_text(told(side, "descriptor", label))
        own = one_label if side is one else other_label
        told(there, "add", own, str(descriptor))


def told(world: World, *words: str) -> str:
    """What a command of `rossec relay` prints, which succeeds."""
    done = subprocess.run(
        [ROSSEC, "relay", *words],
        env=world.env(world.hosts.near),
        text=True,
        capture_output=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@contextlib.contextmanager
def relay(world: World) -> Iterator[Running]:
    """The relay of a site, whose master runs."""
    with world.started(world.hosts.near, ROSSEC, "relay") as running:
        running.wait_for(RELAY)
        yield running
