import inspect

import pytest

from ca import errors

ALL = [value for value in vars(errors).values() if inspect.isclass(value)]


def test_the_corpus_is_not_empty() -> None:
    assert len(ALL) > 15


@pytest.mark.parametrize("kind", ALL)
def test_every_error_carries_message_and_hint(kind: type[errors.HintedError]) -> None:
    error = kind("what happened", "what to do")
    assert str(error) == "what happened"
    assert error.hint == "what to do"
    assert kind("alone").hint == ""


@pytest.mark.parametrize("kind", [kind for kind in ALL if kind is not errors.HintedError])
def test_one_root(kind: type[errors.HintedError]) -> None:
    assert issubclass(kind, errors.CAError)
    assert kind.__doc__


@pytest.mark.parametrize(
    ("leaf", "parent"),
    [
        (errors.ForeignCertificate, errors.CertificateRefused),
        (errors.CertificateExpired, errors.CertificateRefused),
        (errors.CertificateNotYetValid, errors.CertificateRefused),
        (errors.ClocksDisagree, errors.RevocationRefused),
        (errors.PassphraseRefused, errors.KeyRefused),
        (errors.LogDamaged, errors.StoreError),
    ],
)
def test_leaves_can_be_caught_together(leaf: type[errors.CAError], parent: type[errors.CAError]) -> None:
    assert issubclass(leaf, parent)


def test_revoked_and_stale_are_told_apart() -> None:
    assert not issubclass(errors.Revoked, errors.RevocationsStale)
    assert not issubclass(errors.RevocationsStale, errors.Revoked)


def test_a_bare_error_refers_to_nothing_else() -> None:
    """Who keeps one would keep every frame, and with it what was received."""
    with pytest.raises(errors.EncodingError) as raised:
        raise errors.EncodingError("what happened", "what to do") from ValueError("the cause")
    kept = raised.value.bare()
    assert (type(kept), str(kept), kept.hint) == (errors.EncodingError, "what happened", "what to do")
    assert (kept.__traceback__, kept.__cause__, kept.__context__) == (None, None, None)
