"""ConnectionShares of connections: shares by source, and by session."""

from functools import partial

import pytest

from rossec.console.server import serving
from rossec.console.server.serving import ConnectionPlace, ConnectionShares


def take(all_places: ConnectionShares, address: str, *, is_other_user: bool = False) -> ConnectionPlace:
    place = all_places.take(address, is_other_user=is_other_user)
    assert place is not None
    return place


@pytest.mark.attack("console-connections")
def test_a_source_that_has_most_makes_room() -> None:
    ended: list[str] = []
    all_places = ConnectionShares()
    for network in range(4):
        for host in range(64):
            address = f"2001:db8:0:{network}::{host:x}"
            take(all_places, address).closed_by(partial(ended.append, address))
    assert len(all_places) == serving.STRANGERS.total
    take(all_places, "192.0.2.1")
    assert ended == ["2001:db8:0:0::0"]


@pytest.mark.attack("console-connections")
def test_an_address_that_has_most_makes_room_in_its_network() -> None:
    ended: list[str] = []
    all_places = ConnectionShares()
    for _ in range(serving.STRANGERS.per_address):
        take(all_places, "fe80::1").closed_by(lambda: ended.append("fe80::1"))
    take(all_places, "fe80::2")
    assert ended == ["fe80::1"]
    assert all_places.take("fe80::1", is_other_user=False) is None


def test_a_session_has_a_place_that_strangers_do_not_take() -> None:
    ended: list[str] = []
    all_places = ConnectionShares()
    place = take(all_places, "192.0.2.1")
    place.closed_by(lambda: ended.append("owner"))
    for _ in range(2):
        place.belongs_to("phone Anna")
    for last in range(300):
        all_places.take(f"192.0.2.{last % 250}", is_other_user=False)
    assert (ended, len(all_places)) == ([], serving.STRANGERS.total + 1)
    place.release()
    place.release()
    assert len(all_places) == serving.STRANGERS.total


def test_other_users_and_proxies_have_places_of_their_own() -> None:
    all_places = ConnectionShares()
    for _ in range(serving.OTHER_USERS.total):
        take(all_places, "127.0.0.1", is_other_user=True)
    assert all_places.take("127.0.0.1", is_other_user=True) is None
    take(all_places, "127.0.0.1")
    take(all_places, "")
    assert len(all_places) == serving.OTHER_USERS.total + 2


def test_a_session_beyond_its_share_keeps_the_place_of_a_stranger() -> None:
    all_places = ConnectionShares()
    for last in range(serving.SESSIONS.per_address + 5):
        take(all_places, f"192.0.2.{last}").belongs_to("look 1")
    assert len(all_places) == serving.SESSIONS.per_address + 5
