"""A master for commands that refuses every grant, and takes everything else."""

from typing import Any

import pytest

from rossec.authority.session import StatementCall

REASON = "no room"


def refuse_grants(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on the authority's commands find this master, wherever they look."""

    def answer(_environment: object, _uri: object, call: StatementCall) -> Any:
        if call.method == "rossec.depositGrants":
            (grants,) = call.statement
            assert isinstance(grants, list)
            return [REASON for _ in grants]
        return 1

    monkeypatch.setattr("rossec.cli.shared.service.call_master", answer)
