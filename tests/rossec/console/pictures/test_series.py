"""A number over a minute."""

import math
from typing import Any

from rossec.console import samples
from rossec.console.pictures import looks
from rossec.console.samples import SeenTopic, SyntheticSample, see
from tests.support.drawings import checked, texts


def values(*given: Any) -> SeenTopic:
    samples = tuple(SyntheticSample(at, {"seq": at, "data": value}) for at, value in enumerate(given))
    return SeenTopic("/doctor", "/t", "std_msgs/Float64", len(samples), samples)


def test_a_number_that_changes_is_a_line() -> None:
    recorded = samples.recorded("/t", "sensor_msgs/Temperature")
    assert recorded is not None
    seen = see(recorded, "/doctor", ())
    field = looks.field_of(seen)
    assert field == "temperature"
    span = looks.span_of([seen], field)
    assert span is not None
    root = checked(looks.draw_series(seen, field, span))
    assert f"{span.high:.4g}" in texts(root)


def test_a_number_inside_a_message_has_a_path() -> None:
    inside = values({"x": 1.0}, {"x": 2.0})
    assert looks.field_of(inside) == "data.x"


def test_strange_values_stay_inside() -> None:
    for given in ((1.0,), (2.0, 2.0), (math.nan, 1.0), (9e299, -9e299), (True, 3)):
        seen = values(*given)
        field = "data"
        span = looks.span_of([seen], field)
        assert span is not None
        checked(looks.draw_series(seen, field, span))


def test_what_has_no_number_has_no_line() -> None:
    assert looks.field_of(values("text")) == ""
    assert looks.field_of(values()) == ""
    assert looks.span_of([values("text")], "data") is None
    assert looks.draw_series(values("text"), "data", looks.Span(0, 1, 0, 1)) is None
