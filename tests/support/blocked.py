"""Blocks nodes from the master, by name: the test chooses which connects again first."""

from typing import Any

import pytest

from rossec.participant.membership import MasterSession


class BlockedNodes:
    """While a name is in `names` its node does not reach the master; `tries` counts attempts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.names: set[str] = set()
        self.tries = 0
        stock = MasterSession.open

        async def attempt(session: MasterSession) -> Any:
            if session._name in self.names:
                self.tries += 1
                raise OSError("blocked")
            return await stock(session)

        monkeypatch.setattr(MasterSession, "open", attempt)
