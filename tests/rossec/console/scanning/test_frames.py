"""Frames between web process, supervisor and worker."""

import pytest

from ca.encoding import encode
from rossec.console import scanning
from rossec.console.scanning import Found, Unreadable
from rossec.errors import KeyMessageRefused


@pytest.mark.parametrize("answer", [Found("ROSSEC:ABC"), Found(""), Unreadable("not a picture", "send one")])
def test_an_answer_is_read_as_it_was_written(answer: Found | Unreadable) -> None:
    data = scanning.write_answer(answer)
    assert scanning.size(data[: scanning.HEAD], scanning.MAX_ANSWER) == len(data) - scanning.HEAD
    assert scanning.read_answer(data[scanning.HEAD :]) == answer


def test_every_beginning_of_an_answer_is_refused() -> None:
    body = scanning.write_answer(Found("ROSSEC:ABC"))[scanning.HEAD :]
    for size in range(len(body)):
        with pytest.raises(KeyMessageRefused):
            scanning.read_answer(body[:size])
    with pytest.raises(KeyMessageRefused):
        scanning.read_answer(body + b"\0")


@pytest.mark.parametrize("value", [[2, "x"], [0, 1], [0, "x" * 513], [0], [1, "a"], "text", []])
def test_an_answer_of_another_form_is_refused(value: object) -> None:
    with pytest.raises(KeyMessageRefused, match="of another form"):
        scanning.read_answer(encode(value))  # type: ignore[arg-type]


@pytest.mark.parametrize(("head", "limit"), [(b"\0\0\0\0", 9), (b"\0\0\0\x0a", 9)])
def test_a_frame_that_is_empty_or_too_long_is_refused(head: bytes, limit: int) -> None:
    with pytest.raises(KeyMessageRefused, match="where 9 are allowed"):
        scanning.size(head, limit)


def test_a_frame_has_its_length_in_front() -> None:
    assert scanning.frame(b"abc") == b"\0\0\0\x03abc"
