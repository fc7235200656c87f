from grants.filters.layout import Array, Primitive, Struct
from grants.filters.operators import (
    ArrayTreatment,
    Constant,
    FieldTreatment,
    HysteresisBinding,
    Keep,
    Node,
    Numbers,
    StructTreatment,
    has_hysteresis,
)

NUMBER = Primitive("float64", "d", 8)


def numbers(*, hysteresis: bool) -> FieldTreatment:
    bound = HysteresisBinding((1.0,), lambda _: abs) if hysteresis else None
    return FieldTreatment(NUMBER, Numbers(abs, abs, bound))


def message(*parts: Node) -> StructTreatment:
    return StructTreatment(Struct("a/B", ()), parts)


def test_hysteresis_is_found_at_any_depth() -> None:
    with_one, without = numbers(hysteresis=True), numbers(hysteresis=False)
    assert has_hysteresis(with_one)
    assert has_hysteresis(message(Keep(NUMBER), message(without, with_one)))
    assert not has_hysteresis(message(Keep(NUMBER), message(without)))


def test_arrays_and_other_treatments_have_no_hysteresis() -> None:
    assert not has_hysteresis(FieldTreatment(NUMBER, Constant(bytes(8))))
    assert not has_hysteresis(ArrayTreatment(Array(NUMBER, None), numbers(hysteresis=False)))
