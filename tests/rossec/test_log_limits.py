import logging

from rossec.log_limits import LogRateLimit


def said(text: str, at: float) -> logging.LogRecord:
    record = logging.LogRecord("rossec", logging.WARNING, "", 0, text, (), None)
    record.created = at
    return record


def test_the_same_text_passes_once_a_minute() -> None:
    quiet = LogRateLimit()
    assert quiet.filter(said("a", 0))
    assert quiet.filter(said("b", 1))
    assert not quiet.filter(said("a", 59))
    assert quiet.filter(said("a", 60)), "counted from when it was said, not from when it was not"
    assert not quiet.filter(said("a", 61))


def about(who: str, text: str, at: float) -> logging.LogRecord:
    record = said("refused %s: %s", at)
    record.args = (who, text)
    return record


def test_a_flood_of_texts_is_bounded() -> None:
    quiet = LogRateLimit()
    texts = [about(f"/n{number % 20}", str(number), number / 100) for number in range(2000)]
    assert sum(map(quiet.filter, texts)) == 512
    late = about("/n1", "late", 59)
    assert not quiet.filter(late)
    late.levelno = logging.ERROR
    assert quiet.filter(late), "a mistake of ours"
    assert quiet.filter(about("/n1", "later", 61)), "the oldest are forgotten"


def test_one_subject_does_not_suppress_lines_about_others() -> None:
    quiet = LogRateLimit()
    assert sum(quiet.filter(about("/eve", str(number), 1)) for number in range(2000)) == 64
    for name in ("/a", "/b", "/c", "/d", "/e", "/f", "/g", "/h"):
        assert sum(quiet.filter(about(name, str(number), 2)) for number in range(99)) in {56, 64, 1}
    assert quiet.filter(about("/robot", "for the first time", 3))
    assert not quiet.filter(about("/robot", "and again", 3))
    firsts = [about(f"/x{number}", "", 4) for number in range(2000)]
    assert sum(map(quiet.filter, firsts)) < 1024
    assert quiet.filter(about("/robot", "much later", 64))
