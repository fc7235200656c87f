"""Deliver a grant to its node, if that node is on this host."""

from pathlib import Path

from grants import document
from rossec import files
from rossec.cli.shared.context import Environment
from rossec.home import NodeHome
from rossec.terminal import note, say


def deliver_grant(environment: Environment, node: str, data: bytes, out: Path | None) -> None:
    """Store a grant in its node's directory if that is on this host, and in the file `out`."""
    if out is not None:
        files.create(out, data, 0o644)
        say(f"written to {out}")
    home = NodeHome.of(environment.home, node)
    if home.path.is_dir():
        home.add_grant(document.grant_id(data), data)
        say(f"given to {node} in {home.path}")
    elif out is None:
        note(
            f"{node} is on another host:"
            " sign with --out FILE, then `rossec grant install FILE` there"
        )
