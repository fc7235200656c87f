"""All mistakes are reported, in the order of the file, each with a hint."""

import pytest

from grants.errors import PolicyRefused
from grants.policy.source import MAX_MISTAKES, Mistakes, suggest


def test_all_mistakes_are_raised_in_the_order_of_the_file() -> None:
    mistakes = Mistakes("p.yaml")
    mistakes.raise_if_any()
    mistakes.add(9, 2, "second", "b")
    mistakes.add(3, 1, "first", "a")
    mistakes.add(9, 2, "second", "b")
    with pytest.raises(PolicyRefused) as caught:
        mistakes.raise_if_any()
    assert str(caught.value) == "p.yaml:3:1: first (and 1 more, see: rossec policy check p.yaml)"
    assert caught.value.hint == "a"
    assert [str(item) for item in caught.value.mistakes] == ["p.yaml:3:1: first", "p.yaml:9:2: second"]


def test_one_mistake_is_the_message() -> None:
    mistakes = Mistakes("p.yaml")
    mistakes.add(1, 1, "only")
    with pytest.raises(PolicyRefused, match=r"^p\.yaml:1:1: only$"):
        mistakes.raise_if_any()


def test_the_number_of_mistakes_is_bounded() -> None:
    mistakes = Mistakes("p.yaml")
    for line in range(MAX_MISTAKES - 1):
        mistakes.add(line, 1, "x")
    with pytest.raises(PolicyRefused) as caught:  # reading stops at the maximum
        mistakes.add(MAX_MISTAKES, 1, "x")
    assert len(caught.value.mistakes) == MAX_MISTAKES


@pytest.mark.parametrize(
    ("word", "known", "hint"),
    [
        ("positon", ("position", "orientation"), "did you mean 'position'?"),
        ("zzz", ("b", "a"), "expected one of a, b"),
        ("zzz", (), "none is defined"),
        ("zz", list("abcdefghijklmnop"), "expected one of a, b, c, d, e, f, g, h, i, j, k, l, ..."),
    ],
)
def test_the_most_similar_value_or_a_list_is_suggested(word: str, known: tuple[str, ...], hint: str) -> None:
    assert suggest(word, known) == hint
