"""Requests to the process and its answers, as bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.encoding import encode
from ca.errors import EncodingError
from rossec.errors import (
    MetadataRefused,
    NameUndefined,
    RossecError,
    RulesExceeded,
    RulesNotConfined,
    RulesRefused,
)
from rossec.naming import requests
from rossec.naming.requests import MAX_ENTRIES, MAX_INPUT, MAX_WHICH, NameKind, NameRequest

REQUEST = NameRequest(
    b"rules", b"document", ((NameKind.NODE, ""), (NameKind.TOPIC, "a")), thesis_defaults=True
)
ERRORS = (RulesRefused, MetadataRefused, NameUndefined, RulesExceeded, RulesNotConfined)


def test_a_request_is_read_as_it_was_written() -> None:
    assert requests.read_request(requests.write_request(REQUEST)) == REQUEST


def test_the_largest_request_fits() -> None:
    queries = ((NameKind.SERVICE, "\U0001f600" * MAX_WHICH),) * (MAX_ENTRIES + 1)
    largest = NameRequest(b"r" * MAX_INPUT, b"d" * MAX_INPUT, queries)
    body = requests.write_request(largest)
    assert len(body) <= requests.MAX_REQUEST
    assert requests.read_request(body) == largest


def test_a_request_cut_anywhere_or_longer_is_refused() -> None:
    body = requests.write_request(REQUEST)
    for broken in [*(body[:end] for end in range(len(body))), body + b"\0"]:
        with pytest.raises(EncodingError):
            requests.read_request(broken)


@pytest.mark.parametrize(
    "value",
    [
        [],
        [b"", b"", []],
        [b"", "", [], False],
        [b"", b"", [["node"]], False],
        [b"", b"", [["robot", ""]], False],
        [b"", b"", [["node", b""]], False],
    ],
)
def test_a_request_of_another_form_is_refused(value: list[object]) -> None:
    with pytest.raises(EncodingError):
        requests.read_request(encode(value))  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ERRORS)
def test_names_and_errors_are_read_as_they_were_written(kind: type[RossecError]) -> None:
    error = kind("a message", "a hint")
    name, found = requests.read_names(requests.write_names(["/a", error]), 2)
    assert name == "/a"
    assert isinstance(found, kind)
    assert (str(found), found.hint) == ("a message", "a hint")
    with pytest.raises(kind, match=r"^a message$"):
        requests.read_names(requests.write_error(error), 2)


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"\0",
        encode([0]),
        encode([0, []]),
        encode([0, ["/a"]]),
        encode([0, [[0, b"/a"]]]),
        encode([9, "a", "b"]),
        encode([0, "a", "b"]),
        encode([-1, "a", "b"]),
        encode([1, "a"]),
        encode([0, [[0, "a"], [0, "b"]]]),
        encode({1: 2}),
        encode([0, "a"]),
    ],
)
def test_an_answer_of_another_form_is_an_error(body: bytes) -> None:
    try:
        (found,) = requests.read_names(body, 1)
    except RossecError as error:
        found = error
    assert isinstance(found, RulesExceeded | RulesRefused)


def test_a_name_that_is_too_long_is_an_error() -> None:
    long = requests.write_names(["/" + "a" * requests.MAX_TEXT])
    assert isinstance(requests.read_names(long, 1)[0], RulesExceeded)


def test_a_frame_has_its_length_in_front() -> None:
    assert requests.frame(b"abc") == b"\0\0\0\x03abc"
    assert requests.size(b"\0\0\0\x03", 3) == 3
    for head in (b"\0\0\0\0", b"\0\0\0\x04"):
        with pytest.raises(RulesExceeded, match="where at most 3 are allowed"):
            requests.size(head, 3)


@given(st.binary(max_size=64), st.integers(0, 3))
def test_any_bytes_are_an_answer_or_an_error(body: bytes, count: int) -> None:
    try:
        found = requests.read_names(body, count)
    except RossecError:
        return
    assert len(found) == count
