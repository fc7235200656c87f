"""A renewed certificate is presented on every open connection, also on one that begins then."""

import gc
from collections.abc import Sequence

from rossec.channel.edhoc.credentials import Credentials, LiveCredentials
from rossec.net.context import OpenConnections
from tests.support.contexts import context
from tests.support.wire import ALICE, renewed, renews


class Stream:
    def __init__(self) -> None:
        self.told: list[Sequence[bytes]] = []

    def present_identity(self, chain: Sequence[bytes]) -> None:
        self.told.append(chain)


def test_open_connections_are_told_and_later_ones_too() -> None:
    streams, before, after = OpenConnections(), Stream(), Stream()
    streams.add(before)
    assert before.told == []
    streams.present((b"new",))
    streams.add(after)
    assert before.told == after.told == [(b"new",)]


def test_connections_that_ended_are_forgotten() -> None:
    streams = OpenConnections()
    streams.add(Stream())
    gc.collect()
    streams.present((b"new",))
    assert len(streams._streams) == 0


def test_credentials_that_are_replaced_tell_the_connections_of_their_context() -> None:
    own, stream = LiveCredentials(ALICE), Stream()
    made = context(own, renews=renews)
    made.open_streams.add(stream)
    own.current = Credentials(ALICE.signer, renewed(ALICE))
    assert stream.told == [renewed(ALICE)]
    assert own.current.certificate == renewed(ALICE)[0]
