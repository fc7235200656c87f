"""A stolen leaf after its intermediate is revoked: refused, and cut where it is (go-spiffe#383)."""

import secrets
from typing import Final

import pytest

from ca.authority import Authority
from ca.certificates import from_pem
from ca.errors import Revoked
from ca.intermediates import build_intermediate_request
from ca.keys import generate
from ca.signer import KeySigner
from rossec.errors import ChannelError
from rossec.succession import sign_intermediate
from rossec.unlocked import OpenAuthority
from tests.support.attacker import EVE, call, expect_refused, fields_for, knock, revoke, signed
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, Witness, until

LIMIT: Final = 2000  # bytes: enough to see that messages come


def below(site: Site, name: str) -> bytes:
    """Let an intermediate certify the node's key anew; returns the intermediate's thumbprint."""
    signer = KeySigner(generate())
    request = build_intermediate_request(signer, site.anchor.domain)
    _, bundle = sign_intermediate(site.authority, request, site.now(), may_enroll=True)
    der, root = from_pem(bundle)
    host = OpenAuthority(Authority(signer, root, der), site.authority.store, site.root)
    identity = site.identity(name)
    leaf = host.authority.certify_again(
        identity, identity.public_key, now=site.now(), serial=secrets.randbits(127)
    )
    site.enroll(name).install(host.bundle(leaf), site.now())
    assert site.identity(name).issuers == (host.authority.issuer.thumbprint,)
    return host.authority.issuer.thumbprint


async def test_a_stolen_leaf_after_its_intermediate_is_revoked(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    intermediate = below(site, EVE)
    stolen = site.enroll(EVE).credentials()
    fields = fields_for(EVE, TOPIC, [signed(site)])
    assert (await knock(witness.topic_port, stolen, fields, LIMIT)).after
    await revoke(site, witness, intermediate)
    heard = await knock(witness.topic_port, stolen, fields)
    expect_refused(heard, caplog, Revoked, "is revoked")
    assert site.master is not None
    with pytest.raises(ChannelError):
        await call(site.master.uri, stolen, "getPid", EVE)


async def test_what_it_holds_already_is_cut(site: Site, witness: Witness) -> None:
    site.subscribe(EVE, TOPIC)
    intermediate = below(site, EVE)
    before = set(witness.publisher.links)
    async with site.node(EVE) as eve:
        sight = await eve.subscriber(TOPIC, POSE)
        await until(lambda: len(witness.publisher.links) == len(before) + 1)
        assert sight is not None
        await revoke(site, witness, intermediate)
        await until(lambda: set(witness.publisher.links) == before)
        assert site.master is not None
        master = site.master
        await until(lambda: EVE not in {stream.peer.name for stream in master._streams})
