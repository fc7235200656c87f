"""What the authority does about other domains: recorded, listed and delivered, or nothing is."""

import dataclasses
import secrets
from pathlib import Path
from typing import Any

import pytest

from ca.certificates import to_pem
from ca.domains import Anchors, DomainList, ForeignDomain, open_bundle, open_domains
from ca.errors import BundleRefused, CertificateRefused, DomainsRefused, DomainUnknown, StoreError
from ca.revocation.lists import open_list
from ca.revocation.trust_status import Revocations, TrustStatus
from grants import document
from grants.model import Draft, Permission, Right
from rossec.authority.domain_operations import find_row, living_grants
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.errors import AuthorityLocked, ConfigurationError, NotDelivered
from rossec.home import NodeHome
from tests.rossec.participant.test_connections import FakeStream, table
from tests.support.domains import SomeNode, foreign
from tests.support.keyservice import running_service
from tests.support.pki import NOW, Site

DAY = 86_400
ROBOT = "/remote/hospital/rounds/robot3"
SECRET = "four random words here"


class Office:
    """An authority, another domain, and a master that can be out of reach."""

    def __init__(self, root: Path) -> None:
        self.now = NOW
        self.calls: list[StatementCall] = []
        self.reachable = True
        self.root = root
        self.home = AuthorityHome.create(root, "home", SECRET, NOW)
        self.service = self.opened()
        self.site = Site.create("hospital.example")
        self.hospital = foreign(self.site)

    def opened(self) -> AuthorityService:
        return AuthorityService(self.root, lambda: SECRET, self._deliver, lambda: self.now)

    def _deliver(self, call: StatementCall) -> None:
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
            "home",
            name,
            robot.thumbprint,
            self.now,
            self.now + lifetime,
            self.now + lifetime,
            secrets.token_bytes(16),
            (Permission("/pose", Right.SUBSCRIBE),),
        )
        return document.grant_id(authority.issue_grant(draft, self.now))


