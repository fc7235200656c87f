"""`python -m tests.support.signer ROOT`: one of several operators of the same authority.

Opens the authority below ROOT as every command does, prints a line, then executes each line of its
input (`revoke NAME`), and prints the number of the list, or the error.
"""

import sys
import time
from pathlib import Path

from ca.errors import HintedError
from rossec.authority.home import AuthorityHome
from tests.support.commands import PASSPHRASE


def main(root: Path) -> None:
    authority = AuthorityHome.at(root).unlock(PASSPHRASE)
    print("ready", flush=True)  # noqa: T201
    for line in sys.stdin:
        _, name = line.split()
        try:
            listed, _ = authority.revoke_identity(name, "at once", int(time.time()))
            print(f"list {listed.seq}", flush=True)  # noqa: T201
        except HintedError as error:
            print(f"error: {error}", flush=True)  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
