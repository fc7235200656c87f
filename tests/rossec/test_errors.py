import pytest

from ca.errors import HintedError
from rossec import errors


@pytest.mark.parametrize("name", [name for name, found in vars(errors).items() if isinstance(found, type)])
def test_every_error_can_be_shown_with_its_hint(name: str) -> None:
    assert issubclass(getattr(errors, name), HintedError)


def test_a_refused_http_message_has_the_status_of_its_answer() -> None:
    assert errors.HttpRefused("too long", status=413).status == 413
    assert errors.HttpRefused("no request").status == 400


def test_a_refused_call_has_the_code_of_its_answer() -> None:
    refused = errors.AnswerRefused("the grant is missing", "ask for it", code=0)
    assert (str(refused), refused.hint, refused.code) == ("the grant is missing", "ask for it", 0)
    assert errors.AnswerRefused("no").code == -1
