import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.errors import NameRefused
from ca.names import check_domain, check_name, parse_spiffe_id, spiffe_id

names = st.from_regex(r"(/[A-Za-z][A-Za-z0-9_]{0,9}){1,8}", fullmatch=True)
domains = st.from_regex(r"[a-z0-9._-]{1,30}", fullmatch=True)


@pytest.mark.parametrize(
    "name", ["/a", "/robot1/camera", "/Robot_1/Camera_2", "/a/b/c/d", "/master", "/" + "a" * 254]
)
def test_absolute_names_pass(name: str) -> None:
    assert check_name(name) == name


@pytest.mark.parametrize(
    "name",
    [
        "", "/", "a", "a/b", "//a", "/a//b", "/a/", "~a", "/~a", "/1a", "/_a", "/a-b", "/a b",
        "/a.b", "/a*", "/*", "/ä", "/a\n", "\n/a", "/a\x00", "/\u0430",  # the last one is Cyrillic
    ],
)  # fmt: skip
def test_anything_else_is_no_name(name: str) -> None:
    with pytest.raises(NameRefused, match="is not an absolute ROS name") as caught:
        check_name(name)
    assert "/robot1/camera" in caught.value.hint
    assert str(caught.value).isascii()


def test_a_name_has_an_end() -> None:
    with pytest.raises(NameRefused, match="a name of 256 characters where at most 255"):
        check_name("/" + "a" * 255)


@pytest.mark.parametrize("domain", ["home", "lab-3.example.org", "a_b", "0", "a" * 255])
def test_trust_domains_pass(domain: str) -> None:
    assert check_domain(domain) == domain


@pytest.mark.parametrize("domain", ["", "Home", "a/b", "a:1", "a@b", "ä", "a\n", "%61", "a b"])
def test_anything_else_is_no_trust_domain(domain: str) -> None:
    with pytest.raises(NameRefused, match="is not a trust domain"):
        check_domain(domain)


def test_a_trust_domain_has_an_end() -> None:
    with pytest.raises(NameRefused, match="a trust domain of 256 characters"):
        check_domain("a" * 256)


@given(domains, names)
def test_spiffe_id_round_trip(domain: str, name: str) -> None:
    text = spiffe_id(domain, name)
    assert parse_spiffe_id(text) == (domain, name)


@given(st.one_of(st.text(), st.text().map("spiffe://".__add__)))
def test_parsing_is_strict(text: str) -> None:
    try:
        parsed = parse_spiffe_id(text)
    except NameRefused:
        return
    assert spiffe_id(*parsed) == text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "'' is not a SPIFFE ID"),
        ("SPIFFE://home/a", "is not a SPIFFE ID"),
        ("https://home/a", "is not a SPIFFE ID"),
        ("spiffe:///a", "'' is not a trust domain"),
        ("spiffe://home", "'' is not an absolute ROS name"),
        ("spiffe://home/", "'/' is not an absolute ROS name"),
        ("spiffe://home//a", "'//a' is not an absolute ROS name"),
        ("spiffe://home/a?x", "'/a?x' is not an absolute ROS name"),
        ("spiffe://home/a#x", "'/a#x' is not an absolute ROS name"),
        ("spiffe://home/%61", "is not an absolute ROS name"),
        ("spiffe://user@home/a", "is not a trust domain"),
        ("spiffe://home:1/a", "is not a trust domain"),
    ],
)
def test_not_what_we_write(text: str, message: str) -> None:
    with pytest.raises(NameRefused, match=re.escape(message)):
        parse_spiffe_id(text)
