"""What is refused in a text of XML before it is parsed."""

import pytest

from rossec.errors import MetadataRefused, RulesRefused
from rossec.naming import requests


@pytest.mark.parametrize(
    "data",
    [
        b"<node/>",
        b'<?xml version="1.0"?><node/>',
        b'<?xml version="1.0" encoding="UTF-8"?><node/>',
        b"<?xml version='1.0' encoding = 'iso-8859-1' standalone='yes' ?>\n<node/>",
        b'<?xml version="1.0" encoding="US-ASCII"?><node/>',
        b"\xef\xbb\xbf<node/>",
        b"\xef\xbb\xbf \r\n\t<node/>",
    ],
)
def test_documents_pass(data: bytes) -> None:
    assert requests.check_document(data) == data
    assert requests.check_rules(data) == data


@pytest.mark.parametrize(
    "data",
    [
        b"<!DOCTYPE node><node/>",
        b"<node/><!doctype x>",
        b"<!-- <!ENTITY a 'b'> --><node/>",
        b'\n\n<!DOCTYPE x [<!ENTITY a "aaaa">]><node>&a;</node>',
    ],
)
def test_a_document_type_is_refused_wherever_it_stands(data: bytes) -> None:
    with pytest.raises(MetadataRefused, match="document type or entities"):
        requests.check_document(data)


def test_the_line_of_a_document_type_is_named() -> None:
    with pytest.raises(RulesRefused, match=r"^line 3: rules with a document type"):
        requests.check_rules(b"\n\n<!DOCTYPE x>")


@pytest.mark.parametrize(
    ("data", "encoding"),
    [
        ("<node/>".encode("utf-16"), "utf-16"),
        ('<?xml version="1.0" encoding="UTF-16"?><!DOCTYPE a><node/>'.encode("utf-16-le"), "utf-8"),
        (b'<?xml version="1.0" encoding="UTF-7"?><node/>', "utf-7"),
        (b'<?xml version="1.0" encoding="EBCDIC-CP-US"?><node/>', "ebcdic-cp-us"),
        (b'<?xml version="1.0" encoding="UTF-8" encoding="UTF-7"?><node/>', "unknown"),
        (b'<?xml version="1.0" encoding=UTF-7?><node/>', "unknown"),
        (b'<?xml version="1.0" encoding="UTF-8"', "unknown"),
        (b"\0<\0n", "utf-8"),
    ],
)
def test_an_encoding_that_could_hide_something_is_refused(data: bytes, encoding: str) -> None:
    with pytest.raises(MetadataRefused, match=rf"in the encoding '{encoding}'|document type"):
        requests.check_document(data)


@pytest.mark.parametrize("encoding", ["cp037", "cp500"])
def test_an_encoding_that_parsers_guess_is_refused(encoding: str) -> None:
    """EBCDIC without a NUL or a mark: libxml2 knows it by its first four bytes."""
    text = '<?xml version="1.0" encoding="EBCDIC-CP-US"?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>'
    for refusal, check in ((MetadataRefused, requests.check_document), (RulesRefused, requests.check_rules)):
        with pytest.raises(refusal, match="that begin with no element"):
            check(text.encode(encoding))


def test_the_size_is_limited() -> None:
    requests.check_document(b"<a>" + b"x" * (requests.MAX_INPUT - 3))
    with pytest.raises(MetadataRefused, match="where at most 262144 are allowed") as caught:
        requests.check_document(b"x" * (requests.MAX_INPUT + 1), "a launch file")
    assert "of a launch file" in str(caught.value)
    assert "lines" in caught.value.hint


@pytest.mark.parametrize("data", [b"", b" \n"])
def test_nothing_is_no_document(data: bytes) -> None:
    with pytest.raises(MetadataRefused, match=r"^empty metadata$"):
        requests.check_document(data)
