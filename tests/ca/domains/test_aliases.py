import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca import names
from ca.errors import NameRefused

LABELS = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,31}", fullmatch=True)
NAMES = st.from_regex(r"(/[A-Za-z][A-Za-z0-9_]{0,20}){1,5}", fullmatch=True)


@given(LABELS, NAMES)
def test_an_alias_is_split_into_what_it_was_made_of(label: str, name: str) -> None:
    if names.is_alias(name):
        with pytest.raises(NameRefused, match="alias at the origin itself"):
            names.alias_of(label, name)
        return
    alias = names.alias_of(label, name)
    assert names.split_alias(alias) == (label, name)
    assert names.origin_of(alias) == name
    assert names.local_name(names.shown(alias)) == alias
    assert names.origin_of(name) == names.shown(name) == names.local_name(name) == name


def test_an_alias_is_written_for_people_with_its_label() -> None:
    assert names.shown("/remote/hospital/robot/pose") == "hospital:/robot/pose"
    assert names.display_name("kitchen", "/robot") == "kitchen:/robot"
    for other in ("/remote", "/remote/hospital", "/remote/9/a", "/remotely/a", "*", "", "word"):
        assert names.shown(other) == other


@pytest.mark.parametrize("name", ["/remote", "/remote/hospital", "/remote/", "/remote//a", "/remote/a-b/c"])
def test_what_is_below_remote_without_label_and_name_is_refused(name: str) -> None:
    assert names.is_alias(name)
    for function in (names.split_alias, names.origin_of):
        with pytest.raises(NameRefused):
            function(name)


@pytest.mark.parametrize(
    "text", ["hospital:", "hospital:robot", ":/robot", "a b:/robot", "x" * 33 + ":/a", "a:/b:/c"]
)
def test_text_with_a_colon_is_a_label_and_a_name(text: str) -> None:
    with pytest.raises(NameRefused):
        names.local_name(text)


def test_names_without_an_alias_are_refused_below_remote() -> None:
    assert names.refuse_alias("/robot") == "/robot"
    with pytest.raises(NameRefused, match="below /remote") as caught:
        names.refuse_alias("/remote/hospital/robot")
    assert caught.value.hint == "choose another name"


def test_an_alias_is_no_longer_than_a_name() -> None:
    with pytest.raises(NameRefused, match="at most 255"):
        names.alias_of("hospital", "/" + "a" * 250)


def test_a_pattern_with_a_label_is_one_of_aliases() -> None:
    assert names.local_pattern("hospital:/rounds/*") == "/remote/hospital/rounds/*"
    assert names.local_pattern("hospital:/**") == "/remote/hospital/**"
    assert names.local_pattern("/rounds/*") == "/rounds/*"


@pytest.mark.parametrize(
    "text", ["*:/a", "hospital:*", "hospital:/a*", ":/a", "hospital:/remote/x/y", "x" * 33 + ":/a", ""]
)
def test_text_that_is_no_pattern_of_names_is_refused(text: str) -> None:
    with pytest.raises(NameRefused):
        names.local_pattern(text)
