"""What an authority grants at all: rights on names of its own domain, and tails to who has them."""

from collections.abc import Iterable
from typing import Final

from ca.domains.aliases import is_alias, shown
from ca.errors import PassphraseRefused, RecordUnusable, TokenRefused
from ca.store.rows import CertificateRow
from grants.model import Draft, Permission, Right
from rossec.errors import (
    AuthorityLocked,
    ConfigurationError,
    KeyServiceFailed,
    KeyServiceRefused,
    SigningRefused,
)

OF_ALL: Final = (
    AuthorityLocked, KeyServiceFailed, KeyServiceRefused, PassphraseRefused, RecordUnusable,
    SigningRefused, TokenRefused,
)  # fmt: skip
"""Refusals that are about the key or the record, and so of every grant."""


def check_own_names(permissions: Iterable[Permission]) -> None:
    """Return if an authority may grant these: of others' names it shows its own graph, no more.

    Raises:
        ConfigurationError: a right on a name below `/remote`, which another authority grants.
    """
    for permission in permissions:
        if is_alias(permission.pattern) and permission.rights & ~Right.GRAPH:
            raise ConfigurationError(
                f"{shown(permission.pattern)} is a name of another domain or site",
                "its own authority grants rights on it, by its name there; here only --graph",
            )


def check_tail(draft: Draft, valid: Iterable[CertificateRow]) -> None:
    """Return if no names of anonymous nodes are granted, or the holder has their wildcard tail.

    Args:
        valid: the valid identities of the subject, oldest first; the newest of the key counts.

    Raises:
        ConfigurationError: its identity has none.
    """
    if not draft.has_tail_patterns:
        return
    tails = [row.wildcard for row in valid if row.thumbprint == draft.holder]
    if not any(tails[-1:]):
        raise ConfigurationError(
            f"{draft.subject} is one node, and has no names of anonymous nodes",
            f"give its names as they are: {draft.subject}/..., without ~",
        )
