"""Whether what was ended has ended, by what the master said of its list."""

import pytest

from rossec.authority.console.messages import ListProgress
from rossec.console.matrix import STALE, Endings, Heard

ASKED = 1_800_000_000
DONE = ListProgress(1, 4, True, True, 3, 3)


@pytest.mark.parametrize(
    ("trust_status", "heard"),
    [
        (DONE, Heard(ASKED, 0)),
        (DONE._replace(nodes_with_list=2), Heard()),
        (DONE._replace(is_signed=False), Heard()),
        (DONE._replace(is_at_master=False), Heard()),
        (DONE._replace(is_at_master=False, nodes=0, nodes_with_list=0), Heard()),
        (DONE._replace(nodes=0, nodes_with_list=0), Heard(0, ASKED - STALE)),
    ],
)
def test_only_the_third_tick_ends_it(trust_status: ListProgress, heard: Heard) -> None:
    endings = Endings()
    endings.note(trust_status, ASKED)
    assert endings.heard == heard


def test_what_was_heard_stays_heard() -> None:
    endings = Endings()
    endings.note(DONE, ASKED)
    endings.note(DONE._replace(nodes_with_list=0), ASKED + 9)
    endings.note(DONE, ASKED - 9)
    assert endings.heard == Heard(ASKED, 0)
    assert endings.heard.has(ASKED - 1, keeps=True)
    assert not endings.heard.has(ASKED, keeps=True), "it may have come after the question"


def test_a_stale_list_ends_no_connection_that_outlives_it() -> None:
    heard = Heard(ASKED, ASKED + 50)
    assert heard.has(ASKED + 49, keeps=False)
    assert not heard.has(ASKED + 49, keeps=True)
