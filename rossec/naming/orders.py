"""The same metadata in other orders: rules must give the same names for all of them. Pure.

The elements of a node say what they are by their tags, not by their place. With few of them all
orders are tried, with more every rotation up to a number, forwards and backwards: each element then
was the first, the last, before and after each of its neighbours.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final
from xml.etree import ElementTree

from rossec.naming.metadata import parse

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_ALL: Final = 4  # up to so many elements all orders are tried
_ROTATIONS: Final = 8


def orders(document: bytes) -> Iterator[bytes]:
    """The document in other orders, at the node and inside of its topics and services.

    Raises:
        MetadataRefused: it cannot be read.
    """
    root = parse(document)
    children = list(root)
    inner = [list(child) for child in children]
    seen = {_indices(range(len(children)))}
    longest = max((len(each) for each in inner), default=0)
    for at, order in enumerate(_orders(max(len(children), longest))):
        outer = _indices(index for index in order if index < len(children))
        if outer in seen and longest < 2:
            continue
        seen.add(outer)
        for child, elements in zip(children, inner, strict=True):
            child[:] = _arranged(elements, at)
        root[:] = [children[index] for index in outer]
        yield ElementTree.tostring(root, encoding="utf-8")


def _indices(indices: Iterator[int] | range) -> tuple[int, ...]:
    return tuple(indices)


def _orders(count: int) -> Iterator[Sequence[int]]:
    """Orders of so many elements, the given one left out."""
    given = tuple(range(count))
    if count <= _ALL:
        yield from itertools.islice(itertools.permutations(given), 1, None)
        return
    for by in range(min(count, _ROTATIONS)):
        rotated = given[by:] + given[:by]
        if by:
            yield rotated
        yield rotated[::-1]


def _arranged(elements: "list[Element]", at: int) -> "list[Element]":
    """Those of a topic or service: turned backwards, then rotated further each time."""
    if not elements:
        return elements
    by = (at + 1) // 2 % len(elements)
    rotated = elements[by:] + elements[:by]
    return rotated if at % 2 else rotated[::-1]
