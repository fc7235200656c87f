"""One of several files that is refused does not fail the rest; a single one is refused as ever."""

from pathlib import Path

import pytest

from ca.errors import RecordUnusable, StoreError
from rossec.cli.shared.options import Batch, unique
from rossec.errors import ConfigurationError

PATH = Path("a.csr")


def refuse(batch: Batch, error: Exception) -> None:
    with batch.item(PATH):
        raise error


def test_one_refused_file_of_several_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    batch = Batch(3)
    refuse(batch, StoreError("is known", "see there"))
    with batch.item(PATH):
        pass
    refuse(batch, StoreError("is known"))
    said = capsys.readouterr().err.splitlines()
    assert said == [
        "rossec: error: a.csr: is known",
        "rossec: hint: see there",
        "rossec: error: a.csr: is known",
    ]
    with pytest.raises(ConfigurationError, match="2 of 3 were refused"):
        batch.finish()


def test_a_batch_without_refusals_finishes() -> None:
    batch = Batch(2)
    with batch.item(PATH):
        pass
    batch.finish()


@pytest.mark.parametrize(("total", "error"), [(1, StoreError("x")), (5, RecordUnusable("full"))])
def test_a_single_refusal_or_an_unusable_record_is_raised(total: int, error: Exception) -> None:
    with pytest.raises(type(error)):
        refuse(Batch(total), error)


def test_it_says_whether_anything_was_done() -> None:
    batch = Batch(2)
    refuse(batch, StoreError("x"))
    assert batch.done
    refuse(batch, StoreError("x"))
    assert not batch.done


def test_a_name_that_is_given_twice_counts_once() -> None:
    assert unique(["/b", "/a", "/b"]) == ("/b", "/a")
