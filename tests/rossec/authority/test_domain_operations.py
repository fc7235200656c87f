"""What the authority does about other domains: recorded, listed and delivered, or nothing is."""

import dataclasses
import secrets
from pathlib import Path
from typing import Any

import pytest

from ca.domains.cards import open_card
from ca.domains.lists import DomainList, ForeignDomain, open_domains
from ca.errors import CardRefused, DomainsRefused, DomainUnknown, StoreError
from ca.revocation.state import open_list
from grants import document
from grants.model import Draft, Permission, Right
from rossec.authority.domain_operations import check_label_free, find_row, living_grants
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService, MasterCall
from rossec.errors import AuthorityLocked, ConfigurationError, NotDelivered
from rossec.home import NodeHome
from tests.support.domains import SomeNode, foreign
from tests.support.keyservice import running_service
from tests.support.pki import NOW, Site

DAY = 86_400
SECRET = "four random words here"


class Desk:
    """An authority, another domain, and a master that can be out of reach."""

    def __init__(self, root: Path) -> None:
        self.now = NOW
        self.calls: list[MasterCall] = []
        self.reachable = True
        self.root = root
        self.home = AuthorityHome.create(root, "home", SECRET, NOW)
        self.service = self.opened()
        self.site = Site.create("hospital.example")
        self.hospital = foreign(self.site)

    def opened(self) -> AuthorityService:
        return AuthorityService(self.root, lambda: SECRET, self._deliver, lambda: self.now)

    def _deliver(self, call: MasterCall) -> None:
        if not self.reachable:
            raise NotDelivered("no master", call.hint)
        self.calls.append(call)

    def listed(self) -> DomainList:
        found = self.home.domain_list()
        assert found is not None
        return found[1]

    def grant(self, name: str = "/remote/hospital/rounds/robot3", lifetime: int = DAY) -> bytes:
        """Sign a grant for a node of the hospital; returns its id."""
        authority = self.service.unlock()
        robot = SomeNode(self.site, "/rounds/robot3").identity
        draft = Draft(
            "home", name, robot.thumbprint, self.now, self.now + lifetime, self.now + lifetime,
            secrets.token_bytes(16), (Permission("/pose", Right.SUBSCRIBE),),
        )  # fmt: skip
        return document.grant_id(authority.issue_grant(draft, self.now))


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Desk:
    monkeypatch.setattr("ca.keys.pbes2._N", 16)  # the passphrase is not under test
    return Desk(tmp_path / "home")


def test_a_card_is_signed_by_the_root(desk: Desk) -> None:
    data = desk.service.domain_card(("/robot/**",), ("http://10.0.0.1:11311",), DAY)
    card = open_card(data, NOW)
    assert card.anchor == desk.home.anchor()
    assert (card.names, card.masters) == (("/robot/**",), ("http://10.0.0.1:11311",))
    assert card.expires == NOW + DAY
    with pytest.raises(CardRefused):
        desk.service.domain_card((), ())


def test_a_domain_is_accepted_limited_and_removed(desk: Desk) -> None:
    assert desk.home.domain_list() is None
    assert not desk.service.publish_domains()
    listed = desk.service.accept_domain(desk.hospital)
    assert listed == desk.listed()
    assert listed.domains == (desk.hospital,)
    assert desk.service.has_signed_domains
    changed = desk.service.changed_domain("hospital", fresh=60, exported=())
    assert desk.service.limit_domain("hospital", fresh=60, exported=()).domains == (changed,)
    assert (changed.fresh, changed.exported) == (60, ())
    removed = desk.service.remove_domain("hospital", "over", revoke_grants=False)
    assert (removed.row.domain, removed.revoked) == ("hospital.example", frozenset())
    assert (desk.listed().domains, desk.listed().seq) == ((), 3)
    desk.service.unlock().store.log.audit(desk.home.own_key())


def test_the_newest_list_is_delivered(desk: Desk) -> None:
    desk.service.accept_domain(desk.hospital)
    assert desk.service.publish_domains()
    (call,) = desk.calls
    data, _ = desk.home.domain_list() or (b"", None)
    assert (call.method, call.statement) == ("rossec.updateDomains", (data,))
    desk.service.publish()
    assert [call.method for call in desk.calls[1:]] == [
        "rossec.updateRevocations",
        "rossec.updateDomains",
    ]
    desk.reachable = False
    with pytest.raises(NotDelivered) as caught:
        desk.service.publish_domains()
    assert "rossec ca publish" in caught.value.hint


def test_an_expired_list_is_not_delivered_and_refresh_signs_it_anew(desk: Desk) -> None:
    desk.service.accept_domain(dataclasses.replace(desk.hospital, until=NOW + 400 * DAY))
    desk.now = NOW + 91 * DAY
    with pytest.raises(ConfigurationError, match="the list of domains expired") as caught:
        desk.service.publish_domains()
    assert "rossec ca refresh" in caught.value.hint
    desk.service.refresh()
    assert desk.listed().expires == desk.now + 90 * DAY
    assert desk.service.publish_domains()


