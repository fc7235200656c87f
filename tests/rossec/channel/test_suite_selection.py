import pytest

from rossec.channel.edhoc.suites import OFFERED_SUITES, POST_QUANTUM
from rossec.channel.opening import VARIABLE, post_quantum
from rossec.errors import ConfigurationError


def test_unset_is_the_suite_of_production() -> None:
    assert post_quantum({}) == OFFERED_SUITES


@pytest.mark.parametrize("word", list(POST_QUANTUM))
def test_an_option_overrides_the_variable(word: str) -> None:
    assert post_quantum({VARIABLE: word}) == POST_QUANTUM[word]
    assert post_quantum({VARIABLE: "off"}, word) == POST_QUANTUM[word]


@pytest.mark.parametrize("word", ["", "on", "yes", "1", "quantum"])
def test_an_invalid_policy_is_refused(word: str) -> None:
    with pytest.raises(ConfigurationError, match=f"{VARIABLE} is '{word}'") as caught:
        post_quantum({VARIABLE: word})
    assert "one of: off, prefer, require" in caught.value.hint


@pytest.mark.parametrize(("typo", "meant"), [("requre", "require"), ("Prefer ", "prefer")])
def test_a_misspelt_policy_is_refused_with_the_nearest(typo: str, meant: str) -> None:
    for environ, option in (({VARIABLE: typo}, None), ({}, typo)):
        with pytest.raises(ConfigurationError) as caught:
            post_quantum(environ, option)
        assert caught.value.hint.startswith(f"did you mean {meant}?")
