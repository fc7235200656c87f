"""The console's TLS authority, in the hands of others."""

import ssl
from pathlib import Path

import pytest
from cryptography import x509

from rossec.console.server.web import load_bundle, make_context
from tests.rossec.console.tls.test_server_context import shake_hands
from tests.support.console_tls import bundle, foreign_leaf, new_authority, new_key, openssl_verify, pem

pytestmark = pytest.mark.attack("stolen-console-tls-key")
BANK = "bank.example"


def test_a_thief_of_its_key_passes_for_no_other_site(tmp_path: Path) -> None:
    """A browser trusts the authority; the thief has the key and serves the bank's name."""
    authority, server, key = new_authority(), make_context(), new_key()
    leaf = foreign_leaf(authority, key, [x509.DNSName(BANK)])
    assert "permitted subtree violation" in openssl_verify(tmp_path, authority, leaf)
    load_bundle(server, bundle(authority, key, leaf))
    with pytest.raises(ssl.SSLCertVerificationError, match="permitted subtree violation"):
        shake_hands(server, authority, BANK)


def test_a_thief_of_its_key_makes_no_second_authority(tmp_path: Path) -> None:
    """A leaf of the authority signs in its turn: it is no authority, and may have none below."""
    authority, key = new_authority(), new_key()
    middle = authority.issue(key.public_key(), now=authority.not_before + 3600, serial=5)
    below = type(authority)(key, middle, authority.name, None, authority.not_before, authority.not_after)
    leaf = foreign_leaf(below, new_key(), [x509.DNSName(authority.name)], x509.Name([]))
    chain = tmp_path / "middle.pem"
    chain.write_bytes(pem(middle))
    said = openssl_verify(tmp_path, authority, leaf, "-untrusted", str(chain))
    assert "invalid CA certificate" in said
