"""The files that are shipped are there, and are what they say."""

import pytest

from rossec.naming import metadata, shipped
from rossec.naming.documents import check_rules


def test_the_rules_are_there() -> None:
    assert b"<parameter name=" in check_rules(shipped.rules())


@pytest.mark.parametrize("name", ["phone.xml"])
def test_the_examples_are_metadata(name: str) -> None:
    assert metadata.read(shipped.example(name)).entries
