"""The vectors of the compact form: their bytes do not change, and mean what they say."""

import json
from typing import Any

import pytest

from rossec.errors import CompactRefused
from rossec.ros import calls, xmlrpc
from rossec.ros.xmlrpc import Fault
from tests.rossec.ros.values import shape
from tests.vectors import make_calls
from tests.vectors.make_calls import TURN

VECTORS: list[dict[str, Any]] = json.loads(make_calls.FILE.read_text())


def test_the_program_writes_this_file() -> None:
    assert make_calls.text() == make_calls.FILE.read_text()
    assert len(VECTORS) > 60


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: f"{vector['kind']}: {vector['name']}")
def test_a_vector(vector: dict[str, Any]) -> None:
    unit = bytes.fromhex(vector["data"])
    if "xml" not in vector:
        with pytest.raises(CompactRefused):
            calls.load_compact_call(unit, TURN)
    elif vector["kind"] == "call":
        call, same = calls.load_compact_call(unit, TURN), xmlrpc.load_call(vector["xml"].encode())
        assert call.method == same.method
        assert shape(list(call.params)) == shape(list(same.params))
    else:
        answer = calls.load_compact_answer(unit, TURN, "getParam")
        assert shape(answer_of(answer)) == shape(said_by(vector["xml"].encode()))


def answer_of(answer: object) -> object:
    return (answer.faultCode, answer.faultString) if isinstance(answer, Fault) else answer


def said_by(body: bytes) -> object:
    try:
        return xmlrpc.load_response(body)
    except Fault as fault:
        return fault.faultCode, fault.faultString
