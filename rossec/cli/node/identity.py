"""`rossec node request | code | install | show`: a node's key, its request, its identity."""

from pathlib import Path

import click

from ca.certificates import TrustAnchor
from ca.enrollment import qr
from rossec import clock, files
from rossec.authority.home import fingerprint, format_fingerprint
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, confirm, now, pass_environment
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.terminal import record, say, say_picture

_MAX_BUNDLE = 64 * 1024


@click.command()
@click.argument("names", metavar="[NAME]...", nargs=-1)
@options.domain
@options.flag("--anonymous", "for anonymous nodes too: /rviz also as /rviz_17")
@options.option(
    "--meta=FILE meta_path",
    "take the name that rules give for the metadata there, instead of NAME",
    type=options.FILE,
)
@options.rules
@options.json_result(pass_environment)
def request(
    environment: Environment,
    names: tuple[str, ...],
    domain: str,
    anonymous: bool,
    meta_path: Path | None,
    rules_path: Path | None,
) -> None:
    """Make the key of the node NAME and a request for its identity. The key stays here.

    Where one of several is refused the others are made, and the exit code is 1.
    """
    chosen, made = _names(names, meta_path, rules_path), list[Path]()
    batch = options.Batch(len(chosen), "name")
    for name in chosen:
        with batch.item(name):
            home = NodeHome.of(environment.home, name)
            asked = home.create_request(domain, wildcard=anonymous)
            record(file=str(home.request_path), key=asked.thumbprint.hex())
            say(f"request of {home.name}: {home.request_path}")
            say(f"fingerprint {format_fingerprint(asked.thumbprint)}")
            made.append(home.request_path)
    if made:
        listed, more = " ".join(map(str, made)), " --anonymous" if anonymous else ""
        say(f"next, at the authority: rossec ca sign {listed}{more}")
    batch.finish()


def _names(given: tuple[str, ...], meta_path: Path | None, rules_path: Path | None) -> tuple[str, ...]:
    if bool(given) is (meta_path is not None):
        raise click.UsageError("give NAME, or --meta FILE")
    if meta_path is not None:
        from rossec.cli.shared import rules  # noqa: PLC0415 - it starts a process; few give metadata

        found = rules.read_metadata(meta_path)
        return (rules.name_of_node(rules.read_rules(rules_path), found),)
    if rules_path is not None:
        raise click.UsageError("--rules are for --meta FILE")
    return options.unique(given)


@click.command()
@click.argument("name")
@options.flag("--text", "only the text in the code, to paste")
@options.option("--svg", "write the code to this SVG file", type=options.PATH)
@options.option("--png", "write the code to this PNG file", type=options.PATH)
@options.json_result(pass_environment)
def code(environment: Environment, name: str, text: bool, svg: Path | None, png: Path | None) -> None:
    """Show the QR code of NAME's request, for the authority to scan."""
    payload = qr.label_code(NodeHome.of(environment.home, name).request())
    record(name=name, code=payload)
    if svg is not None:
        files.replace(svg, qr.svg(payload), 0o644)
    if png is not None:
        files.replace(png, qr.png(payload), 0o644)
    if not text:
        say_picture(qr.terminal(payload))
    say(payload)


@click.command()
@click.argument("bundles", metavar="BUNDLE...", nargs=-1, required=True, type=options.FILE)
@options.yes
@options.json_result(pass_environment)
def install(environment: Environment, bundles: tuple[Path, ...], yes: bool) -> None:
    """Install the signed identity in BUNDLE, and trust the authority that signed it.

    Asks once for each authority. Where one of several is refused the others are installed, and the
    exit code is 1.
    """
    batch = options.Batch(len(bundles))
    read: dict[bytes, tuple[TrustAnchor, list[Path]]] = {}
    for bundle in bundles:
        with batch.item(bundle, last=False):
            _, anchor = NodeHome.for_bundle(environment.home, _read(bundle), now())
            read.setdefault(anchor.thumbprint, (anchor, []))[1].append(bundle)
    for anchor, found in read.values():
        say(f"authority of {anchor.domain}, fingerprint {fingerprint(anchor)}")
        confirm("does the authority show the same fingerprint (rossec ca show)?", yes=yes)
        for bundle in found:
            with batch.item(bundle):
                data = _read(bundle)
                # Between question and answer the file may have been exchanged.
                home, now_in_it = NodeHome.for_bundle(environment.home, data, now())
                if now_in_it.thumbprint != anchor.thumbprint:
                    raise ConfigurationError("the file has changed meanwhile", "copy it here again")
                home.install(data, now())
                say(f"{home.name} is enrolled in {anchor.domain}", name=home.name, domain=anchor.domain)
    batch.finish()


def _read(bundle: Path) -> bytes:
    with bundle.open("rb") as stream:
        return stream.read(_MAX_BUNDLE)


@click.command()
@click.argument("name")
@options.flag("--json as_json", "a line of JSON")
@pass_environment
def show(environment: Environment, name: str, as_json: bool) -> None:
    """Show the identity of NAME and how many grants it holds."""
    home = NodeHome.of(environment.home, name)
    identity = home.identity(now())
    count, end = len(home.grants()), identity.not_after
    document = {
        "name": identity.name,
        "domain": identity.domain,
        "anonymous": identity.wildcard,
        "not_before": identity.not_before,
        "not_after": end,
        "key": identity.thumbprint.hex(),
        "grants": count,
        "path": str(home.path),
    }
    lines = [
        f"{identity.name} of {identity.domain} until {clock.format_time(end)}",
        *([f"also for anonymous nodes, {identity.name}_*"] if identity.wildcard else []),
        f"fingerprint {format_fingerprint(identity.thumbprint)}",
        f"{count} {'grant' if count == 1 else 'grants'} in {home.path}",
    ]
    options.say_result(as_json, document, lines)
