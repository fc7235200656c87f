from collections.abc import AsyncIterator

import pytest

from rossec.net.aio import SecureServer, serve
from tests.support.contexts import context
from tests.support.secure_streams import echo
from tests.support.wire import BOB, FakeIdentity


@pytest.fixture
async def server() -> AsyncIterator[SecureServer[FakeIdentity]]:
    async with serve(echo, "127.0.0.1", 0, context(BOB)) as running:
        yield running
