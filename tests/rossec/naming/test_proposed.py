"""Which texts rules may give as names."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca import names
from rossec.errors import ProposedNameRefused
from rossec.naming.requests import RESERVED, check_proposed


def test_names_pass() -> None:
    for name in ("/a", "/smartphones/schneider/htc_desire", "/masters/a", "/room/remote"):
        assert check_proposed(name) == name


@pytest.mark.parametrize("text", ["", "a", "/", "/a/", "//a", "/a-b", "/1a", "/a b", "~a", "/ä"])
def test_what_is_no_name_is_refused(text: str) -> None:
    with pytest.raises(ProposedNameRefused, match="do not give a name") as caught:
        check_proposed(text)
    assert "letters, digits or _" in caught.value.hint


@pytest.mark.parametrize("first", sorted(RESERVED))
def test_reserved_names_and_what_is_below_are_refused(first: str) -> None:
    for name in (f"/{first}", f"/{first}/a"):
        with pytest.raises(ProposedNameRefused, match="which is reserved"):
            check_proposed(name)


def test_every_name_that_nodes_trust_is_reserved() -> None:
    for name in (names.AUTHORITY, names.MASTER, names.RELAY, names.GATEWAY, "/relay/two"):
        assert names.is_reserved(name)
        with pytest.raises(ProposedNameRefused):
            check_proposed(name)


def test_the_defaults_of_the_thesis_pass_where_they_are_asked_for() -> None:
    name = "/unknown-group/unknown-node/unknown-location"
    assert check_proposed(name, thesis_defaults=True) == name
    with pytest.raises(ProposedNameRefused):
        check_proposed(name)
    for other in ("/unknown-groups", "/a-b", "/unknown-group/a-b", "unknown-group"):
        with pytest.raises(ProposedNameRefused):
            check_proposed(other, thesis_defaults=True)


@given(st.text() | st.from_regex(r"(/[a-z_-]{1,8}){1,4}", fullmatch=True), st.booleans())
def test_what_passes_is_a_name_that_is_not_reserved(text: str, thesis: bool) -> None:
    try:
        found = check_proposed(text, thesis_defaults=thesis)
    except ProposedNameRefused:
        return
    assert found == text
    assert names.check_name(text if not thesis else text.replace("-", "_"))
    assert not names.is_reserved(text)
