"""Argument checks that stock does not have; stock's texts are compared in test_differential."""

import pytest

from rossec.master.api import arguments as arg


@pytest.mark.parametrize(
    "value", ["http://h:1/", "http://h:65535", "http://[::1]:1/", "http://10.0.0.1:1/path"]
)
def test_uris_with_host_and_port(value: str) -> None:
    assert arg.uri("caller_api", "http")(value, "/n") == value


@pytest.mark.parametrize(
    "value",
    [
        "http://h",
        "http://:1/",
        "http://h:0/",
        "http://h:65536/",
        "http://h:x/",
        "https://h:1/",
        "rosrpc://h:1",
        "http://user@h:1/",
        "http://h:1/ x",
        "http://h:1/\n",
        "http://h\u00e9:1/",
        "http://[::1:1/",
        "http://" + "h" * 600 + ":1/",
        "ftp://h:1",
        "http://0.0.0.0:1/",
        "http://127.1:1/",
        "http://224.0.0.1:1/",
    ],
)
def test_uris_that_no_connection_can_use(value: str) -> None:
    with pytest.raises(arg.ArgumentRefused, match="is not an RPC URI"):
        arg.uri("caller_api", "http")(value, "/n")


@pytest.mark.parametrize("value", [None, "", 5, [], b"http://h:1/"])
def test_a_uri_is_text(value: object) -> None:
    with pytest.raises(arg.ArgumentRefused, match="is not an XMLRPC URI"):
        arg.uri("caller_api", "http")(value, "/n")


@pytest.mark.parametrize("value", ["/a-b", "/1a", "/a*", "/**", "/\u0430", "/a\n", "/" + "a" * 300])
def test_topics_are_well_formed_names(value: str) -> None:
    with pytest.raises(arg.ArgumentRefused, match="illegal chars"):
        arg.topic("topic")(value, "/n")


def test_names_are_resolved_against_the_caller() -> None:
    assert arg.topic("topic")("~x", "/ns/n") == "/ns/n/x"
    assert arg.node("node")("other", "/ns/n") == "/ns/other"
    assert arg.key("key")("x", "/ns/n") == "/ns/x"
    assert arg.subgraph("subgraph")("", "/ns/n") == ""
    assert arg.subgraph("subgraph")("sub", "/ns/n") == "/ns/sub"


@pytest.mark.parametrize("value", ["", 5, "String", "a/b/c", "a/" + "b" * 300, "a/b\n"])
def test_types_are_package_and_name(value: object) -> None:
    with pytest.raises(arg.ArgumentRefused, match="topic_type"):
        arg.type_name("topic_type")(value, "/n")


def test_keys_are_bounded() -> None:
    with pytest.raises(arg.ArgumentRefused, match="too long"):
        arg.key("key")("/" + "a" * 300, "/n")


@pytest.mark.parametrize("value", ["/a b", "/1a", "/a\nrossec: WARNING: /b", "a-b", "/a/~b", "/\u0430"])
def test_keys_are_well_formed_names(value: str) -> None:
    with pytest.raises(arg.ArgumentRefused, match=r"\[key\] contains illegal chars"):
        arg.key("key")(value, "/n")


def test_the_root_is_a_key_and_a_search_key_is_not_resolved() -> None:
    assert arg.key("key")("/", "/n") == "/"
    assert arg.search_key("key")("a" * 300, "/n") == "a" * 255


def test_arguments_of_other_types() -> None:
    assert arg.not_none("value")(0, "/n") == 0
    with pytest.raises(arg.ArgumentRefused, match="must be specified"):
        arg.not_none("value")(None, "/n")
    assert arg.anything(None, "/n") is None


@pytest.mark.parametrize(
    ("check", "good", "wrong"),
    [
        (arg.text("reason"), ["", "because"], [None, 5, b"x"]),
        (arg.number("port"), [0, 7], [-1, True, 1.5, "7", None]),
        (arg.binary("list"), [b"", b"x"], ["x", None, [b"x"]]),
        (arg.binaries("grants", 2), [[], [b"a", b"b"]], [[b"a"] * 3, ["a"], b"a", None]),
        (arg.type_name("type"), ["*", "std_msgs/String"], [None, "", "String"]),
        (arg.node("node"), ["/n"], [None, "", 5, "http://h:1/", "/a b"]),
        (arg.topic("topic"), ["/t"], [None, "", 5, "/", "http://h:1/"]),
        (arg.key("key"), ["/k"], [None, "", 5]),
        (arg.search_key("key"), ["k"], [None, "", 5]),
        (arg.subgraph("subgraph"), ["", "/ns"], [None, 5]),
    ],
)
def test_each_kind_of_argument_has_its_values(
    check: arg.Check, good: list[object], wrong: list[object]
) -> None:
    assert [check(value, "/n") for value in good] == good
    for value in wrong:
        with pytest.raises(arg.ArgumentRefused, match=r"^ERROR: parameter \["):
            check(value, "/n")
