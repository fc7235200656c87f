import logging

from rossec.peer_limits import LogRateLimit


def line(text: str, at: float) -> logging.LogRecord:
    record = logging.LogRecord("rossec", logging.WARNING, "", 0, text, (), None)
    record.created = at
    return record


def test_the_same_text_passes_once_a_minute() -> None:
    limit = LogRateLimit()
    assert limit.filter(line("a", 0))
    assert limit.filter(line("b", 1))
    assert not limit.filter(line("a", 59))
    assert limit.filter(line("a", 60)), "counted from when it was logged, not from when it was left out"
    assert not limit.filter(line("a", 61))


def about(name: str, text: str, at: float) -> logging.LogRecord:
    record = line("refused %s: %s", at)
    record.args = (name, text)
    return record


def test_a_flood_of_texts_is_bounded() -> None:
    limit = LogRateLimit()
    texts = [about(f"/n{number % 20}", str(number), number / 100) for number in range(2000)]
    assert sum(map(limit.filter, texts)) == 512
    late = about("/n1", "late", 59)
    assert not limit.filter(late)
    late.levelno = logging.ERROR
    assert limit.filter(late), "errors are always logged"
    assert limit.filter(about("/n1", "later", 61)), "the oldest are forgotten"


def test_one_subject_does_not_suppress_lines_about_others() -> None:
    limit = LogRateLimit()
    assert sum(limit.filter(about("/eve", str(number), 1)) for number in range(2000)) == 64
    for name in ("/a", "/b", "/c", "/d", "/e", "/f", "/g", "/h"):
        assert sum(limit.filter(about(name, str(number), 2)) for number in range(99)) in {56, 64, 1}
    assert limit.filter(about("/robot", "for the first time", 3))
    assert not limit.filter(about("/robot", "and again", 3))
    firsts = [about(f"/x{number}", "", 4) for number in range(2000)]
    assert sum(map(limit.filter, firsts)) < 1024
    assert limit.filter(about("/robot", "much later", 64))
