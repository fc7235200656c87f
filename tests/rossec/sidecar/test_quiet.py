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


def test_it_remembers_a_bounded_number() -> None:
    quiet = Quiet()
    assert all(quiet.filter(said(str(number), 0)) for number in range(513))
    assert not quiet.filter(said("1", 1))
    assert quiet.filter(said("0", 1)), "forgotten"
