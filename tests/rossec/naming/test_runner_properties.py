"""Any metadata give a legal name that is not reserved, or an error."""

import asyncio

from hypothesis import given, settings
from hypothesis import strategies as st

from ca.names import check_name
from rossec.errors import RossecError
from rossec.naming import requests
from rossec.naming.requests import RESERVED, NameKind
from rossec.naming.rule_runner import RuleRunner
from tests.rossec.naming.stylesheets import NODE, RULES

TEXT = st.text(st.characters(codec="utf-8"), max_size=20)
WORD = st.sampled_from(["a", "robot1", "/remote", "..", "a/b", "master", "-", "é", "a" * 300, ""])
FIELDS = st.lists(st.tuples(st.sampled_from(["owner", "name", "group", "x"]), WORD | TEXT), max_size=4)
TOPICS = st.lists(st.tuples(WORD | TEXT, WORD | TEXT, WORD), max_size=3)


def written(fields: list[tuple[str, str]], topics: list[tuple[str, str, str]]) -> bytes:
    """Metadata with these values as they are: some are no XML, or have other elements."""
    text = "".join(f"<{tag}>{value}</{tag}>" for tag, value in fields)
    for name, location, mobile in topics:
        text += f"<topic><name>{name}</name><location>{location}</location>"
        text += f"<mobile>{mobile}</mobile></topic>"
    return f"<node>{text}</node>".encode()


async def results(rules: RuleRunner, document: bytes, names: list[str]) -> list[requests.Result]:
    try:
        return await rules.names(document, [NODE, *((NameKind.TOPIC, name) for name in names)])
    except RossecError as error:
        return [error]


def test_any_metadata_give_a_legal_name_or_an_error() -> None:
    given_names = 0

    @settings(max_examples=150)
    @given(FIELDS, TOPICS)
    def check(fields: list[tuple[str, str]], topics: list[tuple[str, str, str]]) -> None:
        nonlocal given_names
        document = written(fields, topics)
        for found in loop.run(results(rules, document, [name for name, _, _ in topics])):
            if isinstance(found, str):
                given_names += 1
                assert check_name(found).split("/")[1] not in RESERVED

    rules = RuleRunner(RULES)
    with asyncio.Runner() as loop:
        loop.run(rules.__aenter__())
        try:
            check()
        finally:
            rules.close()
    assert given_names > 20
