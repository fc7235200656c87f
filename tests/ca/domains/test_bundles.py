"""TrustBundles: signed by the root in them, and nothing else is believed of them."""

import dataclasses
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.domains import MAX_TRUST_BUNDLE, SKEW, open_bundle, sign_bundle
from ca.errors import BundleRefused, CertificateRefused, PatternRefused
from tests.support.pki import DAY, NOW, new_signer
from tests.vectors.make_domains import FILE, HOSPITAL, TRUST_BUNDLES

V = json.loads(FILE.read_text())
TRUST_BUNDLE = TRUST_BUNDLES["with masters"]
DATA = bytes.fromhex(V["bundles"]["with masters"])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a field is missing", "missing or unknown fields"),
        ("a root of another key", "does not verify"),
        ("no root", "not a well-formed certificate"),
        ("no names", "no names"),
        ("a number for a name", "is not one"),
        ("an address of another scheme", "is not a master's address"),
        ("never valid", "never valid"),
        ("for too long", "more than 30 days"),
        ("expired", "expired 1 s ago"),
        ("from the future", "from the future"),
    ],
)
def test_the_reason_for_a_refusal(name: str, message: str) -> None:
    with pytest.raises(BundleRefused, match=message) as caught:
        open_bundle(bytes.fromhex(V["refused_bundles"][name]["data"]), NOW)
    assert caught.value.hint


def test_every_byte_of_a_bundle_counts() -> None:
    for at in range(0, len(DATA), 5):
        for changed in (DATA[:at] + bytes([DATA[at] ^ 1]) + DATA[at + 1 :], DATA[:at]):
            with pytest.raises(BundleRefused):
                open_bundle(changed, NOW)
    for more in (DATA + b"\0", DATA + bytes(MAX_TRUST_BUNDLE)):
        with pytest.raises(BundleRefused):
            open_bundle(more, NOW)


@given(st.binary(max_size=200))
def test_other_bytes_are_no_bundle(data: bytes) -> None:
    with pytest.raises(BundleRefused):
        open_bundle(data, NOW)


def test_a_bundle_holds_from_shortly_before_its_time_until_its_end() -> None:
    assert open_bundle(DATA, NOW - SKEW) == open_bundle(DATA, TRUST_BUNDLE.expires - 1) == TRUST_BUNDLE
    for at in (NOW - SKEW - 1, TRUST_BUNDLE.expires):
        with pytest.raises(BundleRefused):
            open_bundle(DATA, at)


def test_a_bundle_is_about_its_signer() -> None:
    assert TRUST_BUNDLE.anchor.domain == "hospital.example"
    assert TRUST_BUNDLE.anchor is TRUST_BUNDLE.anchor
    with pytest.raises(BundleRefused, match="not about this authority"):
        sign_bundle(new_signer(), TRUST_BUNDLE)
    assert open_bundle(sign_bundle(HOSPITAL, TRUST_BUNDLE), NOW) == TRUST_BUNDLE


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"names": ()}, BundleRefused),
        ({"names": ("/a*",)}, PatternRefused),
        ({"masters": ("http://a b",)}, BundleRefused),
        ({"masters": ("https://a",)}, BundleRefused),
        ({"masters": ("http://h:11311\n",)}, BundleRefused),
        ({"masters": ("http://h:11311",) * 9}, BundleRefused),
        ({"issued": -1}, BundleRefused),
        ({"issued": True}, BundleRefused),
        ({"expires": NOW + 31 * DAY}, BundleRefused),
    ],
)
def test_a_bundle_that_is_none(change: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        dataclasses.replace(TRUST_BUNDLE, **change)
    with pytest.raises(CertificateRefused):
        _ = dataclasses.replace(TRUST_BUNDLE, root=b"").anchor
