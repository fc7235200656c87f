"""A master for commands that refuses every grant, and takes everything else."""

from typing import Any

import pytest

from rossec.authority.master_call import MasterCall

REASON = "no room"


def refuse_grants(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on the authority's commands find this master, wherever they look."""

    def answer(_environment: object, _uri: object, call: MasterCall) -> Any:
        if call.method == "rossec.depositGrants":
            (grants,) = call.statement
            assert isinstance(grants, list)
            return [REASON for _ in grants]
        return 1

    monkeypatch.setattr("rossec.cli.shared.service.call_master", answer)
