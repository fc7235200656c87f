"""An authority whose console's operations are called in this process; its clock is the test's."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

from ca.encoding import Value
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.process import operations_of
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.master_call import MasterCall
from rossec.errors import NotDelivered
from tests.support.commands import PASSPHRASE

NOW = 1_800_000_000


class Part(Protocol):
    """As `rossec.authority.console.service.Part`."""

    def handlers(self) -> Mapping[str, Callable[..., Value]]: ...


class ConsoleWork:
    """An authority below `root`, locked; its audit is a list, and it has no master."""

    def __init__(self, root: Path) -> None:
        self.root, self.now, self.seconds = root, NOW, 1000.0
        self.home = AuthorityHome.create(root, "home", PASSPHRASE, NOW)
        self.audit: list[str] = []
        self.called: list[MasterCall] = []
        self.operations = operations_of(self.home, self.audit.append)
        self.work = AuthorityWork(root, self.operations, self._deliver, now=lambda: self.now)

    def wait(self, seconds: int) -> None:
        """Time passes."""
        self.now += seconds
        self.seconds += seconds

    def elapsed(self) -> float:
        """A clock that cannot be set."""
        return self.seconds

    def unlock(self) -> None:
        """Hold the key while this runs."""
        self.operations.unlock(PASSPHRASE, 0, "a test")

    def _deliver(self, call: MasterCall) -> object:
        self.called.append(call)
        raise NotDelivered(f"the master did not get {call.what}: there is none", call.hint)


def ask(part: Part, operation: str, *arguments: Value) -> Value:
    """Have a part carry out an operation."""
    return part.handlers()[operation](*arguments)
