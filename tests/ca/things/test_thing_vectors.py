"""The published vectors of things."""

import json

import pytest

from ca.errors import CAError
from ca.keys.signing import from_coordinates
from ca.things import ThingKey, open_statement, peek_statement, read_ccs
from tests.vectors.make_things import FILE, STATEMENTS, vectors

V = json.loads(FILE.read_text())
KEY = from_coordinates(bytes.fromhex(V["authority"]["x_y"]))


def test_the_vectors_are_those_that_are_made() -> None:
    assert vectors() == V


@pytest.mark.parametrize("name", V["statements"])
def test_a_statement(name: str) -> None:
    data, expected = bytes.fromhex(V["statements"][name]["data"]), STATEMENTS[name]
    assert open_statement(data, KEY, V["now"], domain=V["domain"]) == expected
    assert peek_statement(data).id == expected.id == bytes.fromhex(V["statements"][name]["id"])


@pytest.mark.parametrize("name", V["refused"])
def test_a_statement_with_a_flaw(name: str) -> None:
    vector = V["refused"][name]
    with pytest.raises(CAError) as caught:
        open_statement(bytes.fromhex(vector["data"]), KEY, V["now"], domain=V["domain"])
    assert type(caught.value).__name__ == vector["error"]


@pytest.mark.parametrize("name", V["credentials"])
def test_a_credential(name: str) -> None:
    data = bytes.fromhex(V["credentials"][name])
    key = read_ccs(data)
    assert key == STATEMENTS[name].credential
    assert isinstance(key, ThingKey)
    assert key.ccs == data


@pytest.mark.parametrize("name", V["refused_credentials"])
def test_a_credential_with_a_flaw(name: str) -> None:
    with pytest.raises(CAError):
        read_ccs(bytes.fromhex(V["refused_credentials"][name]))
