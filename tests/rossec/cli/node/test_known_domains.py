"""What `rossec doctor` says of foreign domains."""

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from ca.errors import DomainsRefused
from rossec.authority.home import AuthorityHome
from rossec.cli.node.doctor import check_domains
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from tests.support import trust
from tests.support.commands import Shell
from tests.support.site import DAY, Site


class Pair:
    """A home with the node /robot, and a hospital."""

    def __init__(self, root: Path) -> None:
        self.home, self.hospital = Site(root / "home"), Site(root / "hospital", "hospital")
        self.robot = self.home.enroll("/robot")

    def lines(self, after: int = 0) -> list[str]:
        return list(check_domains(self.home.root, self.robot, self.home.now() + after))

    def save(self, data: bytes) -> None:
        (self.robot.path / "domains.cose").write_bytes(data)


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[Pair]:
    made = Pair(tmp_path)
    yield made
    for site in (made.home, made.hospital):
        site.authority.store.close()


def test_without_a_list_there_is_nothing_to_say(pair: Pair) -> None:
    assert pair.lines() == []


def test_each_domain_has_a_line(pair: Pair) -> None:
    pair.save(trust.accept(pair.home, pair.hospital, "clinic"))
    (line,) = pair.lines()
    assert line.startswith("admits nodes of hospital, here clinic, until 20")
    assert not line.endswith("over")
    (line,) = pair.lines(after=DAY)
    assert line.endswith(", which is over")


def test_an_expired_list_admits_nobody(pair: Pair) -> None:
    pair.save(trust.accept(pair.home, pair.hospital))
    with pytest.raises(ConfigurationError, match="no foreign node is admitted") as caught:
        pair.lines(after=90 * DAY)
    assert "rossec ca refresh" in caught.value.hint


def test_a_list_of_another_authority(pair: Pair) -> None:
    pair.save(trust.accept(pair.hospital, pair.home))
    with pytest.raises(DomainsRefused):
        pair.lines()


def test_a_list_that_the_authority_here_has_renewed(shell: Shell) -> None:
    shell.enroll("/robot")
    shell.enroll("/master")
    assert shell("doctor", "/robot", "--offline").out.count("list of domains") == 0
    shell.enroll("/master/kitchen")
    said = shell("doctor", "/robot", "--offline")
    assert "not ok  the node has not the newest list of domains" in said.out
    assert "rossec ca publish" in said.out
    found = AuthorityHome.at(shell.root).domain_list()
    assert found is not None
    robot = NodeHome.of(shell.root, "/robot")
    (robot.path / "domains.cose").write_bytes(found[0])
    assert list(check_domains(shell.root, robot, int(time.time()))) == []
    assert "newest list" not in shell("doctor", "/robot", "--offline").out
    shutil.rmtree(shell.root / "ca")
    assert list(check_domains(shell.root, robot, int(time.time()))) == []
