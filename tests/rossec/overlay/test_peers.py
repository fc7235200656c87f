"""The relays of other sites, and the file of them."""

import json
from dataclasses import replace
from typing import Any

import pytest

from ca.certificates import Identity
from rossec.errors import ConfigurationError, RelayRefused
from rossec.overlay.documents import MAX_PEERS, MAX_PEERS_FILE, Peer, checked_peers, read_peers, write_peers
from tests.support.domains import Pair, SomeNode

KEY = "rossec/1/office/" + "a" * 32
OFFICE = Peer("office", "0" * 32, "office", "/relay", KEY)
ATTIC = Peer("attic", "1" * 32, "", "/relay/attic", KEY.replace("a", "b"))
NEW = Peer("ward", "2" * 32)


def test_the_file_has_every_peer_again() -> None:
    peers = checked_peers([OFFICE, ATTIC, NEW])
    assert read_peers(write_peers(peers), "overlay.json") == peers


@pytest.mark.parametrize("length", range(0, 420, 7))
def test_a_part_of_the_file_is_refused(length: int) -> None:
    data = write_peers(checked_peers([OFFICE]))
    with pytest.raises(ConfigurationError, match=r"overlay\.json"):
        read_peers(data[: min(length, len(data) - 3)], "overlay.json")


@pytest.mark.parametrize(
    "changes",
    [
        {"label": 1},
        {"label": "a b"},
        {"box": "0"},
        {"box": "A" * 32},
        {"domain": 7},
        {"domain": "a b"},
        {"relay": "/robot"},
        {"inbox": "rossec/1/office/**"},
        {"more": 1},
        {"domain": None},
        {"relay": "", "inbox": KEY},
        {"inbox": ""},
    ],
)
def test_a_peer_in_another_form_is_refused(changes: dict[str, Any]) -> None:
    found = json.loads(write_peers({"office": OFFICE}))
    found["peers"][0] |= changes
    with pytest.raises(ConfigurationError):
        read_peers(json.dumps(found).encode(), "overlay.json")


@pytest.mark.parametrize("data", [b"[]", b"{}", b'{"rossec-overlay": 2, "peers": []}'])
def test_another_file_is_refused(data: bytes) -> None:
    with pytest.raises(ConfigurationError, match=r"^overlay\.json: th"):
        read_peers(data, "overlay.json")
    with pytest.raises(ConfigurationError, match="at most 65536 bytes"):
        read_peers(b" " * (MAX_PEERS_FILE + 1), "overlay.json")
    with pytest.raises(ConfigurationError, match="not a list of peers"):
        read_peers(b'{"rossec-overlay": 1, "peers": {}}', "overlay.json")
    with pytest.raises(ConfigurationError, match="not JSON"):
        read_peers(b'{"rossec-overlay": 1, "peers": [], "peers": []}', "overlay.json")


@pytest.mark.parametrize(
    ("other", "error"),
    [
        (replace(ATTIC, label="office"), "two peers are called office"),
        (replace(OFFICE, label="clinic", box="5" * 32, inbox=ATTIC.inbox), "are one relay"),
        (replace(ATTIC, box=OFFICE.box), "are one relay"),
        (replace(ATTIC, inbox=OFFICE.inbox), "are one relay"),
    ],
)
def test_a_peer_is_there_once(other: Peer, error: str) -> None:
    with pytest.raises(ConfigurationError, match=error):
        checked_peers([OFFICE, other])


def test_there_is_a_limit_of_peers() -> None:
    many = [Peer(f"p{number}", f"{number:032x}") for number in range(MAX_PEERS + 1)]
    assert len(checked_peers(many[:-1])) == MAX_PEERS
    with pytest.raises(ConfigurationError, match="at most 64"):
        checked_peers(many)


def test_the_name_of_a_peer_here() -> None:
    assert (OFFICE.name, OFFICE.shown) == ("/remote/office/relay", "office:/relay")
    assert (ATTIC.name, ATTIC.shown) == ("/relay/attic", "/relay/attic")
    assert NEW.shown == ""
    assert not NEW.is_complete
    assert KEY not in repr(OFFICE)
    assert OFFICE.box not in repr(OFFICE)


def test_only_the_peer_itself_is_admitted_to_its_inbox() -> None:
    pair = Pair(admitted=("/**",))
    relay = SomeNode(pair.hospital, "/relay")
    found: Identity = pair.peer(relay)
    hospital = replace(OFFICE, domain="hospital")
    hospital.check(found)
    for wrong in (
        replace(hospital, domain="office"),
        replace(hospital, domain=""),
        NEW,
        replace(hospital, relay="/relay/attic"),
    ):
        with pytest.raises(RelayRefused, match="hospital:/relay is at the inbox of"):
            wrong.check(found)
    own = SomeNode(pair.home, "/relay").identity
    replace(ATTIC, relay="/relay").check(own)
    for wrong in (hospital, ATTIC):
        with pytest.raises(RelayRefused, match="/relay is at the inbox"):
            wrong.check(own)
