"""What the master's signed time says of this host's clock, and where revocations are a tree."""

import asyncio
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.errors import HintedError
from ca.revocation.trust_status import SKEW
from grants.token import peek
from rossec.cli.node.doctor import check_master, describe_offset
from rossec.cli.shared.context import Environment
from rossec.errors import ConfigurationError
from tests.support.attacker import call, credentials
from tests.support.site import Site

SECONDS = st.floats(min_value=1.0e9, max_value=4.0e9)


@pytest.mark.parametrize(
    ("issued", "begun", "ended", "said"),
    [
        (1000, 1000.2, 1000.3, "the clock agrees with the master's"),
        (1000, 998.0, 1003.0, "the clock agrees with the master's"),
        (1003, 1000.0, 1000.1, "the clock of this host is 2s behind the master's; up to 5 s"),
        (997, 1000.5, 1000.6, "the clock of this host is 2s ahead of the master's; up to 5 s"),
        (1060, 1000.0, 1000.0, "the clock of this host is 1m behind the master's: nodes here"),
        (900, 1000.0, 1000.1, "the clock of this host is 1m 39s ahead of the master's: nodes"),
    ],
)
def test_the_offset_is_said(issued: int, begun: float, ended: float, said: str) -> None:
    found = describe_offset(issued, begun, ended)
    assert str(found).startswith(said)
    assert isinstance(found, HintedError) == ("nodes here" in said or "nodes" in said[-5:])


@given(SECONDS, st.floats(-0.9e9, 0.9e9), st.floats(0, 10), st.floats(0, 10))
def test_what_is_said_is_a_lower_bound(host: float, offset: float, there: float, back: float) -> None:
    """However slow the network is: no clock that is right is called wrong."""
    found = describe_offset(int(host + there + offset), host, host + there + back)
    if isinstance(found, HintedError):
        assert abs(offset) > SKEW
    if abs(offset) > SKEW + there + back + 1:
        assert isinstance(found, HintedError)


async def revoke_at_master(site: Site, name: str) -> None:
    """Revoke the identity of a node; the master has the list then."""
    own = credentials(site, "/carrier")
    assert site.master is not None
    data = site.revoke(site.identity(name).thumbprint)
    await call(site.master.uri, own, "rossec.updateRevocations", "/carrier", data)


async def test_a_master_whose_own_identity_is_revoked(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site:
        home = site.enroll("/robot")
        await revoke_at_master(site, "/master")
        with pytest.raises(HintedError) as raised:
            async for _ in check_master(Environment(site.environ), home, ()):
                pass
        assert "revoked" in str(raised.value)


async def test_where_revocations_are_a_tree_the_master_proves_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    site = Site(tmp_path / "site")
    home = site.enroll("/robot")
    kept, gone = site.publish("/robot", "/kept"), site.publish("/robot", "/gone")
    site.revoke(gone)
    async with site.running():
        grants = [peek(kept), peek(gone)]
        found = [each async for each in check_master(Environment(site.environ), home, grants)]
    faults = [str(each) for each in found if isinstance(each, HintedError)]
    assert faults == [f"grant {grants[1].short_id} is revoked according to the master's list"]
    assert any("has a fresh revocation list" in str(each) for each in found)


def test_no_time_is_taken_from_who_is_not_authenticated(tmp_path: Path) -> None:
    """The certificate of a stranger ends the check before anything is said of a clock."""

    async def ask() -> list[object]:
        async with Site(tmp_path / "other", "elsewhere").running() as other:
            home = Site(tmp_path / "site").enroll("/robot")
            environment = Environment({**other.environ, "ROSSEC_HOME": str(tmp_path / "site")})
            found = list[object]()
            try:
                async for each in check_master(environment, home, ()):
                    found.append(each)
            except HintedError as error:
                found.append(type(error))
            return found

    (refusal,) = asyncio.run(ask())
    assert refusal is not ConfigurationError


async def test_a_node_that_is_revoked_is_told_by_which_list(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site:
        home = site.enroll("/robot")
        await revoke_at_master(site, "/robot")
        with pytest.raises(ConfigurationError, match=r"by list \d+ of the authority"):
            async for _ in check_master(Environment(site.environ), home, ()):
                pass


async def test_another_master_than_the_own_is_said(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site:
        home = site.enroll("/robot")
        environment = Environment({**site.environ, "ROSSEC_MASTER": "/master/kitchen"})
        with pytest.raises(ConfigurationError, match="/master answers there, not /master/kitchen"):
            async for _ in check_master(environment, home, ()):
                pass
