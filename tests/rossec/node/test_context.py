from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import pytest

from rossec.errors import AnswerRefused, NodeShutdown
from rossec.node.context import NodeContext


@pytest.fixture
def context() -> NodeContext:
    parts: Any = Mock()
    return NodeContext("/robot", parts, parts, parts, parts, lambda _: b"key", parts)


def test_a_refused_registration_does_not_prevent_the_others(
    context: NodeContext, caplog: pytest.LogCaptureFixture
) -> None:
    done = []
    for topic in ("/a", "/b"):
        with context.restoring(topic):
            done.append(topic)
            raise AnswerRefused("no grant covers it")
    assert done == ["/a", "/b"]
    assert caplog.messages[0] == "/robot: /a is not registered again: no grant covers it"


def test_another_error_ends_the_restoring(context: NodeContext) -> None:
    with pytest.raises(NodeShutdown), context.restoring("/a"):
        raise NodeShutdown("closed")


def test_to_a_foreigner_a_node_calls_itself_by_its_certified_name(context: NodeContext) -> None:
    own, foreign = Mock(is_foreign=False), Mock(is_foreign=True)
    assert context.name_for(own) == context.name_for(foreign) == "/robot"
    anonymous = replace(context, name="/rviz_1_2", certified="/rviz")
    assert (anonymous.name_for(own), anonymous.name_for(foreign)) == ("/rviz_1_2", "/rviz")
