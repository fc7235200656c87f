"""The vectors of grants: each gives exactly its result or its named error."""

import json
import struct
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from grants import document, errors
from grants.filters.compile import compile_filter
from grants.filters.layout import parse
from grants.model import filter_rules
from grants.renewal import open_delegation, renew
from grants.token import Verifier
from tests.grants.filters.test_pictures import IMAGE
from tests.vectors import make_grants

Vectors = list[dict[str, Any]]


IMAGE_LAYOUT = parse("sensor_msgs/Image", IMAGE)


def load(stem: str) -> Vectors:
    found: Vectors = json.loads((make_grants.FOLDER / f"{stem}.json").read_text())
    return found


def key(encoded: str) -> ec.EllipticCurvePublicKey:
    return ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), bytes.fromhex(encoded))


VALID, REFUSED, RENEWALS = (load(stem) for stem in ("valid", "refused", "renewals"))
TOKENS, FILTERS, TRUNCATIONS = (load(stem) for stem in ("tokens", "filters", "truncations"))
PICTURES = load("pictures")


def test_the_number_of_vectors() -> None:
    assert len(VALID) >= 6
    assert len(REFUSED) >= 70
    assert min(len(TOKENS), len(FILTERS), len(TRUNCATIONS)) >= 8
    assert len(RENEWALS) >= 10
    for vectors in (VALID, REFUSED, RENEWALS):
        assert len({vector["name"] for vector in vectors}) == len(vectors)


def test_the_files_equal_the_output_of_the_program() -> None:
    for stem, vectors in make_grants.build().items():
        assert (make_grants.FOLDER / f"{stem}.json").read_text() == make_grants.text(vectors)


@pytest.mark.parametrize("vector", VALID, ids=lambda vector: vector["name"])
def test_valid_grants(vector: dict[str, Any]) -> None:
    data = bytes.fromhex(vector["data"])
    opened = document.open_grant(data, key(vector["ca_key"]), vector["now"])
    assert opened.id.hex() == vector["id"]


@pytest.mark.parametrize("vector", REFUSED, ids=lambda vector: vector["name"])
def test_refused_grants(vector: dict[str, Any]) -> None:
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
            grant,
            bytes.fromhex(vector["ticket"]),
            delegation,
            key(vector["key"]),
            now=vector["now"],
            seq=vector["seq"],
            check=lambda *_: None,
        )

    if vector["failure"] is None:
        renewed()
        return
    failure = getattr(errors, vector["failure"])
    with pytest.raises(failure) as refused:
        renewed()
    assert type(refused.value) is failure


@pytest.mark.parametrize("vector", TOKENS, ids=lambda vector: vector["name"])
def test_tokens(vector: dict[str, Any]) -> None:
    ca, delegate = key(vector["ca_key"]), key(vector["key"])
    verifier = Verifier(ca, "home", (delegate,), vector["seq"], lambda *_: None)
    data = bytes.fromhex(vector["data"])
    if vector["failure"] is None:
        assert verifier.open(data, vector["now"]).expires > vector["now"]
        return
    failure = getattr(errors, vector["failure"])
    with pytest.raises(failure) as refused:
        verifier.open(data, vector["now"])
    assert type(refused.value) is failure


@pytest.mark.parametrize("vector", FILTERS, ids=lambda vector: vector["name"])
def test_filters(vector: dict[str, Any]) -> None:
    data, ca = bytes.fromhex(vector["data"]), make_grants.CA.public_key
    if vector["valid"]:
        assert document.open_grant(data, ca, make_grants.NOW).permissions[0].restriction
        return
    with pytest.raises(errors.GrantMalformed):
        document.open_grant(data, ca, make_grants.NOW)


@pytest.mark.parametrize("vector", TRUNCATIONS, ids=lambda vector: vector["name"])
def test_truncations(vector: dict[str, Any]) -> None:
    layout = parse("std_msgs/String", "string data")
    rules = filter_rules({"data": {"truncate": {"length": vector["length"]}}})
    truncate = compile_filter(layout, rules)
    data = bytes.fromhex(vector["data"])
    message = len(data).to_bytes(4, "little") + data
    if vector["result"] is None:
        with pytest.raises(errors.MessageRefused):
            truncate(message)
        return
    left = bytes.fromhex(vector["result"])
    assert b"".join(truncate(message)) == len(left).to_bytes(4, "little") + left


@pytest.mark.parametrize("vector", PICTURES, ids=lambda vector: vector["name"])
def test_pictures(vector: dict[str, Any]) -> None:
    parameters, result = vector["parameters"], vector["result"]
    pixelate = compile_filter(IMAGE_LAYOUT, filter_rules({"data": {"pixelate": parameters}}))
    encoding = vector["encoding"].encode()
    head = bytes(12) + bytes(4) + struct.pack("<II", vector["height"], vector["width"])
    head += struct.pack("<I", len(encoding)) + encoding + struct.pack("<BI", 0, vector["step"])
    data = bytes.fromhex(vector["data"])
    message = head + struct.pack("<I", len(data)) + data
    if result is None:
        with pytest.raises(errors.MessageRefused):
            pixelate(message)
        return
    assert b"".join(pixelate(message)) == message[: -len(data)] + bytes.fromhex(result)
