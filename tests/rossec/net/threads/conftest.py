from collections.abc import Iterator

import pytest

from tests.support.listener import SecureListener
from tests.support.secure_sockets import make_listener
from tests.support.wire import FakeIdentity


@pytest.fixture
def listener() -> Iterator[SecureListener[FakeIdentity]]:
    with make_listener() as made:
        yield made
