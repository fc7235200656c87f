"""Against a real SoftHSM2 token."""

import hashlib
import itertools
import sys
from typing import Any
from unittest.mock import Mock

import pkcs11
import pytest
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature
from pkcs11 import Attribute, KeyType
from pkcs11.util.ec import encode_named_curve_parameters

from ca.authority import Authority, create_root
from ca.errors import KeyRefused, TokenRefused
from ca.keys.private_keys import DEFAULT_MODULE, KeyUri, TokenSigner, _session
from ca.keys.signing import Profile
from ca.svid import build_request
from tests.support.pki import NOW, new_signer
from tests.support.token import MODULE, PIN, softhsm

_NUMBERS = itertools.count()


@pytest.fixture(autouse=True, scope="module")
def token() -> None:
    softhsm()


def fresh(token: str = "home") -> KeyUri:
    return KeyUri(token, f"key{next(_NUMBERS)}", MODULE)


def test_a_key_made_in_the_token_signs() -> None:
    uri = fresh()
    made = TokenSigner.create(uri, PIN)
    again = TokenSigner.open(uri, PIN)
    assert made.public_key == again.public_key
    signature = again.sign(b"message")
    assert len(signature) == 64
    der = encode_dss_signature(int.from_bytes(signature[:32]), int.from_bytes(signature[32:]))
    made.public_key.verify(der, b"message", ec.ECDSA(hashes.SHA256()))
    made.close()
    again.close()


def test_the_whole_authority_runs_on_it() -> None:
    signer = TokenSigner.create(fresh(), PIN)
    root = create_root(signer, "home", now=NOW, serial=1)
    authority = Authority(signer, root)
    leaf = authority.issue(build_request(new_signer(), "home", "/a"), now=NOW, serial=2)
    assert authority.anchor.verify([leaf], NOW).name == "/a"
    profile = Profile("test+cwt")
    assert profile.open(profile.sign(signer, [1]), signer.public_key) == [1]


def test_the_key_never_leaves_the_token() -> None:
    signer = TokenSigner.create(fresh(), PIN)
    with pytest.raises(pkcs11.exceptions.AttributeSensitive):
        signer._key[Attribute.VALUE]
    assert signer._key[Attribute.EXTRACTABLE] is False


def test_nothing_in_a_token_is_overwritten() -> None:
    uri = fresh()
    TokenSigner.create(uri, PIN).close()
    with pytest.raises(TokenRefused, match=r"already has an object called key[0-9]+"):
        TokenSigner.create(uri, PIN)


def test_a_wrong_pin_says_so() -> None:
    with pytest.raises(TokenRefused, match="the PIN does not open the token spare") as caught:
        TokenSigner.open(fresh("spare"), "000000")
    assert "lock" in caught.value.hint


def test_a_missing_token_or_key_is_refused() -> None:
    with pytest.raises(TokenRefused, match="there is no token elsewhere"):
        TokenSigner.open(fresh("elsewhere"), PIN)
    with pytest.raises(TokenRefused, match=r"the token home has no usable key key[0-9]+: NoSuchKey"):
        TokenSigner.open(fresh(), PIN)
    with pytest.raises(TokenRefused, match=r"there is no PKCS#11 module at /none\.so"):
        TokenSigner.open(KeyUri("home", "x", "/none.so"), PIN)


def generate(uri: KeyUri, curve: str, **private: bool) -> None:
    template = {getattr(Attribute, name): value for name, value in private.items()}
    session = _session(uri, PIN)
    session.create_domain_parameters(
        KeyType.EC, {Attribute.EC_PARAMS: encode_named_curve_parameters(curve)}, local=True
    ).generate_keypair(store=True, label=uri.object, private_template=template)
    session.close()


def test_a_key_that_can_be_taken_out_is_refused() -> None:
    uri = fresh()
    generate(uri, "secp256r1", EXTRACTABLE=True)
    with pytest.raises(KeyRefused, match="is extractable from its token"):
        TokenSigner.open(uri, PIN)


def test_a_key_in_a_token_is_a_p256_key() -> None:
    uri = fresh()
    generate(uri, "secp384r1", EXTRACTABLE=False)
    with pytest.raises(KeyRefused, match="is not a P-256 key"):
        TokenSigner.open(uri, PIN)
    other = fresh()  # as long a point, on another curve
    generate(other, "secp256k1", EXTRACTABLE=False)
    with pytest.raises(KeyRefused, match="is not a P-256 key"):
        TokenSigner.open(other, PIN)


def failing(**calls: Any) -> Mock:
    return Mock(**{f"{name}.side_effect": error for name, error in calls.items()})


def test_a_token_that_was_pulled_out(monkeypatch: pytest.MonkeyPatch) -> None:
    signer = TokenSigner.create(fresh(), PIN)
    signer._key = failing(sign=pkcs11.exceptions.DeviceRemoved())
    with pytest.raises(TokenRefused, match="the token does not sign: DeviceRemoved"):
        signer.sign(b"message")
    with monkeypatch.context() as patched:
        patched.setattr("pkcs11.lib", Mock(side_effect=pkcs11.exceptions.DeviceError()))
        with pytest.raises(TokenRefused, match="the token home cannot be opened: DeviceError"):
            TokenSigner.open(fresh(), PIN)
    session = failing(create_domain_parameters=pkcs11.exceptions.MechanismInvalid())
    session.get_objects.return_value = []
    monkeypatch.setattr("ca.keys.private_keys._session", lambda *_: session)
    with pytest.raises(TokenRefused, match="cannot generate a P-256 key: MechanismInvalid"):
        TokenSigner.create(fresh(), PIN)


def test_a_token_needs_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pkcs11", None)
    with pytest.raises(TokenRefused, match="python-pkcs11 is not installed") as caught:
        TokenSigner.open(fresh(), PIN)
    assert "rossec[hsm]" in caught.value.hint


@pytest.mark.parametrize(
    "text", ["pkcs11:token=home;object=ca", "pkcs11:object=ca;token=home?module-path=" + DEFAULT_MODULE]
)
def test_key_uris_round_trip(text: str) -> None:
    uri = KeyUri.parse(text)
    assert uri == KeyUri("home", "ca", DEFAULT_MODULE)
    assert KeyUri.parse(str(uri)) == uri


def test_uris_are_percent_encoded() -> None:
    uri = KeyUri("my token;1", "ca=key?", "/lib/my module.so")
    assert KeyUri.parse(str(uri)) == uri
    assert " " not in str(uri)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "file:ca.key",
        "pkcs11:",
        "pkcs11:token=home",
        "pkcs11:object=ca",
        "pkcs11:token=;object=ca",
        "pkcs11:token=a;token=b;object=ca",
        "pkcs11:token=a;object=ca;id=1",
        "pkcs11:token=a;object=ca?module-name=x",
        "token=home;object=ca",
    ],
)
def test_an_invalid_key_uri_is_refused(text: str) -> None:
    with pytest.raises(TokenRefused, match="does not name a key in a token") as caught:
        KeyUri.parse(text)
    assert "pkcs11:token=LABEL" in caught.value.hint


def test_no_pin_in_the_uri() -> None:
    with pytest.raises(TokenRefused, match="would end in files and logs"):
        KeyUri.parse(f"pkcs11:token=home;object=ca?pin-value={hashlib.md5(b'x').hexdigest()}")
