"""An identity renewed by its node: replaced on the disk, used from the next connection on."""

import time
from pathlib import Path
from typing import Any

import pytest

from ca.authority import Authority
from ca.certificates import build_intermediate_request, from_pem, open_renewal
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.store.record import Store
from rossec import clock
from rossec.authority.renewals import renew, renew_by_name, sign_intermediate
from rossec.authority.signing import SigningAuthority
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.errors import AnswerMalformed, AnswerRefused
from rossec.home import NodeHome
from rossec.participant.renewals import (
    IDENTITY_METHOD,
    IDENTITY_RETRY,
    IdentityRenewal,
    MasterCall,
    renew_identity,
)
from tests.support.poses import POSE, first, pose
from tests.support.site import DAY, Site
from tests.support.witness import until

LIFE = 20 * DAY
NOW = int(time.time())
BEGIN = NOW - 15 * DAY


@pytest.fixture
def site(tmp_path: Path) -> Site:
    """A site whose nodes were enrolled 15 days ago for 20 days."""
    return Site(tmp_path / "site", clock=lambda: BEGIN)


def renewal(site: Site, name: str = "/robot") -> tuple[NodeHome, LiveCredentials, IdentityRenewal]:
    home = site.enroll(name, LIFE)
    credentials = LiveCredentials(home.credentials())
    return home, credentials, IdentityRenewal(home, credentials, BEGIN)


def answering(value: object) -> MasterCall:
    async def call(method: str, *params: object) -> object:
        return value

    return call


def test_an_identity_is_due_after_two_thirds_of_its_lifetime(site: Site) -> None:
    _, _, asks = renewal(site)
    due = BEGIN + LIFE * 2 // 3
    assert asks.request(due - 1) is None
    assert asks.request(NOW) is not None
    assert asks.request(NOW + IDENTITY_RETRY - 1) is None
    assert asks.request(NOW + IDENTITY_RETRY) is not None


def test_an_identity_with_a_short_lifetime_is_requested_more_often(site: Site) -> None:
    home = site.enroll("/brief", 120)
    asks = IdentityRenewal(home, LiveCredentials(home.credentials()), BEGIN)
    assert asks.request(BEGIN + 79) is None
    asked = [at for at in range(BEGIN + 79, BEGIN + 120) if asks.request(at) is not None]
    assert asked == list(range(BEGIN + 80, BEGIN + 120, 6))


async def test_a_new_identity_is_on_the_disk_and_in_use(site: Site) -> None:
    home, credentials, asks = renewal(site)
    before = credentials.current.certificate

    async def call(method: str, *params: Any) -> object:
        assert method == IDENTITY_METHOD
        return renew(site.authority, params[0], NOW)

    assert await renew_identity(call, asks, NOW)
    assert credentials.current.certificate != before
    assert home.credentials().chain == credentials.current.chain
    assert home.identity(NOW).not_after > NOW + 10 * DAY
    assert home.identity(NOW).thumbprint == asks._identity.thumbprint
    assert not await renew_identity(call, asks, NOW)
    assert not credentials.current.shared
    assert len(credentials.current.signer.sign(b"x")) == 64
    assert credentials.current.id_cred == home.credentials().id_cred


async def test_a_request_with_a_lost_answer_is_repeated(site: Site) -> None:
    _, credentials, asks = renewal(site)
    answers = [renew(site.authority, asks.request(at) or b"", at) for at in (NOW, NOW + IDENTITY_RETRY)]
    assert answers[0] == answers[1]
    assert await renew_identity(answering(answers[1]), asks, NOW + 2 * IDENTITY_RETRY)
    assert credentials.current.chain[0] == from_pem(answers[0])[0]


def test_an_identity_installed_by_an_operator_is_used(site: Site) -> None:
    home, credentials, asks = renewal(site)
    before = credentials.current.certificate
    site._clock = lambda: NOW
    site.renew("/robot", LIFE)
    assert asks.request(NOW) is None
    assert credentials.current.certificate == home.credentials().certificate != before
    assert asks.request(NOW + 13 * DAY) is None
    assert asks.request(NOW + 14 * DAY) is not None


def test_an_identity_that_expires_earlier_is_not_used(site: Site) -> None:
    home, credentials, asks = renewal(site)
    before = credentials.current.certificate
    site.renew("/robot", DAY)  # shorter, and expired by now
    assert asks.request(NOW) is not None
    site._clock = lambda: NOW
    site.renew("/robot", DAY)
    assert asks.request(NOW + IDENTITY_RETRY) is not None
    (home.path / "node.pem").unlink()
    assert asks.request(NOW + 2 * IDENTITY_RETRY) is not None
    assert credentials.current.certificate == before


