"""The published vectors of foreign domains."""

import json

import pytest

from ca.certificates import TrustAnchor
from ca.domains import Anchors, open_bundle, open_domains
from ca.errors import CAError
from tests.vectors.make_domains import FILE, LISTS, TRUST_BUNDLES, vectors

V = json.loads(FILE.read_text())
OWN = TrustAnchor.load(bytes.fromhex(V["root"]))


def test_the_vectors_are_those_that_are_made() -> None:
    assert vectors() == V


@pytest.mark.parametrize("name", V["lists"])
def test_a_list(name: str) -> None:
    assert open_domains(bytes.fromhex(V["lists"][name]), OWN) == LISTS[name]


@pytest.mark.parametrize("name", V["refused"])
def test_a_list_with_a_flaw(name: str) -> None:
    vector = V["refused"][name]
    with pytest.raises(CAError) as caught:
        open_domains(bytes.fromhex(vector["data"]), OWN)
    assert type(caught.value).__name__ == vector["error"]


@pytest.mark.parametrize("name", V["bundles"])
def test_a_bundle(name: str) -> None:
    assert open_bundle(bytes.fromhex(V["bundles"][name]), V["now"]) == TRUST_BUNDLES[name]


@pytest.mark.parametrize("name", V["refused_bundles"])
def test_a_bundle_with_a_flaw(name: str) -> None:
    vector = V["refused_bundles"][name]
    with pytest.raises(CAError) as caught:
        open_bundle(bytes.fromhex(vector["data"]), V["now"])
    assert type(caught.value).__name__ == vector["error"]


@pytest.mark.parametrize("name", V["chains"])
def test_a_chain(name: str) -> None:
    anchors, vector = Anchors(OWN), V["chains"][name]
    anchors.update(bytes.fromhex(V["lists"]["two domains"]))
    try:
        result = anchors.verify([bytes.fromhex(vector["leaf"])], V["now"]).name
    except CAError as error:
        result = type(error).__name__
    assert result == vector["result"]
