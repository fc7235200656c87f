import pytest

from rossec.errors import ConfigurationError
from rossec.overlay.documents import is_texts, read_document, write_document

KEYS = frozenset({"a", "b"})


def _read(data: bytes) -> object:
    return read_document(data, "rossec-account", KEYS, limit=100, hint="make it anew")


def test_a_document_is_read_as_it_was_written() -> None:
    assert _read(write_document("rossec-account", {"a": 1, "b": ["x"]})) == {"a": 1, "b": ["x"]}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b" " * 101, "at most 100 bytes"),
        (b"{", "is not JSON"),
        (b"\xff", "is not JSON"),
        (b"[" * 90, "is not JSON"),
        (b'{"rossec-account":1,"a":1,"a":2,"b":3}', "is not JSON"),
        (b'{"rossec-account":1,"a":NaN,"b":3}', "is not JSON"),
        (b"[]", "this is no rossec-account file"),
        (b'{"rossec-descriptor":1,"a":1,"b":2}', "this is no rossec-account file"),
        (b'{"rossec-account":2,"a":1,"b":2}', "of another version"),
        (b'{"rossec-account":true,"a":1,"b":2}', "of another version"),
        (b'{"rossec-account":1.0,"a":1,"b":2}', "of another version"),
        (b'{"rossec-account":1,"a":1}', "other entries"),
        (b'{"rossec-account":1,"a":1,"b":2,"c":3}', "other entries"),
    ],
)
def test_anything_else_is_no_document(data: bytes, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message) as caught:
        _read(data)
    assert caught.value.hint == "make it anew"


def test_a_list_of_texts() -> None:
    assert is_texts([])
    assert is_texts(["a"])
    assert not is_texts("a")
    assert not is_texts(["a", 1])
    assert not is_texts(None)
