"""`rossec policy import-sros2`: an SROS2 policy as one of rossec."""

from pathlib import Path

import click

from grants.errors import PolicyRefused
from grants.policy.sros2 import MAX_SIZE, described, import_sros2
from rossec import files
from rossec.authority.policyfile import parse_policy
from rossec.terminal import note, say, say_block

_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)


@click.command("import-sros2")
@click.argument("xml", type=_FILE)
@click.option("--out", type=click.Path(path_type=Path), help="write the policy to this new file")
def import_(xml: Path, out: Path | None) -> None:
    """Turn the SROS2 policy in XML into one of rossec.

    What it allows and does not fit is left out, and said; what it denies is kept, or it is refused.
    """
    data = files.read(xml, 4 * MAX_SIZE)
    try:
        text, notes = import_sros2(data.decode(errors="replace"))
    except PolicyRefused as error:
        for mistake in error.mistakes:
            note(str(mistake))
        raise
    parse_policy(text, str(xml))
    for line in notes:
        note(described(line))
    if out is None:
        say_block(text.rstrip())
        return
    files.create(out, text.encode(), 0o644)
    say(f"written to {out}")
