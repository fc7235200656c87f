import re

from hypothesis import given
from hypothesis import strategies as st

from rossec.cli.completion.values import MAX_WORDS, is_offered, offered


@given(st.text())
def test_no_word_is_more_than_a_word(text: str) -> None:
    if is_offered(text):
        assert re.fullmatch(r"[A-Za-z0-9_./:+-]+", text)
        assert text[0] != "-"


def test_names_of_ros_and_of_rossec_are_words() -> None:
    for word in ("/robot1/camera", "std_msgs/String", "51347856", "hospital:/r/x_1", "param-get"):
        assert is_offered(word)
    for other in ("", "-x", "a b", "$(id)", "`id`", "a\n", "a,b", "*", "~", "\x1b[1m", None, 3):
        assert not is_offered(other)


def test_words_are_sorted_and_few() -> None:
    assert offered(["/b", "/a", "/b", "x", "$x", None], "/") == ["/a", "/b"]
    assert len(offered((f"/n{number}" for number in range(MAX_WORDS * 2)), "")) == MAX_WORDS
