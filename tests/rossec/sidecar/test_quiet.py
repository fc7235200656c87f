import logging

from rossec.sidecar.quiet import Quiet


def said(text: str, at: float) -> logging.LogRecord:
    record = logging.LogRecord("rossec", logging.WARNING, "", 0, text, (), None)
    record.created = at
    return record


def test_the_same_text_passes_once_a_minute() -> None:
    quiet = Quiet()
    assert quiet.filter(said("a", 0))
    assert quiet.filter(said("b", 1))
    assert not quiet.filter(said("a", 59))
    assert quiet.filter(said("a", 60)), "counted from when it was said, not from when it was not"
    assert not quiet.filter(said("a", 61))


def test_a_flood_of_texts_is_bounded() -> None:
    quiet = Quiet()
    assert sum(quiet.filter(said(str(number), number / 100)) for number in range(2000)) == 512
    late = said("late", 59)
    assert not quiet.filter(late)
    late.levelno = logging.ERROR
    assert quiet.filter(late), "a mistake of ours"
    assert quiet.filter(said("later", 61)), "the oldest is forgotten"
