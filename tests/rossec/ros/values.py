"""Values as both forms of a call carry them, for hypothesis; and what equality does not see."""

import math
from datetime import datetime

from hypothesis import strategies as st

# XML has no form for these; a carriage return is a line feed after XML, `test_differential` has it.
TEXTS = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="\r￾￿").filter(
        lambda char: char >= " " or char in "\t\n"
    )
)
SCALARS = (
    st.booleans()
    | st.integers(-(2**31), 2**31 - 1)
    | st.floats(allow_nan=True)
    | TEXTS
    | st.binary(max_size=40)
    | st.datetimes(min_value=datetime.fromisoformat("1000-01-01")).map(
        lambda when: when.replace(microsecond=0)
    )
)
VALUES = st.recursive(
    SCALARS,
    lambda below: st.lists(below, max_size=4) | st.dictionaries(TEXTS, below, max_size=4),
    max_leaves=20,
)


def shape(value: object) -> object:
    """`value` with its types, so that 1, 1.0 and True differ, and NaN equals itself."""
    match value:
        case dict():
            return {name: shape(below) for name, below in value.items()}
        case list():
            return [shape(item) for item in value]
        case float():
            return "float", "nan" if math.isnan(value) else value.hex()
        case _:
            return type(value).__name__, value
