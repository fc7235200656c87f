"""`python -m tests.fuzz DECODER [RUNS]`: coverage-guided fuzzing of one decoder with atheris."""

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["ca", "rossec"]):
    from tests.fuzz.decoders import DECODERS, run


def main() -> None:
    """Write the seeds to a corpus, then fuzz; a finding ends the process with an error."""
    name, runs = sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else "-1"
    seeds = DECODERS[name][1]()
    assert len(seeds) > 0, "no seeds: the fuzzer would begin from nothing"
    with tempfile.TemporaryDirectory() as folder:
        for number, seed in enumerate(seeds):
            (Path(folder) / f"{number:03}").write_bytes(seed)
        atheris.Setup([sys.argv[0], f"-runs={runs}", "-seed=1", folder], lambda data: run(name, data))
        atheris.Fuzz()


if __name__ == "__main__":
    main()