@pytest.fixture
def office(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Office:
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    return Office(tmp_path / "home")


def test_a_bundle_is_signed_by_the_root(office: Office) -> None:
    data = office.service.domains.bundle(("/robot/**",), ("http://10.0.0.1:11311",), DAY)
    bundle = open_bundle(data, NOW)
    assert bundle.anchor == office.home.anchor()
    assert (bundle.names, bundle.masters) == (("/robot/**",), ("http://10.0.0.1:11311",))
    assert bundle.expires == NOW + DAY
    with pytest.raises(BundleRefused):
        office.service.domains.bundle((), ())


def test_a_domain_is_accepted_limited_and_removed(office: Office) -> None:
    assert office.home.domain_list() is None
    assert not office.service.publish_domains()
    listed = office.service.domains.accept(office.hospital)
    assert listed == office.listed()
    assert listed.domains == (office.hospital,)
    assert office.service.has_signed_domains
    changed = office.service.domains.changed("hospital", fresh=60, exported=())
    assert office.service.domains.limit("hospital", fresh=60, exported=()).domains == (changed,)
    assert (changed.fresh, changed.exported) == (60, ())
    removed = office.service.domains.remove("hospital", "over", revoke_grants=False)
    assert (removed.row.domain, removed.revoked) == ("hospital.example", frozenset())
    assert (office.listed().domains, office.listed().seq) == ((), 3)
    office.service.unlock().store.log.audit(office.home.own_key())


def test_the_newest_list_is_delivered(office: Office) -> None:
    office.service.domains.accept(office.hospital)
    assert office.service.publish_domains()
    (call,) = office.calls
    data, _ = office.home.domain_list() or (b"", None)
    assert (call.method, call.statement) == ("rossec.updateDomains", (data,))
    office.service.publish()
    assert [call.method for call in office.calls[1:]] == ["rossec.updateRevocations", "rossec.updateDomains"]
    office.reachable = False
    with pytest.raises(NotDelivered) as caught:
        office.service.publish_domains()
    assert "rossec ca publish" in caught.value.hint


def test_an_expired_list_is_not_delivered_and_refresh_signs_it_anew(office: Office) -> None:
    office.service.domains.accept(dataclasses.replace(office.hospital, until=NOW + 400 * DAY))
    office.now = NOW + 91 * DAY
    with pytest.raises(ConfigurationError, match="the list of domains expired") as caught:
        office.service.publish_domains()
    assert "rossec ca refresh" in caught.value.hint
    office.service.refresh()
    assert office.listed().expires == office.now + 90 * DAY
    assert office.service.publish_domains()


def test_without_domains_refresh_signs_no_list_of_them(office: Office) -> None:
    office.service.refresh()
    office.service.publish()
    assert office.home.domain_list() is None
    assert [call.method for call in office.calls] == ["rossec.updateRevocations"]
    assert not office.service.has_signed_domains


@pytest.mark.parametrize(
    ("change", "error"),
    [({"domain": "home"}, DomainsRefused), ({"admitted": ()}, DomainsRefused), ({"until": NOW - 1}, None)],
)
def test_what_is_refused_changes_nothing(
    office: Office, change: dict[str, Any], error: type[Exception] | None
) -> None:
    if error is None:
        assert office.service.domains.accept(dataclasses.replace(office.hospital, **change)).domains == ()
        return
    with pytest.raises(error):
        office.service.domains.accept(dataclasses.replace(office.hospital, **change))
    assert office.home.domain_list() is None


def test_the_own_domain_is_not_accepted(office: Office) -> None:
    own = ForeignDomain("home", "x", office.home.anchor().certificate, ("/**",), 60, NOW + DAY)
    with pytest.raises(DomainsRefused, match="the own one"):
        office.service.domains.accept(own)
    assert office.service.unlock().store.domains.accepted() == []


def test_an_unknown_label_is_neither_limited_nor_removed(office: Office) -> None:
    for act in (
        lambda: office.service.domains.limit("hospital", fresh=60),
        lambda: office.service.domains.changed("hospital", fresh=60),
        lambda: office.service.domains.remove("hospital", "", revoke_grants=True),
    ):
        with pytest.raises(DomainUnknown):
            act()
    assert office.home.domain_list() is None


def test_a_label_is_not_given_on_while_a_grant_that_names_it_lives(office: Office) -> None:
    other = foreign(Site.create("cafe"))
    office.service.domains.accept(office.hospital)
    given = office.grant()
    office.grant("/remote/ward/rounds/robot3")
    with pytest.raises(StoreError, match="the label hospital is that of"):
        office.service.domains.accept(other)
    office.service.domains.remove("hospital", "", revoke_grants=False)
    with pytest.raises(ConfigurationError, match="a grant names hospital and means") as caught:
        office.service.domains.accept(other)
    assert given.hex()[:8] in caught.value.hint
    office.service.domains.accept(dataclasses.replace(other, label="cafe"))  # another label
    office.service.domains.accept(office.hospital)  # the same domain
    office.service.domains.remove("hospital", "", revoke_grants=False)
    office.now += DAY + 61
    office.service.domains.remove("cafe", "", revoke_grants=False)
    office.service.domains.accept(other)


def test_a_domain_with_a_new_root_key_is_another_one(office: Office) -> None:
    office.service.domains.accept(office.hospital)
    office.grant()
    office.grant()
    office.service.domains.remove("hospital", "", revoke_grants=False)
    anew = foreign(Site.create("hospital.example"))
    with pytest.raises(ConfigurationError, match="2 grants name hospital and mean hospital"):
        office.service.domains.accept(anew)


def test_grants_are_revoked_with_their_domain(office: Office) -> None:
    office.service.domains.accept(office.hospital)
    given, over = office.grant(), office.grant(lifetime=60)
    office.now += 200
    removed = office.service.domains.remove("hospital", "", revoke_grants=True)
    assert removed.revoked == {given}
    entries = open_list(office.home.revocation_list(), office.home.own_key()).entries
    assert given in entries
    assert over not in entries
    office.service.domains.accept(foreign(Site.create("cafe")))
    store = office.service.unlock().store
    assert living_grants(store, "hospital", office.now) == []


def test_a_row_is_found_also_after_its_end(office: Office) -> None:
    store = office.service.unlock().store
    with pytest.raises(DomainUnknown):
        find_row(store, "hospital")
    office.service.domains.accept(office.hospital)
    held = find_row(store, "hospital")
    office.service.domains.remove("hospital", "", revoke_grants=False)
    assert find_row(store, "hospital") == held


def entries_of(office: Office) -> frozenset[bytes]:
    return open_list(office.home.revocation_list(), office.home.own_key()).entries


def test_a_key_of_another_domain_is_revoked_by_its_certificate(office: Office) -> None:
    office.service.domains.accept(office.hospital)
    lost, kept = (SomeNode(office.site, "/rounds/robot3") for _ in range(2))
    _, count = office.service.domains.revoke_foreigner(ROBOT, "lost", to_pem(lost.leaf))
    assert (count, entries_of(office)) == (1, frozenset({lost.identity.thumbprint}))
    assert office.service.has_revoked
    store = office.service.unlock().store
    store.domains.add_certificate(office.site.anchor.thumbprint, kept.identity, NOW)
    office.service.domains.remove("hospital", "", revoke_grants=False)
    _, count = office.service.domains.revoke_foreigner(ROBOT, "too")
    assert (count, len(entries_of(office))) == (1, 2)
    store.log.audit(office.home.own_key())


def test_a_certificate_that_proves_nothing_revokes_nothing(office: Office) -> None:
    stranger = SomeNode(Site.create("hospital.example"), "/rounds/robot3")
    with pytest.raises(DomainUnknown):
        office.service.domains.revoke_foreigner(ROBOT, "", to_pem(stranger.leaf))
    with pytest.raises(DomainUnknown):
        office.service.domains.revoke_foreigner(ROBOT, "")
    office.service.domains.accept(office.hospital)
    with pytest.raises(CertificateRefused):
        office.service.domains.revoke_foreigner(ROBOT, "", to_pem(stranger.leaf))
    other = SomeNode(office.site, "/rounds/robot7")
    with pytest.raises(ConfigurationError, match="that of hospital:/rounds/robot7"):
        office.service.domains.revoke_foreigner(ROBOT, "", to_pem(other.leaf))
    assert not office.service.has_revoked


def test_a_foreigner_that_is_revoked_here_is_cut(office: Office) -> None:
    office.service.domains.accept(office.hospital)
    robot = SomeNode(office.site, "/rounds/robot3")
    anchors = Anchors(office.home.anchor())
    anchors.update((office.home.domain_list() or (b"",))[0])
    own = Revocations(office.home.own_key())
    connections, stream = table(TrustStatus(anchors, own)), FakeStream()
    reasons = stream.reasons
    connections.accept(stream, anchors.verify([robot.leaf], NOW))
    connections.cut_ended(NOW)
    assert reasons == []
    office.service.domains.revoke_foreigner(ROBOT, "lost", to_pem(robot.leaf))
    own.update(office.home.revocation_list(), NOW)
    connections.cut_ended(NOW)
    assert reasons == ["the peer's identity is revoked"]


def test_the_key_may_be_held_by_the_running_service(office: Office) -> None:
    with running_service(office.home) as running:
        with pytest.raises(AuthorityLocked):
            office.service.domains.accept(office.hospital)
        running.operations.unlock(SECRET, 0, "a test")
        office.service.domains.accept(office.hospital)
        office.service.domains.bundle(("/**",))
        robot = SomeNode(office.site, "/rounds/robot3")
        office.service.domains.revoke_foreigner(ROBOT, "lost", to_pem(robot.leaf))
        office.service.close()
    assert entries_of(office) == {robot.identity.thumbprint}
    said = " ".join(running.audit)
    assert "signs a list of domains" in said
    assert "signs a bundle of its domain" in said
    assert open_domains((office.home.domain_list() or (b"",))[0], office.home.anchor()).seq == 1


def test_the_key_of_a_second_master_is_listed_when_it_is_signed(office: Office) -> None:
    for name in ("/master", "/master/kitchen"):
        node = NodeHome.of(office.root, name)
        node.create_request("home")
        office.service.identities.issue(
            node.request(), DAY, replace_key=None, wildcard=False, source="a test"
        )
    assert len(office.listed().masters) == 2
    assert office.service.has_signed_domains
    assert office.service.publish_domains()
