"""The journal: changes are read as written, and only complete records."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import XmlRpcRefused
from rossec.master.state.parameter_journal import (
    MAGIC,
    ParameterChange,
    decode,
    encode,
    replay,
    snapshot,
)
from rossec.master.state.parameters import Parameters
from rossec.ros import xmlrpc

CHANGES = [
    ParameterChange("/a", 1),
    ParameterChange("/b/c", {"d": [True, 2.5, "caf\u00e9"], "e": b"\0"}),
    ParameterChange("/a", deleted=True),
    ParameterChange("/", {"x": 1}),
]
WHOLE = MAGIC + b"".join(map(encode, CHANGES))


def test_decode_inverts_encode() -> None:
    assert decode(WHOLE) == (CHANGES, len(WHOLE))
    assert decode(MAGIC) == ([], len(MAGIC))


@given(st.integers(0, len(WHOLE) - 1))
def test_a_truncated_record_ends_the_journal(size: int) -> None:
    changes, good = decode(WHOLE[:size])
    assert changes == CHANGES[: len(changes)]
    assert good <= size
    assert decode(WHOLE[:good]) == (changes, good)


@given(st.integers(0, len(WHOLE) - 1), st.integers(1, 255))
def test_a_damaged_record_ends_the_journal(at: int, flip: int) -> None:
    damaged = bytearray(WHOLE)
    damaged[at] ^= flip
    changes, _ = decode(bytes(damaged))
    assert changes == CHANGES[: len(changes)]
    assert len(changes) < len(CHANGES)


@pytest.mark.parametrize(
    "call",
    [
        b"no xml",
        xmlrpc.dump_call("shutdown", ("/a",)),
        xmlrpc.dump_call("setParam", ("/a",)),
        xmlrpc.dump_call("setParam", (1, 2)),
        xmlrpc.dump_call("deleteParam", ("/a", 2)),
    ],
)
def test_an_unknown_record_ends_the_journal(call: bytes) -> None:
    import zlib

    record = len(call).to_bytes(4) + zlib.crc32(call).to_bytes(4) + call
    assert decode(MAGIC + record + encode(CHANGES[0])) == ([], len(MAGIC))


def test_replay_and_snapshot_lead_to_the_same() -> None:
    parameters, again = Parameters(), Parameters()
    replay(
        parameters, [*CHANGES[:2], ParameterChange("/none", deleted=True), ParameterChange("/", 5)]
    )
    assert parameters.get("/") == {"a": 1, "b": {"c": CHANGES[1].value}}
    replay(again, decode(snapshot(parameters))[0])
    assert again.get("/") == parameters.get("/")
    assert snapshot(Parameters()) == MAGIC


def test_a_value_that_cannot_be_encoded_is_refused() -> None:
    with pytest.raises(XmlRpcRefused):
        encode(ParameterChange("/a", None))
