"""`rossec node request | code | install | show`: a node's key, its request, its identity."""

from pathlib import Path

import click

from ca.certificates import Identity
from ca.enrollment import qr
from rossec import files
from rossec.authority.home import fingerprint, format_fingerprint
from rossec.cli.shared.context import Environment, confirm, now, pass_environment
from rossec.clock import format_time
from rossec.home import NodeHome
from rossec.terminal import say, say_json

_MAX_BUNDLE = 64 * 1024


@click.command()
@click.argument("name")
@click.option("--domain", default="home", show_default=True, help="trust domain of the authority")
@click.option("--anonymous", is_flag=True, help="for anonymous nodes too: /rviz also as /rviz_17")
@pass_environment
def request(environment: Environment, name: str, domain: str, anonymous: bool) -> None:
    """Make the key of the node NAME and a request for its identity. The key stays here."""
    home = NodeHome.of(environment.home, name)
    made = home.create_request(domain, wildcard=anonymous)
    say(f"request of {name}: {home.request_path}")
    say(f"fingerprint {format_fingerprint(made.thumbprint)}")
    option = " --anonymous" if anonymous else ""
    say(f"next, at the authority: rossec ca sign {home.request_path}{option}")


@click.command()
@click.argument("name")
@click.option("--text", is_flag=True, help="only the text in the code, to paste")
@click.option("--svg", type=click.Path(path_type=Path), help="write the code to this SVG file")
@click.option("--png", type=click.Path(path_type=Path), help="write the code to this PNG file")
@pass_environment
def code(
    environment: Environment, name: str, text: bool, svg: Path | None, png: Path | None
) -> None:
    """Show the QR code of NAME's request, for the authority to scan."""
    payload = qr.label_code(NodeHome.of(environment.home, name).request())
    if svg is not None:
        files.replace(svg, qr.svg(payload), 0o644)
    if png is not None:
        files.replace(png, qr.png(payload), 0o644)
    if not text:
        say(qr.terminal(payload))
    say(payload)


@click.command()
@click.argument("bundle", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--yes", is_flag=True, help="do not ask")
@pass_environment
def install(environment: Environment, bundle: Path, yes: bool) -> None:
    """Install the signed identity in BUNDLE, and trust the authority that signed it."""
    with bundle.open("rb") as stream:
        data = stream.read(_MAX_BUNDLE)
    home, anchor = NodeHome.for_bundle(environment.home, data, now())
    say(f"authority of {anchor.domain}, fingerprint {fingerprint(anchor)}")
    confirm("does the authority show the same fingerprint (rossec ca show)?", yes=yes)
    home.install(data, now())
    say(f"{home.name} is enrolled in {anchor.domain}")


@click.command()
@click.argument("name")
@click.option("--json", "as_json", is_flag=True, help="a line of JSON")
@pass_environment
def show(environment: Environment, name: str, as_json: bool) -> None:
    """Show the identity of NAME and how many grants it holds."""
    home = NodeHome.of(environment.home, name)
    identity = home.identity(now())
    if as_json:
        say_json(_shown(home, identity))
        return
    say(f"{identity.name} of {identity.domain} until {format_time(identity.not_after)}")
    if identity.wildcard:
        say(f"also for anonymous nodes, {identity.name}_*")
    say(f"fingerprint {format_fingerprint(identity.thumbprint)}")
    count = len(home.grants())
    say(f"{count} {'grant' if count == 1 else 'grants'} in {home.path}")


def _shown(home: NodeHome, identity: Identity) -> dict[str, object]:
    return {
        "name": identity.name,
        "domain": identity.domain,
        "anonymous": identity.wildcard,
        "not_before": identity.not_before,
        "not_after": identity.not_after,
        "key": identity.thumbprint.hex(),
        "grants": len(home.grants()),
        "path": str(home.path),
    }
