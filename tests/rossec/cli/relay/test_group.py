"""The group `rossec relay`."""

from tests.support.commands import Shell, refused


def test_without_a_verb_it_runs(empty: Shell) -> None:
    refused(empty("relay"), "/relay has no ca.pem", "rossec node request /relay")
    refused(empty("relay", "--name", "/relay/attic"), "/relay/attic has no ca.pem")
    refused(empty("relay", "--bind", "10.0.0.1", "list"), "only --name stands before a verb", code=2)
    refused(empty("relay", "--name", "/attic"), "'/attic' is not the name of a relay", "ROSSEC_REL")