def test_without_domains_refresh_signs_no_list_of_them(desk: Desk) -> None:
    desk.service.refresh()
    desk.service.publish()
    assert desk.home.domain_list() is None
    assert [call.method for call in desk.calls] == ["rossec.updateRevocations"]
    assert not desk.service.has_signed_domains


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"domain": "home"}, DomainsRefused),
        ({"admitted": ()}, DomainsRefused),
        ({"until": NOW - 1}, None),
    ],
)
def test_what_is_refused_changes_nothing(
    desk: Desk, change: dict[str, Any], error: type[Exception] | None
) -> None:
    if error is None:
        assert (
            desk.service.accept_domain(dataclasses.replace(desk.hospital, **change)).domains == ()
        )
        return
    with pytest.raises(error):
        desk.service.accept_domain(dataclasses.replace(desk.hospital, **change))
    assert desk.home.domain_list() is None


def test_the_own_domain_is_not_accepted(desk: Desk) -> None:
    own = ForeignDomain("home", "x", desk.home.anchor().certificate, ("/**",), 60, NOW + DAY)
    with pytest.raises(DomainsRefused, match="the own one"):
        desk.service.accept_domain(own)
    assert desk.service.unlock().store.domains.accepted() == []


def test_an_unknown_label_is_neither_limited_nor_removed(desk: Desk) -> None:
    for act in (
        lambda: desk.service.limit_domain("hospital", fresh=60),
        lambda: desk.service.changed_domain("hospital", fresh=60),
        lambda: desk.service.remove_domain("hospital", "", revoke_grants=True),
    ):
        with pytest.raises(DomainUnknown):
            act()
    assert desk.home.domain_list() is None


def test_a_label_is_not_given_on_while_a_grant_that_names_it_lives(desk: Desk) -> None:
    other = foreign(Site.create("cafe"))
    desk.service.accept_domain(desk.hospital)
    given = desk.grant()
    desk.grant("/remote/ward/rounds/robot3")
    with pytest.raises(StoreError, match="the label hospital is that of"):
        desk.service.accept_domain(other)
    desk.service.remove_domain("hospital", "", revoke_grants=False)
    with pytest.raises(ConfigurationError, match="a grant names hospital and means") as caught:
        desk.service.accept_domain(other)
    assert given.hex()[:8] in caught.value.hint
    desk.service.accept_domain(dataclasses.replace(other, label="cafe"))  # another label
    desk.service.accept_domain(desk.hospital)  # the same domain
    desk.service.remove_domain("hospital", "", revoke_grants=False)
    desk.now += DAY + 61
    desk.service.remove_domain("cafe", "", revoke_grants=False)
    desk.service.accept_domain(other)


def test_a_domain_with_a_new_root_key_is_another_one(desk: Desk) -> None:
    desk.service.accept_domain(desk.hospital)
    desk.grant()
    desk.grant()
    desk.service.remove_domain("hospital", "", revoke_grants=False)
    anew = foreign(Site.create("hospital.example"))
    with pytest.raises(ConfigurationError, match="2 grants name hospital and mean hospital"):
        desk.service.accept_domain(anew)


def test_grants_are_revoked_with_their_domain(desk: Desk) -> None:
    desk.service.accept_domain(desk.hospital)
    given, over = desk.grant(), desk.grant(lifetime=60)
    desk.now += 200
    removed = desk.service.remove_domain("hospital", "", revoke_grants=True)
    assert removed.revoked == {given}
    entries = open_list(desk.home.revocation_list(), desk.home.own_key()).entries
    assert given in entries
    assert over not in entries
    desk.service.accept_domain(foreign(Site.create("cafe")))
    store = desk.service.unlock().store
    assert living_grants(store, "hospital", desk.now) == []
    check_label_free(store, desk.hospital, desk.now)


def test_a_row_is_found_also_after_its_end(desk: Desk) -> None:
    store = desk.service.unlock().store
    with pytest.raises(DomainUnknown):
        find_row(store, "hospital")
    desk.service.accept_domain(desk.hospital)
    held = find_row(store, "hospital")
    desk.service.remove_domain("hospital", "", revoke_grants=False)
    assert find_row(store, "hospital") == held


def test_the_key_may_be_held_by_the_running_service(desk: Desk) -> None:
    with running_service(desk.home) as running:
        with pytest.raises(AuthorityLocked):
            desk.service.accept_domain(desk.hospital)
        running.operations.unlock(SECRET, 0, "a test")
        desk.service.accept_domain(desk.hospital)
        desk.service.domain_card(("/**",))
        desk.service.close()
    said = " ".join(running.audit)
    assert "signs a list of domains" in said
    assert "signs a card of its domain" in said
    assert open_domains((desk.home.domain_list() or (b"",))[0], desk.home.anchor()).seq == 1


def test_the_key_of_a_second_master_is_listed_when_it_is_signed(desk: Desk) -> None:
    for name in ("/master", "/master/kitchen"):
        node = NodeHome.of(desk.root, name)
        node.create_request("home")
        desk.service.issue(node.request(), DAY, replace_key=None, wildcard=False, source="a test")
    assert len(desk.listed().masters) == 2
    assert desk.service.has_signed_domains
    assert desk.service.publish_domains()
