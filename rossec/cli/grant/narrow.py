"""`rossec grant narrow`: a node hands a right of its own on to another node of its domain.

Signed with the node's own key, in its home. Nothing is recorded at an authority: the chain is a
file for the other node, and ends with each of its links.
"""

import secrets
from pathlib import Path
from typing import Any, Final

import click

from ca.certificates import Identity, from_pem
from ca.names import check_name
from grants.errors import GrantMalformed, GrantNotHeld, NarrowingNotAllowed
from grants.model import Draft, Grant
from grants.narrowing import sign_narrowing
from grants.token import pack_chain, peek
from grants.validity import check_time
from rossec import files
from rossec.authority.list_contents import SKEW
from rossec.cli.grant import permission_options
from rossec.cli.grant.sign import check_new
from rossec.cli.shared import options
from rossec.cli.shared.context import Duration, Environment, now, pass_environment
from rossec.cli.shared.results import json_result
from rossec.cli.shared.tokens import read_token
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.participant.token_opening import MAX_PRESENTED
from rossec.terminal import printable, record, say

MAX_DAYS: Final = 365
_OVERHEAD: Final = 16  # of the array it is presented in


@click.command()
@click.argument("file", type=options.FILE)
@click.option("--as", "own", required=True, metavar="NODE", help="the node that holds the grant")
@click.option(
    "--to", "certificate", required=True, type=options.FILE, metavar="CERTIFICATE",
    help="the certificate of the node that gets the right: its node.pem",
)  # fmt: skip
@permission_options.wishes
@click.option(
    "--for", "lifetime", type=Duration(MAX_DAYS), default="8h", show_default=True,
    help="how long it holds; never longer than the grant in FILE",
)  # fmt: skip
@click.option(
    "--may-narrow", type=click.IntRange(0), default=0, metavar="N",
    help="how often the other node may hand it on in its turn",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="write the token to this new file"
)
@json_result()
@pass_environment
def narrow(
    environment: Environment,
    /,
    file: Path,
    own: str,
    certificate: Path,
    lifetime: int,
    may_narrow: int,
    out: Path,
    **wishes: Any,
) -> None:
    """Hand the grant in FILE on to another node of this domain, restricted further.

    What FILE does not allow stays refused, whatever is given here: each link is judged alone, and
    all restrictions hold. The other node takes the token with: rossec grant install.
    """
    check_new(out)
    home, at = NodeHome.find(environment.home, check_name(own)), now()
    token, receiver = read_token(file), _receiver(home, certificate, at)
    held = peek(token)
    _check_held(home, held, may_narrow, at)
    end = min(at + lifetime, held.expires)
    draft = Draft(
        domain=held.domain, subject=receiver.name, holder=receiver.thumbprint,
        not_before=max(at - SKEW, held.not_before), expires=end, cap=end,
        serial=secrets.token_bytes(16), permissions=permission_options.read(wishes),
        may_narrow=may_narrow,
    )  # fmt: skip
    _check_useful(draft, held)
    packed = pack_chain(token, [sign_narrowing(home.signer(), draft, held)])
    if len(packed) > MAX_PRESENTED - _OVERHEAD:
        raise GrantMalformed(
            f"the chain has {len(packed)} bytes, more than a node may present",
            "fewer rights in one grant",
        )
    files.create(out, packed, 0o644)
    record(id=peek(packed).id.hex(), node=receiver.name, expires=end, file=str(out))
    say(f"grant {peek(packed).id.hex()} for {receiver.name} until {format_time(end)}")
    say(f"written to {out}; on the machine of {receiver.name}: rossec grant install {out.name}")


def _receiver(home: NodeHome, path: Path, at: int) -> Identity:
    """The node of the own domain that a file with its certificate names."""
    pem = files.read(path, options.MAX_PEM, ConfigurationError(f"there is no file {path}", ""))
    anchor = home.anchor()
    chain = [each for each in from_pem(pem) if each != anchor.certificate]
    return anchor.verify(chain, at)


def _check_held(home: NodeHome, held: Grant, may_narrow: int, at: int) -> None:
    if held.holder != home.identity(at).thumbprint:
        raise GrantNotHeld(
            printable(f"grant {held.short_id} is not held by {home.name}"),
            printable(f"it is for {held.subject}"),
        )
    check_time(held, at)
    if held.may_narrow <= may_narrow:
        raise NarrowingNotAllowed(
            f"grant {held.short_id} allows {held.may_narrow} narrowings after it",
            "fewer with --may-narrow"
            if held.may_narrow
            else "at the authority: rossec grant sign NODE --may-narrow N",
        )


def _check_useful(draft: Draft, held: Grant) -> None:
    """A right on one name that FILE does not give is a mistake; of patterns nobody can say."""
    for permission in draft.permissions:
        if "*" in permission.pattern:
            continue
        for right in permission.rights:
            if not held.covers(right, permission.pattern):
                raise ConfigurationError(
                    f"the grant gives no {right.label} on {permission.pattern}",
                    "see: rossec grant show FILE",
                )
