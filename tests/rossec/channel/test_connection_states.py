"""Frames that the state table does not have."""

import pytest

from rossec.channel.connection import Connection
from rossec.channel.edhoc.messages import encode_error
from rossec.channel.negotiation import TABLE, ConnectionState
from rossec.channel.records import Frame, frame
from rossec.errors import ProtocolViolation
from tests.support.wire import End, joined, wire


def test_a_state_that_is_not_in_the_table_ends_the_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    w = joined()
    monkeypatch.setattr(Connection, "_on_data_end", lambda *_: ConnectionState.CLOSING)
    w.left.core.send_unit(b"x")
    with pytest.raises(RuntimeError, match=r"_on_data_end led to state ConnectionState.CLOSING"):
        w.right.give(w.left.take())
    assert w.right.core.state is ConnectionState.CLOSED
    assert w.right.core.data_to_send() == b""


HANDSHAKE_STATES = (
    ConnectionState.WAIT_1,
    ConnectionState.WAIT_2,
    ConnectionState.WAIT_3,
    ConnectionState.WAIT_4,
)


@pytest.mark.parametrize(
    ("state", "kind"),
    [(state, kind) for state in HANDSHAKE_STATES for kind in Frame if (state, kind) not in TABLE],
)
def test_a_frame_that_is_not_in_the_table_ends_the_connection(state: ConnectionState, kind: Frame) -> None:
    end = _in_state(state)
    end.give(frame(kind, b"\0" * 20))
    assert isinstance(end.error, ProtocolViolation)
    assert end.core.state is ConnectionState.CLOSED
    sent = end.take()
    assert (sent == frame(Frame.ERROR, encode_error(1, "handshake refused"))) == (
        state is not ConnectionState.WAIT_4
    )


@pytest.mark.parametrize("kind", [0, 1, 2, 10, 15])
def test_frames_that_an_open_connection_does_not_know(kind: int) -> None:
    w = joined()
    w.right.give(bytes([kind << 4, 0, 0, 20]) + bytes(20))
    assert isinstance(w.right.error, ProtocolViolation)
    assert w.right.take() == b""


def _in_state(state: ConnectionState) -> End:
    w = wire()
    if state is ConnectionState.WAIT_2:
        w.left.take()
        w.left.core.state = ConnectionState.WAIT_2
        return w.left
    if state is ConnectionState.WAIT_1:
        w.right.give(w.left.take()[:16])
        return w.right
    w.right.give(w.left.take())
    w.left.give(w.right.take())
    w.left.take()
    return w.right if state is ConnectionState.WAIT_3 else w.left
