import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.errors import NameRefused
from ca.names import (
    check_domain,
    check_name,
    check_wildcard,
    covers,
    is_gateway,
    is_master_name,
    is_relay_name,
    is_reserved,
    parse_spiffe_id,
    spiffe_id,
)

RESERVED = ("/ca", "/master", "/master/kitchen", "/relay", "/relay/attic", "/gateway", "/gateway/attic")

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
        "",
        "/",
        "a",
        "a/b",
        "//a",
        "/a//b",
        "/a/",
        "~a",
        "/~a",
        "/1a",
        "/_a",
        "/a-b",
        "/a b",
        "/a.b",
        "/a*",
        "/*",
        "/ä",
        "/a\n",
        "\n/a",
        "/a\x00",
        "/\u0430",  # the last one is Cyrillic
    ],
)
def test_other_texts_are_not_names(name: str) -> None:
    with pytest.raises(NameRefused, match="is not an absolute ROS name") as caught:
        check_name(name)
    assert "segments begin with a letter" in caught.value.hint
    assert str(caught.value).isascii()


@pytest.mark.parametrize(
    ("refused", "proposed"),
    [
        ("talker-1", "/talker_1"),
        ("r\u00e9cord", "/record"),
        ("/t\u00fcr", "/tur"),
        ("robot", "/robot"),
        ("/robot/3d", "/robot/n3d"),
        ("my robot//arm ", "/my_robot/arm"),
        ("/stra\u00dfe", "/strasse"),
    ],
)
def test_a_refused_name_gets_one_that_works(refused: str, proposed: str) -> None:
    with pytest.raises(NameRefused) as caught:
        check_name(refused)
    assert caught.value.hint.startswith(f"for example {proposed}: ")
    assert check_name(proposed) == proposed


@pytest.mark.parametrize("refused", ["", "/", "~pose", "***", "\u0430"])
def test_where_nothing_can_be_kept_the_form_is_said(refused: str) -> None:
    with pytest.raises(NameRefused) as caught:
        check_name(refused)
    assert caught.value.hint.startswith("write it as /robot1/camera: ")


@pytest.mark.parametrize(("refused", "proposed"), [("Home", "home"), ("my home", "my-home")])
def test_a_refused_domain_gets_one_that_works(refused: str, proposed: str) -> None:
    with pytest.raises(NameRefused) as caught:
        check_domain(refused)
    assert caught.value.hint.endswith(f"for example {proposed}")
    assert check_domain(proposed) == proposed


def test_a_name_has_an_end() -> None:
    with pytest.raises(NameRefused, match="a name of 256 characters where at most 255"):
        check_name("/" + "a" * 255)


@pytest.mark.parametrize("domain", ["home", "lab-3.example.org", "a_b", "0", "a" * 255])
def test_trust_domains_pass(domain: str) -> None:
    assert check_domain(domain) == domain


@pytest.mark.parametrize("domain", ["", "Home", "a/b", "a:1", "a@b", "ä", "a\n", "%61", "a b"])
def test_other_texts_are_not_trust_domains(domain: str) -> None:
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
def test_other_spiffe_ids_are_refused(text: str, message: str) -> None:
    with pytest.raises(NameRefused, match=re.escape(message)):
        parse_spiffe_id(text)


TAILS = ["/rviz_1", "/rviz_1234_1700000000000", "/rviz_robot1_4711_x", "/rviz__1", "/rviz_A"]


@pytest.mark.parametrize("name", ["/rviz", *TAILS])
def test_a_wildcard_tail_covers(name: str) -> None:
    assert covers("/rviz", name, wildcard=True)


@pytest.mark.parametrize(
    "name",
    [
        "",
        "/",
        "/rviz_",
        "/rvizx",
        "/rviz1",
        "/rviz/1",
        "/rviz_a/b",
        "/rviz_1/",
        "/rviz/_1",
        "/rvi",
        "/robot1/rviz_1",
        "rviz_1",
        "//rviz_1",
        "/Rviz_1",
        "/rviz_*",
        "/rviz*",
        "/rviz_1\n",
        "/rviz_1 ",
        "/rviz_1.2",
        "/rviz_\u0661",
        "/rviz_\x00",
        "/master",
        "/ca",
        "/rviz_" + "1" * 250,
    ],
)
def test_a_wildcard_tail_covers_nothing_else(name: str) -> None:
    assert not covers("/rviz", name, wildcard=True)


@pytest.mark.parametrize("name", TAILS)
def test_a_plain_identity_has_no_tail(name: str) -> None:
    assert not covers("/rviz", name, wildcard=False)
    assert covers(name, name, wildcard=False)


@given(names, names)
def test_what_is_covered_is_a_name_in_the_same_place(name: str, asked: str) -> None:
    for candidate in (asked, name + asked, f"{name}_{asked[1:]}"):
        if covers(name, candidate, wildcard=True) and candidate != name:
            assert check_name(candidate).rpartition("/")[0] == name.rpartition("/")[0]
            assert candidate.startswith(f"{name}_")


@given(names)
def test_the_master_and_the_authority_are_covered_by_nobody_else(name: str) -> None:
    for reserved in RESERVED:
        assert covers(name, reserved, wildcard=True) == (name == reserved)
    for end in range(2, len("/master")):
        assert not covers("/master"[:end], "/master", wildcard=True)
    assert not covers("/master/kit", "/master/kit_chen", wildcard=True)


@pytest.mark.parametrize(
    ("name", "is_master"),
    [
        ("/master", True),
        ("/master/kitchen", True),
        ("/master/kitchen/a", False),
        ("/master/", False),
        ("/masters", False),
        ("/master_1", False),
        ("/ca", False),
        ("/remote/hospital/master", False),
        ("/master/kitchen\n", False),
    ],
)
def test_the_names_of_masters(name: str, is_master: bool) -> None:
    assert is_master_name(name) is is_master
    assert is_reserved(name) is (is_master or name == "/ca")


@pytest.mark.parametrize(
    ("name", "is_relay"),
    [
        ("/relay", True),
        ("/relay/attic", True),
        ("/relay/attic/a", False),
        ("/relay/", False),
        ("/relays", False),
        ("/relay_1", False),
        ("/remote/office/relay", False),
        ("/relay/attic\n", False),
    ],
)
def test_the_names_of_relays(name: str, is_relay: bool) -> None:
    assert is_relay_name(name) is is_relay
    assert is_reserved(name) is is_relay


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("/gateway", True),
        ("/gateway/attic", True),
        ("/gateway/attic/a", False),
        ("/gateway/", False),
        ("/gateways", False),
        ("/gateway_1", False),
        ("/remote/office/gateway", False),
        ("/gateway/attic\n", False),
    ],
)
def test_the_names_of_gateways(name: str, expected: bool) -> None:
    assert is_gateway(name) is expected
    assert is_reserved(name) is expected


def test_reserved_names_have_no_tail() -> None:
    assert check_wildcard("/rviz") == "/rviz"
    for reserved in RESERVED:
        with pytest.raises(NameRefused, match=f"{reserved} is a single node") as caught:
            check_wildcard(reserved)
        assert caught.value.hint
