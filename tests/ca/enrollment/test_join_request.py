from dataclasses import replace

import pytest

from ca.enrollment.invitation import MAX_REQUEST_SIZE, InvitationCode, JoinRequest, sign_proof
from ca.errors import EnrollmentMessageRefused, JoinRefused
from tests.support.pki import NOW

CODE = InvitationCode(bytes(32), bytes(16), NOW, "192.168.1.7:11318", "/fleet/*")
AGREED = bytes(range(32))


def request_for(name: str = "/fleet/a", csr: bytes = b"csr", metadata: bytes = b"") -> JoinRequest:
    proof = sign_proof(CODE.signer, AGREED, csr, name, metadata)
    return JoinRequest(CODE.id, AGREED, name, csr, proof, metadata)


def test_the_octets_as_documented() -> None:
    made = request_for()
    data = made.to_bytes()
    sizes = len(made.proof).to_bytes(2) + len(made.name).to_bytes(1) + bytes(2)
    assert data == CODE.id + AGREED + sizes + made.proof + b"/fleet/a" + b"csr"
    made = request_for(metadata=b"<node/>")
    sizes = len(made.proof).to_bytes(2) + len(made.name).to_bytes(1) + (7).to_bytes(2)
    whole = CODE.id + AGREED + sizes + made.proof + b"/fleet/a" + b"<node/>" + b"csr"
    assert made.to_bytes() == whole


@pytest.mark.parametrize(
    "made",
    [
        request_for(),
        request_for("/" + "a" * 254, bytes(2048), bytes(4096)),
        request_for("", b""),
        request_for("", b"", b"<node/>"),
    ],
)
def test_the_same_comes_back(made: JoinRequest) -> None:
    assert JoinRequest.from_bytes(made.to_bytes()) == made
    JoinRequest.from_bytes(made.to_bytes()).verify(CODE.key)


def test_what_is_cut_short_is_refused_or_not_proved() -> None:
    data = request_for().to_bytes()
    for end in range(len(data)):
        with pytest.raises((EnrollmentMessageRefused, JoinRefused)):
            JoinRequest.from_bytes(data[:end]).verify(CODE.key)
    with pytest.raises(JoinRefused):
        JoinRequest.from_bytes(data + b"\0").verify(CODE.key)


@pytest.mark.parametrize(
    "data",
    [
        bytes(MAX_REQUEST_SIZE + 1),
        bytes(64) + (513).to_bytes(2) + bytes(3) + bytes(513),
        bytes(64) + b"\0\0\2\0\0" + b"/\xff",
        bytes(64) + b"\0\0\0" + (4097).to_bytes(2) + bytes(4097),
        bytes(69) + bytes(2049),
    ],
)
def test_wrong_sizes(data: bytes) -> None:
    with pytest.raises(EnrollmentMessageRefused):
        JoinRequest.from_bytes(data)


@pytest.mark.parametrize(
    "change",
    [
        {"invitation": b""},
        {"transcript": b""},
        {"name": "/é"},
        {"name": "/" + "a" * 255},
        {"csr": bytes(2049)},
        {"proof": bytes(513)},
        {"metadata": bytes(4097)},
    ],
)
def test_parts_that_do_not_fit(change: dict[str, object]) -> None:
    with pytest.raises(EnrollmentMessageRefused):
        replace(request_for(), **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "change",
    [
        {"name": "/fleet/b"},
        {"csr": b"x"},
        {"transcript": bytes(32)},
        {"proof": b""},
        {"metadata": b"<node/>"},
    ],
)
def test_the_proof_is_about_every_part(change: dict[str, object]) -> None:
    with pytest.raises(JoinRefused):
        replace(request_for(), **change).verify(CODE.key)  # type: ignore[arg-type]
    with pytest.raises(JoinRefused):
        request_for().verify(replace(CODE, secret=b"1" * 16).key)
