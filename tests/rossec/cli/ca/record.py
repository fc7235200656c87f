"""What the authority of a test has recorded."""

from ca.revocation.lists import open_list
from rossec.authority.home import AuthorityHome
from tests.support.commands import Shell


def key_of(shell: Shell, name: str) -> bytes:
    rows = AuthorityHome.at(shell.root).store().identities.all()
    return next(row.thumbprint for row in reversed(rows) if row.name == name)


def listed(shell: Shell) -> frozenset[bytes]:
    home = AuthorityHome.at(shell.root)
    return open_list(home.revocation_list(), home.anchor().public_key).entries
