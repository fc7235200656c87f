"""The vectors of grants: every one gives exactly its result or its named refusal."""

import json
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from grants import document, errors
from grants.renewal import open_delegation, renew
from tests.vectors import make_grants

Vectors = list[dict[str, Any]]


def load(stem: str) -> Vectors:
    found: Vectors = json.loads((make_grants.FOLDER / f"{stem}.json").read_text())
    return found


def key(encoded: str) -> ec.EllipticCurvePublicKey:
    return ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), bytes.fromhex(encoded))


VALID, REFUSED, RENEWALS = (load(stem) for stem in ("valid", "refused", "renewals"))


def test_the_corpus() -> None:
    assert len(VALID) >= 6
    assert len(REFUSED) >= 70
    assert len(RENEWALS) >= 10
    for vectors in (VALID, REFUSED, RENEWALS):
        assert len({vector["name"] for vector in vectors}) == len(vectors)


def test_the_files_are_what_the_program_writes() -> None:
    for stem, vectors in make_grants.build().items():
        assert (make_grants.FOLDER / f"{stem}.json").read_text() == make_grants.text(vectors)


@pytest.mark.parametrize("vector", VALID, ids=lambda vector: vector["name"])
def test_valid(vector: dict[str, Any]) -> None:
    data = bytes.fromhex(vector["data"])
    opened = document.open_grant(data, key(vector["ca_key"]), vector["now"])
    assert opened.id.hex() == vector["id"]


@pytest.mark.parametrize("vector", REFUSED, ids=lambda vector: vector["name"])
def test_refused(vector: dict[str, Any]) -> None:
    failure = getattr(errors, vector["failure"])
    with pytest.raises(failure) as refused:
        document.open_grant(bytes.fromhex(vector["data"]), key(vector["ca_key"]), vector["now"])
    assert type(refused.value) is failure


@pytest.mark.parametrize("vector", RENEWALS, ids=lambda vector: vector["name"])
def test_renewals(vector: dict[str, Any]) -> None:
    ca_key = key(vector["ca_key"])
    grant = document.verify(bytes.fromhex(vector["grant"]), ca_key)
    delegation = open_delegation(bytes.fromhex(vector["delegation"]), ca_key)

    def renewed() -> object:
        return renew(
            grant, bytes.fromhex(vector["ticket"]), delegation, key(vector["key"]),
            now=vector["now"], seq=vector["seq"], check=lambda *_: None,
        )  # fmt: skip

    if vector["failure"] is None:
        renewed()
        return
    failure = getattr(errors, vector["failure"])
    with pytest.raises(failure) as refused:
        renewed()
    assert type(refused.value) is failure
