import hashlib
import subprocess
import sys
from typing import Any

import pytest

from ca.approvals.passkeys import (
    MAX_ATTESTATION,
    Challenge,
    Purpose,
    Registration,
    check_passkey_name,
    register,
    to_approve,
)
from ca.approvals.statement import NewPasskey
from ca.encoding import encode
from ca.errors import ApprovalRefused
from tests.support import refusal_texts
from tests.support.approving import NOW, registered
from tests.support.passkeys import AT, GET, ORIGIN, RP_ID, UP, UV, Passkey

CHALLENGE = Challenge(Purpose.PASSKEY, bytes(16), "home", ORIGIN, RP_ID, NOW, NOW + 300)
DEVICE = Passkey()


def made(device: Passkey = DEVICE, **changes: Any) -> Registration:
    return Registration(*device.register(changes.pop("challenge", CHALLENGE.digest), **changes))


def test_a_registration_gives_the_passkey() -> None:
    found = register(made(), CHALLENGE, "Ann's phone", NOW)
    assert found == registered(DEVICE)
    assert to_approve(found) == NewPasskey(DEVICE.id, hashlib.sha256(DEVICE.cose_key).digest(), "Ann's phone")
    added = register(made(), CHALLENGE, "Ann's phone", NOW, approval=b"a" * 16)
    assert added == found._replace(approval=b"a" * 16)


def test_an_attestation_that_nobody_asked_for_is_not_read() -> None:
    found = register(made(aaguid=b"m" * 16, form="packed"), CHALLENGE, "phone", NOW)
    assert found.aaguid == b"m" * 16


def test_an_attestation_may_have_another_order() -> None:
    client_data, _ = made()
    data = DEVICE.authenticator_data(UP | UV | AT) + bytes(16) + (32).to_bytes(2) + DEVICE.id
    parts = (encode("authData") + encode(data + DEVICE.cose_key), encode("fmt") + encode("none"))
    attestation = b"\xa3" + parts[1] + encode("attStmt") + b"\xa0" + parts[0]
    other = b"\xa3" + parts[0] + parts[1] + encode("attStmt") + b"\xa0"
    for order in (attestation, other):
        found = register(Registration(client_data, order), CHALLENGE, "Ann's phone", NOW)
        assert found == registered(DEVICE)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"kind": GET}, refusal_texts.OTHER_CHALLENGE),
        ({"challenge": bytes(32)}, refusal_texts.OTHER_CHALLENGE),
        ({"challenge": CHALLENGE._replace(purpose=Purpose.LOGIN).digest}, refusal_texts.OTHER_CHALLENGE),
        ({"origin": "https://evil.example"}, refusal_texts.OTHER_ORIGIN),
        ({"cross_origin": True}, refusal_texts.OTHER_ORIGIN),
        ({"rp_id": "evil.example"}, refusal_texts.OTHER_ORIGIN),
        ({"flags": UP | AT}, refusal_texts.NOT_VERIFIED),
        ({"flags": UV | AT}, refusal_texts.NOT_VERIFIED),
    ],
)
def test_each_check_refuses_by_its_own_error(changes: dict[str, Any], error: str) -> None:
    with pytest.raises(ApprovalRefused, match=error):
        register(made(**changes), CHALLENGE, "phone", NOW)


def attestation(data: bytes) -> Registration:
    value = encode({"fmt": "none", "attStmt": {}, "authData": data})
    return Registration(made().client_data, value)


def test_data_without_a_passkey_is_refused() -> None:
    with pytest.raises(ApprovalRefused, match="made no passkey"):
        register(attestation(DEVICE.authenticator_data(UP | UV)), CHALLENGE, "phone", NOW)


@pytest.mark.parametrize("size", [0, 1024])
def test_a_credential_id_of_an_impossible_length_is_refused(size: int) -> None:
    device = Passkey()
    device.id = bytes(size)
    with pytest.raises(ApprovalRefused, match="made no passkey"):
        register(made(device), CHALLENGE, "phone", NOW)


@pytest.mark.parametrize(
    "key",
    [
        {1: 3, 3: -257, -1: b"n" * 256, -2: b"\1\0\1"},
        {1: 1, 3: -8, -1: 6, -2: bytes(32)},
        {1: 2, 3: -7, -1: 1, -2: bytes(32), -3: bytes(32)},
        {1: 2, 3: -7, -1: 1, -2: bytes(32)},
    ],
)
def test_a_key_that_is_not_es256_is_refused(key: dict[int | str, Any]) -> None:
    data = DEVICE.authenticator_data(UP | UV | AT) + bytes(16) + (2).to_bytes(2) + b"id"
    with pytest.raises(ApprovalRefused, match="the device's key is not"):
        register(attestation(data + encode(key)), CHALLENGE, "phone", NOW)


def test_every_truncated_attestation_is_refused() -> None:
    client_data, whole = made()
    for size in range(len(whole)):
        with pytest.raises(ApprovalRefused):
            register(Registration(client_data, whole[:size]), CHALLENGE, "phone", NOW)
    with pytest.raises(ApprovalRefused, match=refusal_texts.ASSERTION_MALFORMED):
        register(Registration(client_data, whole + b"\0"), CHALLENGE, "phone", NOW)


@pytest.mark.parametrize(
    "wrong", [b"", b"\x00", b"\xa0", b"\x80", b"\xbb" + b"\xff" * 8, b"\x81" * 9999, b"\xff" * 99]
)
def test_an_attestation_of_another_form_is_refused(wrong: bytes) -> None:
    with pytest.raises(ApprovalRefused, match="unknown form"):
        register(Registration(made().client_data, wrong), CHALLENGE, "phone", NOW)


def test_a_large_attestation_is_refused_before_it_is_parsed() -> None:
    wrong = Registration(made().client_data, bytes(MAX_ATTESTATION + 1))
    with pytest.raises(ApprovalRefused, match="bytes of attestation"):
        register(wrong, CHALLENGE, "phone", NOW)


@pytest.mark.parametrize("name", ["", "  ", "a\nb", "\x1b[2J", "x" * 65, "a\u202eb"])
def test_a_name_is_read_on_one_line(name: str) -> None:
    with pytest.raises(ApprovalRefused, match="1 to 64 printable") as error:
        register(made(), CHALLENGE, name, NOW)
    assert error.value.hint == "for example: Ann's phone"
    assert check_passkey_name("Zoë's 電話") == "Zoë's 電話"


def test_without_the_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fido2", None)
    with pytest.raises(ApprovalRefused, match="need the package fido2") as error:
        register(made(), CHALLENGE, "phone", NOW)
    assert error.value.hint == "pip install 'rossec[console]'"


def test_the_record_needs_no_library() -> None:
    program = "import sys, ca.store.record; sys.exit('fido2' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
