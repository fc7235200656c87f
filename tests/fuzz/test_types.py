"""Each decoder of CBOR, and a value of every other type in every place: our error, or success."""

from contextlib import suppress

import pytest

from ca.errors import HintedError
from tests.fuzz.mutants import dumps, mutants
from tests.fuzz.statements import DECODERS


@pytest.mark.parametrize("name", DECODERS)
def test_valid_structures_are_decoded(name: str) -> None:
    """Else the changed ones would be refused for another reason."""
    seeds, target = DECODERS[name]
    for seed in seeds:
        target(dumps(seed))


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", DECODERS)
def test_every_type_in_every_place(name: str) -> None:
    seeds, target = DECODERS[name]
    for seed in seeds:
        for changed in mutants(seed):
            data = dumps(changed)
            try:
                with suppress(HintedError):
                    target(data)
            except Exception as error:
                raise AssertionError(f"{name}: {data[:400].hex()}") from error
