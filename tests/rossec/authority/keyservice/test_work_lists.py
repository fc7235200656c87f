"""The service and a master that has lost the list it was given."""

from pathlib import Path

from ca.revocation.trust_status import open_statement
from rossec.authority.session import StatementCall
from tests.rossec.authority.keyservice.test_work import Working

LIST = "rossec.updateRevocations"


class Telling(Working):
    """Its master says which list it has."""

    has_list = True

    def deliver(self, call: StatementCall) -> object:
        if call.method != "rossec.revocationStatus":
            return super().deliver(call)
        newest = open_statement(self.home.revocation_list(), self.home.own_key())
        epoch, seq = newest.number if self.has_list else (0, 0)
        return {"list": f"{epoch}.{seq}"}


def test_a_master_that_was_set_back_gets_the_list_again(tmp_path: Path) -> None:
    """A snapshot of its host, or another host: what was revoked since would be valid there."""
    working = Telling(tmp_path)
    working.work.maintain()
    assert working.calls.count(LIST) == 1
    working.work.maintain()
    assert working.calls.count(LIST) == 1, "it has the list"
    working.has_list = False
    working.work.maintain()
    assert working.calls.count(LIST) == 2


def test_a_master_that_does_not_tell_is_believed(tmp_path: Path) -> None:
    """One of an older version: it gets each new list once, as it did."""
    working = Working(tmp_path)
    working.work.maintain()
    working.work.maintain()
    assert working.calls.count(LIST) == 1
