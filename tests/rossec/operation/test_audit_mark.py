"""The first line of an audit file, which only the master can sign."""

import pytest

from ca.keys.signing import KeySigner, thumbprint
from rossec.errors import ConfigurationError
from rossec.host.audit import FIRST, Entry, check_beginning, mark
from tests.support.pki import new_signer

BEFORE = "ab" * 32


@pytest.fixture
def signer() -> KeySigner:
    return new_signer()


def refusal(first: Entry, key: bytes | None = None, after: str | None = None) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught:
        check_beginning(first, key, after)
    return caught.value


def test_the_very_first_line(signer: KeySigner) -> None:
    first, key = mark(signer, FIRST, 1.5), thumbprint(signer.public_key)
    assert first["text"] == "the audit begins"
    assert check_beginning(first, key) == ""
    assert key.hex() in check_beginning(first)


def test_the_first_line_of_a_later_file(signer: KeySigner) -> None:
    first, key = mark(signer, BEFORE, 1.5), thumbprint(signer.public_key)
    assert first["text"] == "the audit goes on in a new file"
    assert check_beginning(first, key) == f"it continues from {BEFORE}, not among these files"
    assert check_beginning(first, key, BEFORE) == ""


def test_a_first_line_without_a_signature(signer: KeySigner) -> None:
    error = refusal({"before": BEFORE, "at": 1.0, "text": "denied"})
    assert str(error) == "the beginning of the audit is missing"
    assert "--after" in error.hint
    old = {"before": FIRST, "at": 1.0, "text": "the master began"}
    assert "of an older version" in check_beginning(old)
    assert check_beginning({"before": BEFORE}, after=BEFORE) == ""
    assert "is missing" in str(refusal({"before": BEFORE}, after="cd" * 32))


def test_a_line_of_another_key(signer: KeySigner) -> None:
    error = refusal(mark(new_signer(), BEFORE, 1.0), thumbprint(signer.public_key))
    assert "begins with a line of another key" in str(error)
    assert "--key" in error.hint


@pytest.mark.parametrize(
    "change",
    [
        {"before": "cd" * 32},
        {"at": 2.0},
        {"text": "the audit begins"},
        {"key": "zz"},
        {"key": 5},
        {"key": "04" + "00" * 64},
        {"signature": "00" * 64},
        {"signature": ""},
        {"signature": None},
    ],
)
def test_a_forged_line(signer: KeySigner, change: Entry) -> None:
    assert "is forged" in str(refusal({**mark(signer, BEFORE, 1.0), **change}))


def test_an_incomplete_line(signer: KeySigner) -> None:
    first = mark(signer, BEFORE, 1.0)
    del first["key"]
    assert "is forged" in str(refusal(first))
