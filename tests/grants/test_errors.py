import pytest

from ca.errors import HintedError
from grants import errors


def test_a_missing_grant_hints_at_what_was_nearly_enough() -> None:
    near = errors.GrantMissing("no grant", ("publish /a", "subscribe /b"))
    assert (near.hint, near.near_misses) == ("publish /a; subscribe /b", near.near_misses)
    assert errors.GrantMissing("no grant").hint == "ask the authority for a grant"


def test_refused_text_says_where() -> None:
    refused = errors.YamlRefused("a tab", "use spaces", line=3, column=7)
    assert (str(refused), refused.hint, refused.line, refused.column) == ("a tab", "use spaces", 3, 7)
    assert (errors.YamlRefused("empty").line, errors.YamlRefused("empty").column) == (1, 1)


def test_a_refused_policy_has_all_its_mistakes() -> None:
    assert errors.PolicyRefused("the first", mistakes=("the first", "another")).mistakes == (
        "the first",
        "another",
    )


@pytest.mark.parametrize("name", [name for name in vars(errors) if name[0].isupper()])
def test_every_refusal_can_be_shown_with_its_hint(name: str) -> None:
    assert issubclass(getattr(errors, name), HintedError)
