"""The vectors inside the channel: connection headers, calls and the grants in them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ca.encoding import decode
from ca.revocation.lists import Timestamp, digest
from ca.revocation.trust_status import Revocations
from grants.errors import GrantError
from grants.model import Right
from rossec.participant.access import FIELD, Access
from rossec.ros import tcpros
from rossec.ros.xmlrpc import load_call
from tests.support.domains import alone
from tests.support.site import Site
from tests.vectors import make_grants, make_wire

NOW, TOPIC = make_grants.NOW, "/robot/pose"


def load(stem: str) -> list[Any]:
    vectors: list[Any] = json.loads((make_wire.FOLDER / f"{stem}.json").read_text())
    assert vectors
    return vectors


@pytest.fixture
def site(tmp_path: Path) -> Site:
    site = Site(tmp_path / "site", clock=lambda: NOW)
    site.enroll("/heating")
    return site


def fresh(site: Site) -> Revocations:
    revocations = Revocations(site.anchor.public_key)
    data = site.authority.store.newest_list()
    assert data is not None
    revocations.update(data, NOW)
    assert revocations.current is not None
    revocations.confirm(Timestamp(revocations.current.seq, digest(data), NOW, 30), NOW)
    return revocations


@pytest.mark.parametrize("vector", load("presented"), ids=lambda vector: vector["name"])
def test_the_connection_headers_of_the_vectors(site: Site, vector: dict[str, Any]) -> None:
    anchor = replace(site.anchor, public_key=make_grants.CA.public_key)
    peer = replace(site.identity("/heating"), thumbprint=make_grants.DRAFT.holder)
    access, shown = Access(alone(anchor, fresh(site))), bytes.fromhex(vector["data"])
    if vector["verdict"] == "enough":
        decision = access.authorize(peer, shown, Right.SUBSCRIBE, TOPIC, NOW)
        assert decision.expires == make_grants.DRAFT.expires
        return
    with pytest.raises(GrantError) as refused:
        access.authorize(peer, shown, Right.SUBSCRIBE, TOPIC, NOW)
    array_is_refused = "list of" in str(refused.value)
    assert array_is_refused == (vector["verdict"] == "malformed")


def test_the_first_units_of_the_vectors() -> None:
    subscriber, without, call = (bytes.fromhex(vector["data"]) for vector in load("units"))
    fields = tcpros.decode(subscriber[4:])
    assert fields["topic"] == TOPIC.encode()
    assert decode(fields[FIELD], limit=1 << 16) == [make_grants.GOOD] * 2
    assert tcpros.decode(without[4:])[FIELD] == b"\x80"
    method, (caller, shown) = load_call(call)
    assert (method, caller) == ("rossec.presentGrants", "/heating")
    assert shown == fields[FIELD]
