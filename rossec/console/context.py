"""What every page gets: the service, this console's settings, and what it remembers.

Nothing here is written to a disk: a console that is started again knows nobody, and asks again.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from rossec import clock
from rossec.authority.console.client import ConsoleClient
from rossec.clock import Seconds, counter
from rossec.console.endings import Endings
from rossec.console.enrollments import Enrollments
from rossec.console.failures import FailureLimit
from rossec.console.known_phones import KnownPhones
from rossec.console.made_codes import MadeCodes
from rossec.console.news import NewsFeed
from rossec.console.pending import PendingActs
from rossec.console.samples import Preview
from rossec.console.sessions import Sessions
from rossec.console.settings import Settings
from rossec.console.turns import Turns


class Scanner(Protocol):
    """Reads codes out of pictures, in a process of its own."""

    async def read(self, frame: bytes) -> str | None:
        """The text of the code in a picture (JPEG, PNG); None: there is none in it.

        Raises:
            HintedError: it cannot be read now.
        """
        ...


@dataclass
class ConsoleContext:
    """One console.

    Args:
        service: the authority's service.
        settings: what it was started with.
        scanner: reads codes; None: this console has none.
        preview: gives real messages; None: pictures show made-up ones, and say so.
        clock: seconds since the epoch.
        elapsed: seconds of a clock that cannot be set, for what ends after some time.
    """

    service: ConsoleClient
    settings: Settings
    scanner: Scanner | None = None
    preview: Preview | None = None
    clock: Callable[[], int] = clock.now
    elapsed: Seconds = field(default_factory=counter)
    sessions: Sessions = field(init=False)
    phones: KnownPhones = field(init=False)
    news: NewsFeed = field(init=False)
    failures: FailureLimit = field(init=False)
    pending: PendingActs = field(init=False)
    enrollments: Enrollments = field(init=False)
    made_codes: MadeCodes = field(init=False)
    turns: Turns = field(init=False)
    endings: Endings = field(init=False)

    def __post_init__(self) -> None:
        self.sessions = Sessions(self.settings.lifetime, self.settings.idle)
        self.phones = KnownPhones(self.service.phones)
        self.news = NewsFeed(self.service.status)
        self.failures = FailureLimit()
        self.pending = PendingActs()
        self.made_codes = MadeCodes()
        self.turns = Turns()
        self.endings = Endings()
        self.enrollments = Enrollments(
            self.service, self.settings.domain, self.clock, self.news.changed
        )
