"""The spec's diagram and table are those of the code."""

import re
from pathlib import Path

from rossec.channel.negotiation import HANDSHAKING, TABLE, ConnectionState

_ROOT = Path(__file__).parents[3]
_SPEC = (_ROOT / "docs" / "spec" / "channel.md").read_text()
WITHOUT_FRAME = (
    (ConnectionState.OPENING, ConnectionState.DRAINING, "plain caller"),
    (ConnectionState.OPENING, ConnectionState.WAIT_1, "opening (responder)"),
    (ConnectionState.OPENING, ConnectionState.WAIT_2, "answer (initiator)"),
    (ConnectionState.DRAINING, ConnectionState.CLOSED, "refusal sent"),
    (ConnectionState.WAIT_4, ConnectionState.CLOSING, "close()"),
    (ConnectionState.OPEN, ConnectionState.CLOSING, "close()"),
    (ConnectionState.CLOSING, ConnectionState.CLOSED, "end of TCP"),
)
"""Transitions without a frame; and from every state, any error leads to CLOSED."""


def diagram() -> str:
    """The table as mermaid draws it."""
    edges: dict[tuple[ConnectionState, ConnectionState], list[str]] = {}
    for start, end, reason in WITHOUT_FRAME:
        edges.setdefault((start, end), []).append(reason)
    for (start, kind), (_, following) in TABLE.items():
        for end in following or (ConnectionState.CLOSED,):
            edges.setdefault((start, end), []).append(kind.name)
    lines = [f"  {a.name} --> {b.name}: {', '.join(why)}" for (a, b), why in edges.items()]
    return "\n".join(["stateDiagram-v2", *lines])


def test_the_diagram_of_the_spec_is_drawn_from_the_table() -> None:
    found = re.search(r"```mermaid\n(.*?)\n```", _SPEC, re.DOTALL)
    assert found is not None
    assert found[1] == diagram()


def test_every_state_has_a_way_out_and_every_row_a_method() -> None:
    from rossec.channel.connection import Connection
    from rossec.channel.negotiation import Negotiation

    leaving = {start for start, _ in TABLE} | {start for start, _, _ in WITHOUT_FRAME}
    assert leaving == set(ConnectionState) - {ConnectionState.CLOSED}
    for (state, _), (name, _) in TABLE.items():
        assert hasattr(Negotiation if state in HANDSHAKING else Connection, name)


def test_all_26_points_name_tests_that_exist() -> None:
    rows = re.findall(r"^\| (\d+) \| (.*) \| (.*) \|$", _SPEC, re.MULTILINE)
    assert [int(number) for number, _, _ in rows if int(number) <= 26][-26:] == list(range(1, 27))
    here = _ROOT / "tests" / "rossec" / "channel"
    for _, _, where in rows[-26:]:
        files = [
            path if "/" in path else f"tests/rossec/channel/{path}"
            for path in re.findall(r"[\w/]*test_\w+\.py", where)
        ]
        text = "".join((_ROOT / path).read_text() for path in files)
        for name in re.findall(r"`(test_\w+)`", where):
            assert f"def {name}(" in text, (name, files)
    assert here.is_dir()


def test_the_spec_is_short_enough() -> None:
    assert len(_SPEC.splitlines()) <= 500
