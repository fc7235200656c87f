from tests.rossec.cli.ca.record import key_of, listed
from tests.support.commands import Shell, refused

REVOKE = ("ca", "revoke", "/robot", "--reason", "stolen", "--master", "http://127.0.0.1:1")


def test_an_identity_can_be_revoked(shell: Shell) -> None:
    shell.enroll("/robot")
    said = shell.unlocked(*REVOKE)
    assert said.out == "revoked /robot, 1 key (list 2)\n"
    refused(said, "did not take the list", "rossec ca publish", code=3)
    assert listed(shell) == {key_of(shell, "/robot")}
    refused(shell.unlocked(*REVOKE), "/robot has no valid identity to revoke", "rossec ca show")
    grant = ("grant", "sign", "/robot", "--publish", "/p")
    refused(shell.unlocked(*grant), "/robot has no valid identity", "rossec node request /robot")
    request = str(shell.node("/robot") / "node.csr")
    refused(shell.unlocked("ca", "sign", request, "--yes"), "key of /robot is revoked", "new key")
    shell.node("/robot").rename(shell.root / "old")
    shell.enroll("/robot")


def test_an_unknown_or_invalid_name_is_not_revoked(shell: Shell) -> None:
    refused(shell.unlocked("ca", "revoke", "/nobody"), "/nobody has no valid identity")
    refused(shell.unlocked("ca", "revoke", "robot"), "not an absolute ROS name", "/robot1/camera")
    refused(shell.unlocked("ca", "revoke", "/ca"), "the authority's own node", "create a new one")
    assert listed(shell) == frozenset()


def test_a_list_is_not_delivered_without_a_master(shell: Shell) -> None:
    said = shell("ca", "publish", "--master", "http://127.0.0.1:1")
    refused(said, "did not take the list", "rossec ca publish", code=3)
    refused(shell("ca", "publish", "--master", "127.0.0.1"), "does not begin with http://")


def test_a_list_can_be_signed_anew(shell: Shell) -> None:
    said = shell.unlocked("ca", "refresh", "--master", "http://127.0.0.1:1")
    assert said.out.startswith("list 2 holds until ")
    refused(said, "did not take the list", "rossec ca publish", code=3)


def test_an_anonymous_node_is_revoked_with_its_identity(shell: Shell) -> None:
    shell("node", "request", "/rviz")
    request = str(shell.node("/rviz") / "node.csr")
    shell.unlocked("ca", "sign", request, "--yes", "--anonymous")
    revoke = ("ca", "revoke", "/rviz_17", "--master", "http://127.0.0.1:1")
    refused(
        shell.unlocked(*revoke), "/rviz_17 has no valid", "nodes of /rviz: revoking that revokes"
    )
