"""An authority that can sign for all nodes but one."""

from collections.abc import Sequence
from typing import Any

import pytest

from grants.errors import GrantMalformed
from grants.model import Draft
from rossec.authority.signing import SigningAuthority


def refuse_to_sign_for(subject: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on what has a grant to `subject` in it is refused: `too large`."""
    signs = SigningAuthority.issue_grants

    def refuses(authority: SigningAuthority, drafts: Sequence[tuple[Draft, str]], *more: Any) -> list[bytes]:
        if any(draft.subject == subject for draft, _ in drafts):
            raise GrantMalformed("too large")
        return signs(authority, drafts, *more)

    monkeypatch.setattr(SigningAuthority, "issue_grants", refuses)
