"""One memory store for the nodes of a process."""

from grants.decision import Decision
from grants.model import Right
from rossec.participant.authorized import memory_scope
from tests.support.memory_scopes import HOLDER


def test_the_memory_outlives_the_node() -> None:
    decision = Decision(Right.SUBSCRIBE, "/a", (HOLDER,), 100, ())
    memory = memory_scope("/one")(decision)
    assert memory_scope("/one")(decision) is memory
    assert memory_scope("/two")(decision) is not memory
    assert memory.take(memory.bucket(1), object(), 0)
