"""Metadata in other orders say the same."""

from collections import Counter
from itertools import pairwise
from xml.etree import ElementTree

import pytest

from rossec.errors import MetadataRefused
from rossec.naming import requests, rule_runner
from rossec.naming.examine import orders


def tags(document: bytes) -> tuple[str, ...]:
    return tuple(f"{child.tag}{child.text or ''}" for child in ElementTree.fromstring(document))


def test_few_elements_are_tried_in_all_orders() -> None:
    found = [tags(each) for each in orders(b"<node><a/><b/><c/></node>")]
    assert len(found) == len(set(found)) == 5
    assert ("a", "b", "c") not in found


def test_of_many_each_is_first_and_last_and_beside_its_neighbours() -> None:
    elements = "abcdefg"
    text = "".join(f"<{letter}/>" for letter in elements)
    found = [tags(each) for each in orders(f"<node>{text}</node>".encode())]
    assert len(found) == len(set(found)) == 13
    assert {each[0] for each in found} == {each[-1] for each in found} == set(elements)
    for first, second in pairwise(elements):
        assert any(each.index(first) > each.index(second) for each in found)


def test_the_number_of_orders_is_limited() -> None:
    text = "".join(f"<t><name>{n}</name></t>" for n in range(200))
    assert len(list(orders(f"<node>{text}</node>".encode()))) == 15


def test_what_is_inside_of_a_topic_is_turned_too() -> None:
    text = b"<node><topic><name>a</name><function>b</function><location>c</location></topic></node>"
    found = {tuple(child.tag for child in ElementTree.fromstring(each)[0]) for each in orders(text)}
    assert len(found) > 3
    assert {each[0] for each in found} == {"name", "function", "location"}


@pytest.mark.parametrize("document", [b"<node/>", b"<node><a/></node>"])
def test_without_elements_to_turn_there_is_no_other_order(document: bytes) -> None:
    assert list(orders(document)) == []


def test_each_order_says_the_same() -> None:
    given = requests.read(rule_runner.shipped_example("phone.xml"))
    others = [requests.read(each) for each in orders(rule_runner.shipped_example("phone.xml"))]
    assert len(others) == 9
    for other in others:
        assert (other.owner, other.name, other.group) == (given.owner, given.name, given.group)
        assert Counter(other.entries) == Counter(given.entries)


def test_what_is_not_metadata_is_refused() -> None:
    with pytest.raises(MetadataRefused):
        list(orders(b"<node>"))
