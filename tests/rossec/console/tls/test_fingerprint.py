from hashlib import sha256
from pathlib import Path

import pytest

from rossec.console.tls import certificates
from tests.support.console_tls import new_authority, openssl_verify, pem

BIP39 = "2f5eed53a4727b4bf8880d8f3f199efc90e58503646d9ff8eff3a2ed3b24dbda"


def test_the_words_are_those_of_bip_39() -> None:
    certificates.word_list.cache_clear()
    listed = certificates.word_list()
    assert len(set(listed)) == 2048
    assert sha256("".join(f"{word}\n" for word in listed).encode()).hexdigest() == BIP39


def test_the_first_four_letters_tell_words_apart() -> None:
    assert len({word[:4] for word in certificates.word_list()}) == 2048


def test_the_hex_form_is_what_openssl_shows(tmp_path: Path) -> None:
    import subprocess

    authority = new_authority()
    openssl_verify(tmp_path, authority, pem(authority.data))
    shown = subprocess.check_output(
        ["openssl", "x509", "-in", tmp_path / "root.pem", "-noout", "-fingerprint", "-sha256"], text=True
    )
    assert shown.strip().partition("=")[2] == certificates.in_hex(authority.data)


@pytest.mark.parametrize(
    ("data", "first"),
    # SHA-256 of "" begins e3b0c442..., of "abc" ba7816bf...: 11 bits a word, counted from 0.
    [(b"", 0xE3B0C442 >> 21), (b"abc", 0xBA7816BF >> 21)],
)
def test_words_are_eleven_bits_each(data: bytes, first: int) -> None:
    said = certificates.in_words(data).split()
    assert len(said) == certificates.COUNT
    listed = certificates.word_list()
    assert said[0] == listed[first]
    bits = "".join(f"{listed.index(word):011b}" for word in said)
    assert int(bits, 2).to_bytes(11, "big") == sha256(data).digest()[:11]
