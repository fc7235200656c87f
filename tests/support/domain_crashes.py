"""`python -m tests.support.domain_crashes DIRECTORY`: a node takes lists, under kill -9.

It is killed at every write while it takes a newer list of domains, and what a foreign domain has
revoked; whoever starts next has the lists from before or the newer ones, whole, never an older one
than was used. Prints how often it was killed, as JSON.
"""

import json
import sys
from collections import Counter
from functools import partial
from pathlib import Path

from ca.revocation.trust_status import TrustStatus
from rossec.home import NodeHome
from rossec.participant.master_updates import DomainUpdates
from rossec.saved_statements import DomainFiles
from tests.support.domains import Pair, domains, foreign, revoked
from tests.support.killing import run_killed
from tests.support.pki import NOW

DOMAIN, KEY = "hospital.example", b"k" * 32


def start(pair: Pair, directory: Path) -> tuple[DomainFiles, TrustStatus]:
    """What a node that was started knows."""
    files = DomainFiles(NodeHome(directory, "/robot"), pair.home.anchor)
    return files, files.trust_status(files.anchors(), pair.own, NOW)


def take(pair: Pair, directory: Path, listed: bytes, word: bytes) -> None:
    files, trust_status = start(pair, directory)
    updates = DomainUpdates(trust_status, files, lambda _: None, tuple)
    updates.take_domains(listed)
    held = trust_status.foreign(DOMAIN)
    assert held is not None
    if held.data != word:
        held.update(word, NOW, partial(files.save_foreign, pair.hospital.anchor))


def main(directory: Path) -> None:
    pair, killed = Pair(), Counter[str]()
    entry = foreign(pair.hospital)
    lists = [domains(pair.home, entry, seq=number) for number in (1, 2)]
    words = [revoked(pair.hospital), revoked(pair.hospital, KEY, seq=2)]
    for last in range(1, 100):
        node = directory / f"node{last}"
        node.mkdir(mode=0o700)
        take(pair, node, lists[0], words[0])
        name = run_killed(partial(take, pair, node, lists[1], words[1]), last)
        files, trust_status = start(pair, node)
        held = trust_status.foreign(DOMAIN)
        assert held is not None
        assert trust_status.anchors.data in lists
        assert held.data in words
        assert held.data != words[1] or trust_status.anchors.data == lists[1], "not in this order"
        take(pair, node, lists[1], words[1])
        assert (files.load_domains(), files.load_foreign(DOMAIN)) == (lists[1], words[1])
        if name is None:
            break
        killed[name] += 1
    sys.stdout.write(json.dumps(killed))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
