import pytest

from rossec.channel.edhoc.suites import POST_QUANTUM, PRODUCTION
from rossec.channel.suite_selection import VARIABLE, post_quantum
from rossec.errors import ConfigurationError


def test_unset_is_the_suite_of_production() -> None:
    assert post_quantum({}) == PRODUCTION


@pytest.mark.parametrize("word", list(POST_QUANTUM))
def test_the_variable_says_so_unless_an_option_does(word: str) -> None:
    assert post_quantum({VARIABLE: word}) == POST_QUANTUM[word]
    assert post_quantum({VARIABLE: "off"}, word) == POST_QUANTUM[word]


@pytest.mark.parametrize("word", ["", "on", "yes", "1", "quantum"])
def test_what_is_no_policy_refuses(word: str) -> None:
    with pytest.raises(ConfigurationError, match=f"{VARIABLE} is '{word}'") as caught:
        post_quantum({VARIABLE: word})
    assert "one of: off, prefer, require" in caught.value.hint


@pytest.mark.parametrize(("typo", "meant"), [("requre", "require"), ("Prefer ", "prefer")])
def test_a_slip_is_refused_with_what_was_meant(typo: str, meant: str) -> None:
    for environ, option in (({VARIABLE: typo}, None), ({}, typo)):
        with pytest.raises(ConfigurationError) as caught:
            post_quantum(environ, option)
        assert caught.value.hint.startswith(f"did you mean {meant}?")
