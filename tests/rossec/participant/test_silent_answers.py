"""What client libraries keep to themselves."""

import pytest

from rossec.participant.registrations import nothing_shown, shows_nothing, unheard_refusal

ILLEGAL = [-1, "ERROR: parameter [key] contains illegal chars", 0]


@pytest.mark.parametrize("method", ["setParam", "deleteParam"])
def test_a_refused_name_of_a_parameter_is_said_with_one_that_works(method: str) -> None:
    said = unheard_refusal(method, ("/robot", "/t\u00fcr", 1), ILLEGAL)
    assert said is not None
    assert "for example /tur: " in said
    assert said.isascii()


def test_another_refusal_is_said_as_it_is() -> None:
    assert unheard_refusal("setParam", ("/robot", "/x/", 1), [-1, "no space", 0]) == "no space"
    assert unheard_refusal("setParam", ("/robot",), [0, "bad call arity", 0]) == "bad call arity"


@pytest.mark.parametrize(
    ("method", "answer"),
    [("getParam", ILLEGAL), ("setParam", [1, "", 0]), ("setParam", None), ("setParam", [-1, 7, 0])],
)
def test_what_a_program_hears_of_is_not_meant(method: str, answer: object) -> None:
    assert unheard_refusal(method, ("/robot", "/x", 1), answer) is None


@pytest.mark.parametrize(
    ("method", "answer", "is_nothing"),
    [
        ("getSystemState", [1, "", [[], [], []]], True),
        ("getTopicTypes", [1, "", []], True),
        ("getPublishedTopics", [1, "", []], True),
        ("getSystemState", [1, "", [[["/a", ["/n"]]], [], []]], False),
        ("getTopicTypes", [-1, "", []], False),
        ("getParamNames", [1, "", []], False),
        ("getSystemState", None, False),
    ],
)
def test_an_empty_graph_is_noticed(method: str, answer: object, is_nothing: bool) -> None:
    assert shows_nothing(method, answer) is is_nothing


def test_the_command_that_shows_it_is_said() -> None:
    assert nothing_shown("/r") == ("nothing that /r may see; all of it needs: rossec grant sign /r --graph")
