"""`rossec border labels`: a sheet of labels, whose codes name what things prove themselves by."""

from pathlib import Path
from typing import Final

import click

from ca.enrollment import qr
from ca.enrollment.labels import Label, sheet
from ca.errors import ThingRefused
from ca.things.credentials import Credential, ThingKey, read_ccs, read_description
from rossec import files
from rossec.authority.home import format_fingerprint
from rossec.cli.shared import options
from rossec.cli.shared.results import json_result
from rossec.terminal import printable, record, say

_MAX_CREDENTIAL: Final = 4096


@click.command()
@click.argument("credentials", nargs=-1, required=True, type=options.FILE)
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), required=True,
    help="HTML file to print",
)  # fmt: skip
@json_result()
def labels(credentials: tuple[Path, ...], out: Path) -> None:
    """Write a sheet of labels for the things with these CREDENTIALS, 24 to a page.

    A credential is a CCS, or what `rossec border add NAME --psk` wrote about a secret. A label
    holds no secret: its code names the credential, for `rossec ca thing NAME --code CODE`.
    """
    made = [_label(path, files.read(path, _MAX_CREDENTIAL)) for path in credentials]
    files.replace(out, sheet(made).encode(), 0o644)
    record(names=[each.name for each in made], file=str(out))
    say(f"{len(made)} label{'s' * (len(made) != 1)} in {out}: print it without scaling")


def _label(path: Path, data: bytes) -> Label:
    found = _read(data)
    name = (found.subject if isinstance(found, ThingKey) else "") or path.stem
    return Label(printable(name), format_fingerprint(found.thumbprint), qr.label_code(data))


def _read(data: bytes) -> Credential:
    try:
        return read_description(data)
    except ThingRefused:
        return read_ccs(data)
