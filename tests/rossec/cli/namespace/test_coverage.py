"""Whether grants or a policy give a node anything on a name."""

from pathlib import Path

import pytest

from grants.document import sign
from grants.model import Permission, Right
from rossec.authority.policyfile import parse_policy
from rossec.cli.namespace import Coverage, read_grants
from rossec.errors import ConfigurationError
from rossec.naming.requests import NameKind
from tests.grants.authority import CA, draft, granted

POLICY = """rossec: 1
robot: r
identities:
  lamp: {node: /lamp, key: "sha256:KEY"}
  any: {node: /rooms/*}
rules:
  - {id: a, who: lamp, allow: {publish: [/lamps/*]}}
  - {id: b, who: any, allow: {call: [/reset]}, }
  - {id: c, who: any, prompt: {subscribe: [/pose]}}
  - {id: d, who: any, deny: {publish: [/pose]}}
""".replace("KEY", "11" * 32)


def test_a_policy_covers_what_it_does_not_deny_whatever_key_it_pins() -> None:
    covers = Coverage((), parse_policy(POLICY, "policy.yaml"))
    assert covers("/lamp", NameKind.TOPIC, "/lamps/one")
    assert not covers("/lamp", NameKind.TOPIC, "/lamps/one/two")
    assert not covers("/lamp", NameKind.SERVICE, "/lamps/one")
    assert not covers("/other", NameKind.TOPIC, "/lamps/one")
    assert covers("/rooms/one", NameKind.SERVICE, "/reset")
    assert covers("/rooms/one", NameKind.TOPIC, "/pose")  # somebody decides
    assert covers("/rooms/one", NameKind.NODE, "/rooms/one")
    assert not covers("/attic", NameKind.NODE, "/attic")


def test_a_grant_covers_what_it_gives_its_node() -> None:
    permission = Permission("/lamps/**", Right.PUBLISH | Right.PARAM_GET)
    covers = Coverage([granted(permission, subject="/lamp")], None)
    assert covers("/lamp", NameKind.TOPIC, "/lamps/one")
    assert covers("/lamp", NameKind.NODE, "/lamp")
    assert not covers("/lamp", NameKind.SERVICE, "/lamps/one")
    assert not covers("/lamp", NameKind.TOPIC, "/lamp")
    assert not covers("/other", NameKind.TOPIC, "/lamps/one")
    assert not covers("/other", NameKind.NODE, "/other")


def test_grants_are_read_from_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="there are no grants in"):
        read_grants(tmp_path)
    (tmp_path / "a.grant").write_bytes(sign(CA, draft(subject="/lamp")))
    assert [grant.subject for grant in read_grants(tmp_path)] == ["/lamp"]
    (tmp_path / "b.grant").write_bytes(b"no grant")
    with pytest.raises(ConfigurationError, match=r"b\.grant is not a grant"):
        read_grants(tmp_path)
