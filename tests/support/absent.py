"""Nodes whose way to the master is blocked, by their names: who comes back first is the test's."""

from typing import Any

import pytest

from rossec.participant.master_session import MasterSession


class Absent:
    """While a name is in `names` its node does not reach the master; `tries` counts attempts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.names: set[str] = set()
        self.tries = 0
        stock = MasterSession.open

        async def attempt(session: MasterSession) -> Any:
            if session._name in self.names:
                self.tries += 1
                raise OSError("somebody is in the way")
            return await stock(session)

        monkeypatch.setattr(MasterSession, "open", attempt)
