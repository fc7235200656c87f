"""A call at the master says what is needed for it."""

from pathlib import Path

from rossec.authority.session import StatementCall
from rossec.home import NodeHome


def test_a_call_has_the_usual_deadlines_and_no_note_unless_it_says_otherwise(tmp_path: Path) -> None:
    node = NodeHome(tmp_path, "/ca")
    call = StatementCall(node, "rossec.updateRevocations", (b"list",), "the list", "publish it")
    assert (call.node, call.method, call.statement) == (node, "rossec.updateRevocations", (b"list",))
    assert (call.note, call.within) == ("", None)
