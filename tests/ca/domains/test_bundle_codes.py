import json

import pytest

from ca.enrollment import qr
from ca.enrollment.qr import bundle_code, check_code
from ca.errors import BundleRefused, CodeRefused
from tests.vectors.make_domains import FILE

V = json.loads(FILE.read_text())
TRUST_BUNDLE, OTHER = (bytes.fromhex(V["bundles"][name]) for name in ("with masters", "without masters"))


def test_a_code_fits_one_bundle() -> None:
    text = bundle_code(TRUST_BUNDLE)
    assert text.startswith(qr.PREFIX)
    check_code(text, TRUST_BUNDLE)
    check_code(f"  {text}\n", TRUST_BUNDLE)
    with pytest.raises(BundleRefused, match="does not fit the code"):
        check_code(text, OTHER)
    with pytest.raises(BundleRefused, match="does not fit the code"):
        check_code(text, TRUST_BUNDLE + b"\0")


def test_a_code_has_a_place_on_a_small_terminal() -> None:
    lines = qr.terminal(bundle_code(TRUST_BUNDLE)).splitlines()
    assert len(lines) <= 20
    assert len(qr.encode_base45(TRUST_BUNDLE)) > 800  # the bundle itself would have 45 lines


@pytest.mark.parametrize(
    "text",
    [
        "",
        "ROSSEC:",
        "ROSSEC:A",
        "ROSSEC:##",
        bundle_code(TRUST_BUNDLE)[:-1],
        bundle_code(TRUST_BUNDLE) + "00",
        bundle_code(TRUST_BUNDLE)[7:],
        "ROSSEC:" + "0" * 90,
        qr.label_code(b"a request"),
    ],
)
def test_other_texts_are_no_codes_of_bundles(text: str) -> None:
    with pytest.raises(CodeRefused) as caught:
        check_code(text, TRUST_BUNDLE)
    assert caught.value.hint


def test_an_enrollment_takes_no_code_of_a_bundle() -> None:
    with pytest.raises(CodeRefused):
        qr.parse(bundle_code(TRUST_BUNDLE))
