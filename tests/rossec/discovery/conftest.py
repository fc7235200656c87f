import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rossec.channel.edhoc.credentials import Credentials
from rossec.discovery import local_links
from rossec.discovery.announcement import Announcement, sign
from tests.rossec.discovery import links
from tests.support.site import Site

NOW = int(time.time())
Make = Callable[..., bytes]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    made = Site(tmp_path_factory.mktemp("site") / "home", clock=lambda: NOW)
    made.enroll("/master")
    made.enroll("/robot")
    return made


@pytest.fixture(scope="module")
def credentials(site: Site) -> Credentials:
    return site.enroll("/master").credentials()


@pytest.fixture(scope="module")
def make(credentials: Credentials) -> Make:
    """A datagram of the master; anything of it can be made different."""

    def datagram(
        seq: int = 0,
        *,
        host: str = "192.0.2.7",
        port: int = 11311,
        instance: bytes = b"instance",
        issued: int = NOW,
        max_age: int = 15,
    ) -> bytes:
        announcement = Announcement(host, port, instance, seq, issued, max_age)
        return sign(credentials.signer, credentials.chain, announcement)

    return datagram


@pytest.fixture
def elsewhere(tmp_path: Path) -> Site:
    made = Site(tmp_path / "elsewhere", clock=lambda: NOW)
    made.enroll("/master")
    return made


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Site:
    site = Site(tmp_path_factory.mktemp("finding") / "home")
    for name in ("/master", "/robot"):
        site.enroll(name)
    return site


@pytest.fixture
def link(monkeypatch: pytest.MonkeyPatch) -> None:
    links.links.clear()
    links.said.clear()
    for module in (local_links, local_links):
        monkeypatch.setattr(module, "MulticastSocket", links.Link)
