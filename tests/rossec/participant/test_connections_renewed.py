"""What a peer renews on a connection of the table."""

from contextlib import nullcontext, suppress
from types import SimpleNamespace
from typing import Any

import pytest

from rossec.errors import ChannelClosed
from tests.rossec.participant import test_connections
from tests.rossec.participant.test_connections import (
    KEY,
    NOW,
    Connection,
    make_connection,
    table,
    trust_status,
)
from tests.support.site import Site

_clock, site = test_connections._clock, test_connections.site  # fixtures


@pytest.mark.parametrize("goes_on", [True, False])
def test_what_the_peer_presented_since_may_carry_a_connection_on(site: Site, goes_on: bool) -> None:
    """In the check of a call and in that of the clock, before the connection is cut."""
    connections = table(trust_status(site))

    def continues(connection: Connection, _: int) -> bool:
        connection.ends = NOW + 5 if goes_on else NOW
        return goes_on

    renewed: Any = SimpleNamespace(continues=continues, retry=lambda *_: None, opened=lambda *_: None)
    connections.renewed = renewed
    for ask in (connections.check, lambda _: connections.cut_ended(NOW)):
        made = make_connection()
        connections.add(made)
        made.ends = NOW
        with nullcontext() if goes_on else suppress(ChannelClosed):
            ask(made)
        assert (made.stream.reasons == []) is goes_on
        connections.discard(made)


def test_a_table_that_is_closed_carries_nothing_on(site: Site) -> None:
    connections, made = table(trust_status(site)), make_connection()
    connections.close("the end")
    connections.renewed = Any  # type: ignore[assignment]  # not asked
    with pytest.raises(ChannelClosed, match="the end"):
        connections.check(made)


def test_a_renewed_identity_is_the_one_that_counts(site: Site) -> None:
    """Its issuer may be revoked here: the connection is cut at once."""
    connections, made = table(trust_status(site)), make_connection()
    told: list[Any] = []
    connections.renewed = SimpleNamespace(  # type: ignore[assignment]
        opened=lambda connection, on_renewed: told.append(on_renewed),
        continues=lambda *_: False,
        retry=lambda *_: None,
    )
    made.stream.peer.thumbprint = KEY
    connections.accept(made.stream, made.stream.peer)
    connections.add(made)
    made.stream.peer = SimpleNamespace(**{**vars(made.stream.peer), "keys": (KEY, b"n" * 32)})
    told[0](made)
    assert made.stream.reasons == []
    assert connections._accepted[made.stream].peer is made.stream.peer
    made.ends = NOW
    told[0](made)
    assert made.stream.reasons == ["its grant or its certificate has expired"]
