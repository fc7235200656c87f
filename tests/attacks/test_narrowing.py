"""Rights that are handed on: Mallory narrows one for Eve, and both want more than it gives."""

import secrets
from collections.abc import Sequence
from typing import Any

import pytest

from grants.errors import (
    GrantError,
    GrantForged,
    GrantForOther,
    GrantMissing,
    GrantNotHeld,
    GrantRevoked,
    GrantTooWide,
)
from grants.model import Draft, Permission, Restriction, Right, filter_rules
from grants.token import NARROWING, pack_chain, peek, sign_narrowing, unpack
from tests.support.attacker import EVE, Reply, credentials, fields_for, refusals, send_header, signed
from tests.support.attacker import revoke as revoke_everywhere
from tests.support.site import HOUR, Site
from tests.support.witness import TOPIC, Witness

MALLORY = "/mallory"
HIDDEN = filter_rules({"header.frame_id": {"redact": {"text": "hidden"}}})
pytestmark = pytest.mark.attack("narrowed-rights")


class Handing:
    """Mallory's grant on the topic, and what she makes of it."""

    def __init__(self, site: Site, witness: Witness) -> None:
        self.site, self.witness = site, witness
        self.mallory, self.eve = credentials(site, MALLORY), credentials(site)
        self.token = self.granted(may_narrow=2)

    def granted(self, **changes: Any) -> bytes:
        wanted = {"subject": MALLORY, "holder": self.site.identity(MALLORY).thumbprint} | changes
        now = self.site.now()
        return signed(self.site, expires=now + HOUR, cap=now + HOUR, **wanted)

    def handed(
        self, token: bytes, *permissions: Permission, to: str = EVE, by: str = MALLORY, **changes: Any
    ) -> bytes:
        """Another narrowing after `token`."""
        held = peek(token)
        wanted: dict[str, Any] = {
            "domain": held.domain,
            "subject": to,
            "holder": self.site.identity(to).thumbprint,
            "not_before": held.not_before,
            "expires": held.expires,
            "cap": held.expires,
            "serial": secrets.token_bytes(16),
            "may_narrow": held.may_narrow - 1,
            "permissions": permissions or (Permission("/**", Right(255)),),
        }
        draft = Draft(**(wanted | changes))
        signer = self.site.enroll(by).signer()
        return pack_chain(token, [sign_narrowing(signer, draft, held)])

    async def ask(self, *tokens: bytes) -> Reply:
        fields = fields_for(EVE, TOPIC, list(tokens))
        return await send_header(self.witness.topic_port, self.eve, fields, 4096)


@pytest.fixture
async def handing(site: Site, witness: Witness) -> Handing:
    return Handing(site, witness)


async def is_refused(
    handing: Handing, tokens: Sequence[bytes], caplog: pytest.LogCaptureFixture, kind: type[GrantError]
) -> None:
    reply = await handing.ask(*tokens)
    assert set(reply.fields) == {"error"}
    found = refusals(caplog)[-1]
    assert isinstance(found.__cause__ or found, kind) or isinstance(found, kind), repr(found)


async def test_what_was_handed_on_is_received(handing: Handing) -> None:
    assert (await handing.ask(handing.handed(handing.token))).fields["callerid"] == b"/robot"


async def test_a_link_that_gives_more_gives_nothing(
    handing: Handing, caplog: pytest.LogCaptureFixture
) -> None:
    elsewhere = handing.granted(pattern="/robot/battery", may_narrow=1)
    await is_refused(handing, [handing.handed(elsewhere)], caplog, GrantMissing)
    less = handing.handed(handing.token, Permission("/robot/battery", Right.SUBSCRIBE))
    await is_refused(handing, [less], caplog, GrantMissing)
    again = handing.handed(less, by=EVE)  # to herself, for everything
    await is_refused(handing, [again], caplog, GrantMissing)


async def test_each_rule_broken_is_refused(handing: Handing, caplog: pytest.LogCaptureFixture) -> None:
    good = handing.handed(handing.token)
    (link,) = unpack(good).narrowings
    claims: Any = NARROWING.peek(link)
    for who, changes, kind in (
        (EVE, {}, GrantForged),
        (MALLORY, {3: "hospital"}, GrantForOther),
        (MALLORY, {-70032: bytes(16)}, GrantForOther),
        (MALLORY, {-70034: 2}, GrantTooWide),
        (MALLORY, {8: {5: bytes(32)}}, GrantNotHeld),
    ):
        signer = handing.site.enroll(who).signer()
        forged = NARROWING.sign(signer, claims | changes)
        await is_refused(handing, [pack_chain(handing.token, [forged])], caplog, kind)
    single, other = handing.granted(may_narrow=0), handing.granted(may_narrow=2)
    await is_refused(handing, [pack_chain(single, [link])], caplog, GrantTooWide)
    await is_refused(handing, [pack_chain(other, [link])], caplog, GrantForOther)
    await is_refused(handing, [handing.token], caplog, GrantNotHeld)
    assert (await handing.ask(good)).fields["callerid"] == b"/robot"


async def test_a_right_for_a_foreigner_is_not_handed_to_a_node_of_ours(
    handing: Handing, caplog: pytest.LogCaptureFixture
) -> None:
    token = handing.granted(subject="/remote/hospital/mallory", may_narrow=1)
    await is_refused(handing, [handing.handed(token)], caplog, GrantForOther)


@pytest.mark.parametrize("what", ["the grant", "the narrowing", "the key that handed it on"])
async def test_what_is_revoked_on_the_way_ends_what_comes_after(
    handing: Handing, what: str, caplog: pytest.LogCaptureFixture
) -> None:
    handed = handing.handed(handing.token)
    match what:
        case "the grant":
            entry = peek(handing.token).id
        case "the narrowing":
            entry = peek(handed).id
        case _:
            entry = handing.site.identity(MALLORY).thumbprint
    (link,) = unpack(handed).narrowings
    half = 0x7FFFFFFF800000007FFFFFFFFFFFFFFFDE737D56D38BCF4279DCE5617E3192A8
    order = 2 * half + 1
    twin = link[:-32] + (order - int.from_bytes(link[-32:])).to_bytes(32)
    await revoke_entry(handing, entry)
    for token in (handed, pack_chain(handing.token, [twin])):
        await is_refused(handing, [token], caplog, GrantRevoked)


async def revoke_entry(handing: Handing, entry: bytes) -> None:
    """Revoke an id or a key, until the nodes have the list."""
    site = handing.site
    site.authority.revoke(entry, "test", site.now())
    await revoke_everywhere(site, handing.witness, secrets.token_bytes(32))


async def test_a_condition_of_ones_own_is_no_oracle(handing: Handing) -> None:
    """The publisher reads it after the filter: what holds then holds for every message."""
    coarse = Restriction("geometry_msgs/PoseStamped", (), HIDDEN)
    token = handing.granted(may_narrow=1, permissions=(Permission(TOPIC, Right.SUBSCRIBE, coarse),))
    asks = Restriction("geometry_msgs/PoseStamped", ("msg.header.frame_id == 'hidden'",))
    handed = handing.handed(token, Permission(TOPIC, Right.SUBSCRIBE, asks))
    reply = await handing.ask(handed)
    assert reply.fields["callerid"] == b"/robot"
    assert b"hidden" in reply.after
