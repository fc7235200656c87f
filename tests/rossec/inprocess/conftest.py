"""An identity and a listening socket of another one."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from rossec.inprocess.identity import LocalIdentity
from rossec.inprocess.sockets import RosSocket
from tests.rossec.inprocess.socket_pair import owner
from tests.support.site import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    directory: Path = tmp_path_factory.mktemp("identity")
    return Site(directory / "site")


@pytest.fixture(scope="module")
def local_identity(site: Site) -> LocalIdentity:
    return LocalIdentity(site.enroll("/robot"), "/robot")


@pytest.fixture
def listening(site: Site) -> Iterator[RosSocket]:
    viewer = LocalIdentity(site.enroll("/viewer"), "/viewer")
    sock = RosSocket(owner(viewer), socket.socket())
    sock.bind(("127.0.0.1", 0))
    sock.listen(1)
    yield sock
    sock.close()
