from dataclasses import replace

import pytest

from ca.enrollment import invitation
from ca.enrollment.invitation import InvitationCode
from ca.errors import CodeRefused
from tests.support.pki import NOW

CODE = InvitationCode(bytes(32), bytes(16), NOW, "192.168.1.7:11318", "/fleet/*")
LONG = replace(CODE, pattern="/" + "a" * 250)


def test_a_short_record_as_specified() -> None:
    data, body = invitation.write(CODE), CODE.body()
    kind = b"application/vnd.rossec.join"
    assert data == bytes([0xD2, len(kind), len(body)]) + kind + body
    assert len(data) + 3 <= 144  # with its TLV it fits on an NTAG213


def test_a_long_record_as_specified() -> None:
    data, body = invitation.write(LONG), LONG.body()
    assert data.startswith(bytes([0xC2, 27]) + len(body).to_bytes(4) + b"application/")
    assert data.endswith(body)


@pytest.mark.parametrize("code", [CODE, LONG])
def test_the_same_comes_back(code: InvitationCode) -> None:
    assert invitation.read(invitation.write(code)) == code
    assert invitation.is_message(invitation.write(code))
    assert not invitation.is_message(code.text().encode())


@pytest.mark.parametrize("code", [CODE, LONG])
def test_nothing_else_is_read(code: InvitationCode) -> None:
    data = invitation.write(code)
    for end in range(len(data)):
        with pytest.raises(CodeRefused):
            invitation.read(data[:end])
    for at in range(len(data)):
        with pytest.raises(CodeRefused):
            invitation.read(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
    for more in (b"\0", data, bytes(1000)):
        with pytest.raises(CodeRefused):
            invitation.read(data + more)
