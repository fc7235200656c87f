"""The group `rossec gateway`, and the errors of a beginner."""

import pytest

from tests.support.commands import Shell, refused


def test_without_a_verb_it_runs(empty: Shell) -> None:
    serve = ("--from", "ada", "/robot/pose")
    refused(empty("gateway", *serve), "/gateway has no ca.pem", "rossec node request /gateway")
    named = empty("gateway", "--name", "/gateway/attic", *serve)
    refused(named, "/gateway/attic has no ca.pem")
    after = empty("gateway", *serve, "--name", "/gateway/attic")
    refused(after, "/gateway/attic has no ca.pem")
    wrong = empty("gateway", "--name", "/attic", *serve)
    refused(wrong, "'/attic' is not the name of a gateway", "ROSSEC_GATEWAY")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "which topics shall it serve? rossec gateway --from hospital"),
        (("--rate", "5"), "--rate stands behind --from"),
        (("--newest", "--from", "ada", "/x"), "--newest stands behind --from"),
        (("--from", "ada"), "--from ada names no topics"),
        (("--compress",), "--compress stands behind --from"),
        (("--json", "status"), "only --name stands before a verb"),
        (("--from", "ada", "/x", "--json", "status"), "only --name stands before a verb"),
    ],
)
def test_what_stands_in_the_wrong_place_is_refused(empty: Shell, words: tuple[str, ...], says: str) -> None:
    refused(empty("gateway", *words), says, "see: rossec gateway --help", code=2)


def test_a_wrong_pattern_says_what_to_write(empty: Shell) -> None:
    refused(empty("gateway", "--from", "ada", "ada:/pose"), "is a name here", "--from ada /pose")
    refused(empty("gateway", "--from", "ada", "/x", "--rate", "0"), "a rate of 0.0", "0.001")
