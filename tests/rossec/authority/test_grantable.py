"""What an authority refuses to grant, whoever asks it to."""

from pathlib import Path

import pytest

from grants.model import Permission, Right
from rossec.authority.signing import check_own_names, check_tail
from rossec.errors import ConfigurationError
from tests.grants.authority import draft
from tests.support.site import Site


def test_of_names_of_others_an_authority_shows_its_own_graph_and_grants_nothing() -> None:
    check_own_names([Permission("/remote/**", Right.GRAPH), Permission("/**", Right(255))])
    for right in Right:
        if right is Right.GRAPH:
            continue
        for pattern in ("/remote/hospital/a", "/remote/**", "/remote/*/a"):
            with pytest.raises(ConfigurationError, match="a name of another domain") as refused:
                check_own_names([Permission(pattern, right | Right.GRAPH)])
            assert "--graph" in refused.value.hint


def test_of_what_a_gateway_serves_an_authority_grants_every_right() -> None:
    served = [Permission(f"/gateway/{name}", Right(255)) for name in ("**", "hospital/pose")]
    check_own_names(served)
    for pattern in ("/remote/hospital/gateway/clinic/pose", "/remote/**"):
        with pytest.raises(ConfigurationError, match="a name of another domain"):
            check_own_names([*served, Permission(pattern, Right.SUBSCRIBE)])


def test_names_of_anonymous_nodes_are_granted_to_who_has_the_tail(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.enroll("/rviz", wildcard=True)
    site.enroll("/robot")
    store, now = site.authority.store, site.now()
    tail = [Permission("/rviz~/get_loggers", Right.PROVIDE)]
    rows = store.identities.valid("/rviz", now)
    made = draft(*tail, subject="/rviz", holder=rows[0].thumbprint)
    check_tail(made, rows)
    plain = store.identities.valid("/robot", now)
    own = [Permission("/robot~/get_loggers", Right.PROVIDE)]
    for draft_of, valid in (
        (made, []),
        (draft(*tail, subject="/rviz", holder=bytes(32)), rows),
        (draft(*own, subject="/robot", holder=plain[0].thumbprint), plain),
    ):
        with pytest.raises(ConfigurationError, match="names of anonymous nodes") as refused:
            check_tail(draft_of, valid)
        assert "without ~" in refused.value.hint
    check_tail(draft(subject="/robot"), [])


def test_the_authority_signs_none_for_another(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.enroll("/robot")
    (row,) = site.authority.store.identities.valid("/robot", site.now())
    own = Permission("/robot~/get_loggers", Right.PROVIDE)
    with pytest.raises(ConfigurationError, match="names of anonymous nodes"):
        site.authority.issue_grant(draft(own, subject="/robot", holder=row.thumbprint), site.now())