@pytest.mark.parametrize("bundle", [b"garbage", b""])
async def test_a_malformed_identity_changes_nothing(
    site: Site, bundle: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    home, credentials, asks = renewal(site)
    before = (home.path / "node.pem").read_bytes(), credentials.current.certificate

    assert not await renew_identity(answering(bundle), asks, NOW)
    assert not await renew_identity(answering(bundle), asks, NOW + IDENTITY_RETRY)
    assert ((home.path / "node.pem").read_bytes(), credentials.current.certificate) == before
    assert "the identity is not renewed" in caplog.text
    with pytest.raises(AnswerMalformed):
        asks.take(5, NOW)


async def test_a_refusal_of_the_master_is_logged(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    async def call(method: str, *params: object) -> object:
        raise AnswerRefused("rossec: this master renews no identities")

    _, _, asks = renewal(site)
    assert not await renew_identity(call, asks, BEGIN)
    assert not await renew_identity(call, asks, NOW)
    assert "this master renews no identities" in caplog.text


PENDING = AnswerRefused("rossec: the authority's key is locked", code=0)


async def test_what_is_not_there_yet_is_asked_for_again_soon(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    """One request, less and less often; nothing alarming is said before it takes long."""
    caplog.set_level("INFO", "rossec.node")
    _, _, asks = renewal(site)
    asked = list[bytes]()

    async def call(method: str, *params: Any) -> object:
        asked.append(params[0])
        raise PENDING

    at = [NOW + second for second in range(400) if await _asks(call, asks, asked, NOW + second)]
    assert [moment - NOW for moment in at] == [0, 5, 15, 35, 75, 135, 195, 255, 315, 375]
    csrs = {open_renewal(data, site.anchor, NOW, lambda *_: None).csr for data in asked[:3]}
    assert len(csrs) == 1
    warned = [record for record in caplog.records if record.levelname == "WARNING"]
    assert len(warned) == 1, "an hour has not passed"
    assert warned[0].getMessage() == (
        "/robot: the identity ends in 4d 23h and is not renewed yet: rossec: the authority's key is locked"
    )
    await renew_identity(call, asks, NOW + 3700)
    assert sum(record.levelname == "WARNING" for record in caplog.records) == 2


async def _asks(call: MasterCall, asks: IdentityRenewal, asked: list[bytes], at: int) -> bool:
    before = len(asked)
    assert not await renew_identity(call, asks, at)
    return len(asked) > before


@pytest.mark.attack("clock-ahead")
def test_a_look_with_the_clock_ahead_does_not_keep_it_from_asking(site: Site) -> None:
    """It asked minutes before its end by that clock: the end would come before it asked again."""
    _, _, asks = renewal(site)
    due = BEGIN + LIFE * 2 // 3
    assert asks.request(BEGIN + LIFE - 60) is not None
    assert asks.request(due - 1) is None
    assert asks.request(due) is not None
    assert asks.request(due + 1) is None


def test_one_that_is_installed_is_taken_at_once_also_after_the_end(site: Site) -> None:
    home, credentials, asks = renewal(site)
    late = BEGIN + LIFE + DAY
    assert not asks.take_installed(late)
    assert asks.ended(BEGIN + LIFE) == ""
    said = asks.ended(late)
    assert "the identity of /robot ended on" in said
    assert "rossec ca renew --expired /robot" in said
    bundle = renew_by_name(site.authority, "/robot", late, LIFE, expired=True)
    home.install(bundle, late)
    assert asks.take_installed(late)
    assert not asks.take_installed(late)
    assert credentials.current.chain == home.credentials().chain
    assert asks.ended(late) == ""


def test_a_clock_that_leaps_is_in_doubt(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that runs counts seconds too: by those it is not so late."""
    counted = [0.0]
    monkeypatch.setattr(clock, "counter", lambda: lambda: counted[0])
    _, _, asks = renewal(site)
    end = BEGIN + LIFE
    assert asks.ended(end + 300 * DAY).startswith("by this host's clock, which says")
    counted[0] = float(LIFE + DAY)
    assert asks.ended(end + DAY).startswith("the identity of /robot ended on")
    assert "everything of 'home' is over" in asks.ended(end + 11 * 365 * DAY)


def below(site: Site) -> SigningAuthority:
    """The intermediate on the master's host."""
    signer = KeySigner(generate())
    request = build_intermediate_request(signer, site.anchor.domain)
    _, bundle = sign_intermediate(site.authority, request, BEGIN, may_enroll=False)
    der, root = from_pem(bundle)
    path = site.root / "below"
    path.mkdir()
    return SigningAuthority(Authority(signer, root, der), Store.create(path / "ca.db"), path)


async def test_nodes_work_with_identities_signed_by_the_master(site: Site) -> None:
    for name in ("/robot", "/viewer", "/master"):
        site.enroll(name, LIFE)
    site.publish("/robot", "/robot/pose", lifetime=LIFE)
    site.subscribe("/viewer", "/robot/pose", lifetime=LIFE)
    site._clock = time.time
    site.intermediate = below(site)
    async with site.running(), site.node("/robot") as robot:
        await until(lambda: len(robot.credentials.current.chain) == 2, within=20)
        async with site.node("/viewer") as viewer:
            publisher = await robot.publisher("/robot/pose", POSE, latch=True)
            publisher.publish(pose(publisher))
            subscriber = await viewer.subscriber("/robot/pose", POSE)
            await first(subscriber, within=20)
            [connection] = subscriber.links
            assert connection.stream.peer.issuers == (site.intermediate.authority.issuer.thumbprint,)
