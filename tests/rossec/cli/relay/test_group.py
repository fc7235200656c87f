"""The group `rossec relay`."""

from tests.support.commands import Shell, refused


def test_the_verbs_are_listed(empty: Shell) -> None:
    said = empty("relay", "--help").out
    for verb in ("add", "card", "list", "remove", "seat", "status"):
        assert f"\n  {verb} " in said


def test_without_a_verb_it_runs(empty: Shell) -> None:
    refused(empty("relay"), "/relay has no ca.pem", "rossec node request /relay")
    refused(empty("relay", "--name", "/relay/attic"), "/relay/attic has no ca.pem")
    refused(empty("relay", "--name", "/attic"), "'/attic' is not the name of a relay", "ROSSEC_REL")
