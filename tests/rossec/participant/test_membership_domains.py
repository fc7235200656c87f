"""The membership of an identity where there are foreign domains, or several masters."""

from pathlib import Path

import pytest

from ca.errors import NotAdmitted
from grants.model import Right
from rossec.errors import ConfigurationError, RossecError
from rossec.participant.membership import LoadedIdentity
from rossec.ros import names
from rossec.ros.names import MASTER
from tests.rossec.participant.test_membership import Form, timestamp
from tests.support.site import Site
from tests.support.trust import accept, share
from tests.support.witness import until


@pytest.fixture(autouse=True)
def _periods(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.participant.membership.PERIOD", 0.05)
    monkeypatch.setattr(
        "rossec.participant.membership.ConnectionWatchdog", lambda connections, _: connections
    )


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def word_of(other: Site) -> tuple[bytes, bytes, list[bytes]]:
    """The list of another domain, and its master's word."""
    data = other.authority.store.newest_list()
    assert data is not None
    return data, timestamp(other, data), list(other.enroll(MASTER).credentials().chain)


async def test_lists_of_domains_and_of_what_they_revoke_are_taken_from_the_master(
    site: Site, tmp_path: Path
) -> None:
    other = Site(tmp_path / "hospital", "hospital")
    accept(other, site)
    visited = share(other, site, "/robot", Right.SUBSCRIBE, "/ward/pose")
    async with site.running(), Form(site).running() as form:
        assert visited not in form.access.current(site.now())
        before = form.membership.rights_version
        await form.membership.session.call("rossec.updateDomains", accept(site, other))
        assert site.master is not None
        site.master.effects.take_foreign("hospital", *word_of(other))
        await until(lambda: visited in form.access.current(site.now()))
        trust_status = form.loaded.trust_status
        await until(lambda: trust_status.status_valid_until("hospital", bytes(16)) > site.now())
        assert form.membership.rights_version > before
        await until(lambda: "rights changed" in form.calls)
    again = LoadedIdentity(site.enroll("/robot"), "/robot")
    assert again.anchors.listed("hospital") is not None
    held = again.trust_status.foreign("hospital")
    assert held is not None
    assert held.data == other.authority.store.newest_list()


async def test_the_master_pushes_what_is_signed(site: Site, tmp_path: Path) -> None:
    other = Site(tmp_path / "hospital", "hospital")
    listed, word = accept(site, other), word_of(other)
    form, master = Form(site), site.identity(MASTER)
    take = form.membership.take_push
    with pytest.raises(NotAdmitted):
        take(names.FOREIGN_UPDATE, ("hospital", *word), master)
    take(names.DOMAINS_UPDATE, (listed,), master)
    take(names.FOREIGN_UPDATE, ("hospital", *word), master)
    form.loaded.trust_status.check("hospital", bytes(16), site.now())
    assert form.calls == ["close"] * 3, "after each, also one that is refused"
    data = site.revoke(bytes(32))
    take(names.REVOCATION_UPDATE, (data, timestamp(site, data)), master)
    assert form.loaded.revocations.data == data
    for method, params in (
        ("shutdown", ("now",)),
        (names.DOMAINS_UPDATE, ()),
        (names.DOMAINS_UPDATE, ("text",)),
        (names.FOREIGN_UPDATE, word),
        (names.REVOCATION_UPDATE, (data,)),
    ):
        with pytest.raises(RossecError):
            take(method, params, master)


async def test_a_node_takes_for_its_master_who_it_was_told(site: Site) -> None:
    loaded = LoadedIdentity(site.enroll("/robot"), "/robot", "/master/kitchen")
    async with site.running():
        form = Form(site, loaded)
        with pytest.raises(ConfigurationError, match=r"is /master, not /master/kitchen"):
            await form.membership.session.open()
        await form.membership.close()
