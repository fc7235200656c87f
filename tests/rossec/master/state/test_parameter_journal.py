"""The journal: changes are read as written, and only complete records."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import XmlRpcRefused
from rossec.master.state.journals import (
    PARAMETERS_MAGIC,
    ParameterChange,
    decode_parameters,
    encode_parameter,
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
WHOLE = PARAMETERS_MAGIC + b"".join(map(encode_parameter, CHANGES))


def test_decode_inverts_encode() -> None:
    assert decode_parameters(WHOLE) == (CHANGES, len(WHOLE))
    assert decode_parameters(PARAMETERS_MAGIC) == ([], len(PARAMETERS_MAGIC))


@given(st.integers(0, len(WHOLE) - 1))
def test_a_truncated_record_ends_the_journal(size: int) -> None:
    changes, good = decode_parameters(WHOLE[:size])
    assert changes == CHANGES[: len(changes)]
    assert good <= size
    assert decode_parameters(WHOLE[:good]) == (changes, good)


@given(st.integers(0, len(WHOLE) - 1), st.integers(1, 255))
def test_a_damaged_record_ends_the_journal(at: int, flip: int) -> None:
    damaged = bytearray(WHOLE)
    damaged[at] ^= flip
    changes, _ = decode_parameters(bytes(damaged))
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
    assert decode_parameters(PARAMETERS_MAGIC + record + encode_parameter(CHANGES[0])) == (
        [],
        len(PARAMETERS_MAGIC),
    )


def test_replay_and_snapshot_lead_to_the_same() -> None:
    parameters, again = Parameters(), Parameters()
    replay(parameters, [*CHANGES[:2], ParameterChange("/none", deleted=True), ParameterChange("/", 5)])
    assert parameters.get("/") == {"a": 1, "b": {"c": CHANGES[1].value}}
    replay(again, decode_parameters(snapshot(parameters))[0])
    assert again.get("/") == parameters.get("/")
    assert snapshot(Parameters()) == PARAMETERS_MAGIC


def test_a_value_that_cannot_be_encoded_is_refused() -> None:
    with pytest.raises(XmlRpcRefused):
        encode_parameter(ParameterChange("/a", None))
