"""How handlers read the arguments of a request."""

import pytest

from rossec.master.api.methods import CallRequest
from tests.rossec.master.fakes import caller


def test_a_handler_reads_checked_arguments() -> None:
    request = CallRequest(caller("/a"), ("/a", b"bytes"), 0)
    assert request.binary(1) == b"bytes"
    with pytest.raises(TypeError):
        request.text(1)
    with pytest.raises(TypeError):
        request.binary(0)
