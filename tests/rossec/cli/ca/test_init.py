import json

from tests.support.commands import Shell, refused


def test_a_new_authority_shows_itself(empty: Shell) -> None:
    shell = empty
    made = shell.unlocked("ca", "init", "home")
    said = shell("ca", "show")
    assert said.out.startswith(made.out)
    assert said.out.startswith(f"authority of home in {shell.root}/ca\nfingerprint ")
    assert "/ca  until" in said.out
    listed = json.loads(shell("ca", "show", "--json").out)
    assert listed["domain"] == "home"
    assert [node["name"] for node in listed["identities"]] == ["/ca"]


def test_one_authority_per_home(shell: Shell) -> None:
    refused(shell.unlocked("ca", "init", "home"), "there is an authority", "another ROSSEC_HOME")
    shell("node", "request", "/master")
    refused(shell.unlocked("ca", "init", "home", "--master"), "there is an authority")


def test_a_trust_domain_has_its_syntax(empty: Shell) -> None:
    refused(empty.unlocked("ca", "init", "My Home!"), "not a trust domain", "lower case")
    refused(empty("ca", "show"), "there is no authority", "rossec ca init DOMAIN")


def test_the_master_of_the_same_host_is_enrolled_at_once(empty: Shell) -> None:
    said = empty.unlocked("ca", "init", "home", "--master")
    assert "/master in " in said.out
    assert "start it with: rossec master" in said.out
    listed = json.loads(empty("ca", "show", "--json").out)
    assert [node["name"] for node in listed["identities"]] == ["/ca", "/master"]


def test_a_master_that_is_there_already_stops_it_before_anything_is_made(empty: Shell) -> None:
    assert empty("node", "request", "/master").code == 0
    refused(empty.unlocked("ca", "init", "home", "--master"), "/master is in", "move that away")
    assert not (empty.root / "ca").exists()
    assert empty.unlocked("ca", "init", "home").code == 0


def test_a_key_in_a_token_is_named_by_its_uri(empty: Shell) -> None:
    refused(empty.unlocked("ca", "init", "home", "--key", "file:x"), "does not name a key in a token")
    assert not (empty.root / "ca").exists()
