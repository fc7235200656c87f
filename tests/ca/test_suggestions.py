"""What was probably meant: for hints."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.names import check_domain, check_name, closest, proposed_domain, proposed_name


@given(st.text(max_size=300))
def test_what_is_proposed_is_a_name(text: str) -> None:
    proposed = proposed_name(text)
    assert proposed is None or check_name(proposed) == proposed


@given(st.text(max_size=300))
def test_what_is_proposed_is_a_domain(text: str) -> None:
    proposed = proposed_domain(text)
    assert proposed is None or check_domain(proposed) == proposed


@pytest.mark.parametrize("text", ["a" * 256, "/" * 300])
def test_nothing_is_proposed_for_what_is_too_long(text: str) -> None:
    assert proposed_name(text) is None
    assert proposed_domain(text) is None


def test_what_grows_beyond_a_name_is_not_proposed() -> None:
    assert proposed_name("\N{LATIN SMALL LETTER SHARP S}" * 200) is None


def test_the_closest_of_what_is_known() -> None:
    assert closest("/heatin", ["/robot", "/heating"]) == "/heating"
    assert closest("/lamp", ["/robot", "/heating"]) is None
    assert closest("/lamp", []) is None
