"""How handlers read the arguments of a request."""

import pytest

from rossec.master.api.methods import CallRequest
from rossec.master.state.registry import NodeRef
from tests.rossec.master.fakes import caller


def test_a_handler_reads_checked_arguments() -> None:
    request = CallRequest(caller("/a"), ("/a", b"bytes"), 0)
    assert request.binary(1) == b"bytes"
    with pytest.raises(TypeError):
        request.text(1)
    with pytest.raises(TypeError):
        request.binary(0)


def test_a_node_is_the_caller_at_the_uri_it_gives() -> None:
    request = CallRequest(caller("/a"), ("/a", "/t", "http://a:1/"), 0)
    assert request.text(1) == "/t"
    assert request.node(2) == NodeRef("/a", "http://a:1/", caller("/a").thumbprint)
