import json

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from rossec.errors import ConfigurationError
from rossec.overlay.router_settings import Accounts
from rossec.overlay.router_tls import RouterAuthority, Share, key_pem
from tests.support.pki import NOW


def _authority() -> RouterAuthority:
    return RouterAuthority.create(ec.generate_private_key(ec.SECP256R1()), now=NOW, serial=3)


@pytest.fixture
def share() -> Share:
    return Share(_authority(), Accounts("r" * 43).add("home", "h" * 43), ("tls/a.example.org:7447",))


def test_what_is_shared_is_read_as_it_was_written(share: Share) -> None:
    read = Share.read(share.write())
    assert (read.accounts, read.join) == (share.accounts, share.join)
    assert read.authority.pem == share.authority.pem


def test_no_secret_is_shown(share: Share) -> None:
    assert "r" * 43 not in repr(share)
    assert "PRIVATE" not in repr(share)


@pytest.mark.parametrize(
    "change",
    [
        {"authority": ""},
        {"authority_key": 1},
        {"authority_key": "damaged"},
        {"accounts": {}},
        {"accounts": "{}"},
        {"join": []},
        {"join": "tls/a:1"},
        {"join": ["a"]},
        {"join": ["tls/a:1"] * 17},
        {"more": 1},
        {"authority_key": key_pem(_authority().key).decode()},
    ],
)
def test_a_file_with_anything_else_is_refused(share: Share, change: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError):
        Share.read(json.dumps(json.loads(share.write()) | change).encode())
