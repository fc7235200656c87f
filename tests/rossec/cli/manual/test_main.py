import subprocess
import sys
from pathlib import Path


def test_the_pages_are_written(tmp_path: Path) -> None:
    command = [sys.executable, "-I", "-m", "rossec.cli.manual", str(tmp_path)]
    done = subprocess.run(command, text=True, capture_output=True, check=True)
    assert done.stdout.endswith(f"pages in {tmp_path / 'man1'}\n")
    assert (tmp_path / "man1" / "rossec-ca.1").read_text().startswith('.TH "ROSSEC')
