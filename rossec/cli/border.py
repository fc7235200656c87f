"""`rossec border`: run a border router until it is stopped; its things."""

from pathlib import Path
from typing import Final

import click

from ca import things
from ca.enrollment import qr
from ca.errors import ThingRefused
from ca.svid import check_request
from rossec import clock, files
from rossec.authority.home import format_fingerprint
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import with_master
from rossec.cli.shared.options import FILE, NEW_FILE, Batch, flag, json_result, option, unique
from rossec.clock import format_time
from rossec.errors import ConfigurationError, NotWritten
from rossec.home import NodeHome
from rossec.host.local_sockets import process_lock
from rossec.saved_statements import ThingFiles
from rossec.terminal import fail, note, printable, record, say, say_json, say_picture, say_secret

BORDER: Final = "/border"
_MAX_CREDENTIAL: Final = 4096
_MAX_BUNDLE: Final = 64 * 1024
as_border = option("--as=NAME router", "the border router", default=BORDER, show_default=True)
as_json_option = flag("--json as_json", "a line of JSON")


@click.command()
@click.argument("name")
@option("--key ccs", "the thing's credential: a CCS, as CBOR", type=FILE)
@flag("--psk", "it has no curves: make a secret for it")
@option("--secret-out", "write the secret for the thing to this new file, and do not show it", type=NEW_FILE)
@as_border
@json_result(pass_environment, secret=True)
def add(
    environment: Environment, name: str, ccs: Path | None, psk: bool, secret_out: Path | None, router: str
) -> None:
    """Prepare the thing NAME: the request of its node, and its secret if it has one.

    The keys of the thing's node and its secret stay here; the secret is shown once, for the thing.
    """
    if (ccs is None) is not psk:
        raise ConfigurationError("a thing has a key or a secret", "give --key FILE or --psk")
    if secret_out is not None and not psk:
        raise ConfigurationError("a thing with a key has no secret here", "leave --secret-out out")
    home = NodeHome.of(environment.home, router)
    domain = home.identity(now()).domain
    things.check_thing_name(name)
    if ccs is not None:
        found = things.read_ccs(files.read(ccs, _MAX_CREDENTIAL))
        say(f"key of {name}: fingerprint {format_fingerprint(found.thumbprint)}")
        option = f"--key {ccs}"
    else:
        option = f"--psk {_secret(ThingFiles(home), name, secret_out)}"
    node = NodeHome.of(environment.home, name)
    csr = node.label_request(domain)
    say(f"request of {name}: {node.request_path}", name=name, file=str(node.request_path))
    say(f"fingerprint {format_fingerprint(check_request(csr, domain).thumbprint)}")
    request = f"--request {node.request_path}"
    say(f"next, at the authority: rossec ca thing {name} --border {router} {option} {request}")


def _secret(router_files: ThingFiles, name: str, out: Path | None) -> Path:
    # Make a secret, give it to its owner, and return the file that describes it.
    if out is not None and out.exists():
        raise ConfigurationError(f"{out} exists and is not overwritten", "name a new file")
    if out is not None and not out.parent.is_dir():  # before a secret is made that nobody gets
        raise ConfigurationError(f"there is no directory {out.parent}", "make it first")
    # Made here, where it is used: the authority and its record know a thumbprint (attack `thing-secret`).
    secret = router_files.create_secret(name)
    known = things.ThingSecret.of(secret, router_files.free_kid())
    text = things.secret_text(known.kid, secret)
    described = router_files.describe_secret(name, known)
    if out is not None:
        files.create(out, f"{text}\n".encode())
        say(f"secret of {name}: {out}", secret_file=str(out))
    else:
        note("whoever sees this can speak as the thing; it is not shown again")
        record(secret=text)
        say_picture(qr.terminal(text), is_secret=True)
        say_secret(text)
    return described


@click.command()
@click.argument("statement", type=FILE)
@click.argument("bundle", type=FILE, required=False)
@as_border
@json_result(pass_environment)
def install(environment: Environment, statement: Path, bundle: Path | None, router: str) -> None:
    """Install what the authority signed about a thing: STATEMENT, and the identity in BUNDLE.

    A border router that runs takes it at once.
    """
    home = NodeHome.of(environment.home, router)
    home.identity(now())
    if bundle is not None:
        pem = files.read(bundle, _MAX_BUNDLE)
        node, anchor = NodeHome.for_bundle(environment.home, pem, now())
        # A thing's node of another authority would be refused by every peer of this site.
        if anchor.thumbprint != home.anchor().thumbprint:
            raise ConfigurationError(
                f"{bundle} is of another authority than that of {router}", "take the right file"
            )
        node.install(pem, now())
        say(f"{node.name} is enrolled in {anchor.domain}", identity=node.name, domain=anchor.domain)
    found = ThingFiles(home).install(files.read(statement, things.MAX_STATEMENT))
    say(f"{found.name} is served until {format_time(found.expires)}", name=found.name, expires=found.expires)
    if not (NodeHome.of(environment.home, found.name).path / "node.pem").exists():
        note(f"the node {found.name} has no identity here yet: rossec node install FILE")


@click.command()
@click.argument("file", type=NEW_FILE)
@as_border
@json_result(pass_environment)
def credential(environment: Environment, file: Path, router: str) -> None:
    """Write the router's credential for its things to FILE: they know it by this key.

    It is a CCS (RFC 9528), as CBOR, and no secret; but a thing that is given another one serves
    another router.
    """
    try:
        from rossec.border.handshakes import StaticKey  # noqa: PLC0415 - an extra
    except ImportError:
        raise ConfigurationError(
            "EDHOC for things is not installed", "pip install 'rossec[constrained]'"
        ) from None
    home = NodeHome.of(environment.home, router)
    home.identity(now())
    found = StaticKey(ThingFiles(home).router_key()).credential
    files.replace(file, found.ccs, 0o644)
    record(name=router, key=found.thumbprint.hex(), file=str(file))
    say(f"credential of {router}: fingerprint {format_fingerprint(found.thumbprint)}: {file}")


@click.command()
@click.argument("credentials", nargs=-1, required=True, type=FILE)
@option("--out", "HTML file to print", type=NEW_FILE, required=True)
@json_result()
def labels(credentials: tuple[Path, ...], out: Path) -> None:
    """Write a sheet of labels for the things with these CREDENTIALS, 24 to a page.

    A credential is a CCS, or what `rossec border add NAME --psk` wrote about a secret. A label
    holds no secret: its code names the credential, for `rossec ca thing NAME --code CODE`.
    """
    made = []
    for path in credentials:
        data = files.read(path, _MAX_CREDENTIAL)
        try:
            found: things.Credential = things.read_description(data)
        except ThingRefused:
            found = things.read_ccs(data)
        name = (found.subject if isinstance(found, things.ThingKey) else "") or path.stem
        made.append(qr.Label(printable(name), format_fingerprint(found.thumbprint), qr.label_code(data)))
    files.replace(out, qr.sheet(made).encode(), 0o644)
    record(names=[each.name for each in made], file=str(out))
    say(f"{len(made)} label{'s' * (len(made) != 1)} in {out}: print it without scaling")


@click.command("list")
@as_border
@as_json_option
@pass_environment
def list_(environment: Environment, router: str, *, as_json: bool) -> None:
    """List the things that this border router serves."""
    loaded = ThingFiles(_home(environment, router)).load()
    found = sorted(loaded.statements.values(), key=lambda each: each.name)
    if as_json:
        rows = [
            {"name": each.name, "kind": each.kind, "kid": each.credential.kid.hex(), "expires": each.expires}
            for each in found
        ]
        say_json({"things": rows})
        return
    for each in found:
        kind = "key" if isinstance(each.credential, things.ThingKey) else "secret"
        ends = "expired" if each.expires <= now() else f"until {format_time(each.expires)}"
        say(f"{each.name}  {kind} {each.credential.kid.hex()}  {ends}")
    for path, error in loaded.refused.items():
        fail(f"{path.name}: {error}", error.hint)
    if not found:
        note("there are no things here: rossec border add NAME --key FILE")


def _home(environment: Environment, router: str) -> NodeHome:
    home = NodeHome.of(environment.home, router)
    home.anchor()
    return home


@click.command("status")
@as_border
@as_json_option
@pass_environment
def status_(environment: Environment, router: str, *, as_json: bool) -> None:
    """Say what the border router that runs does: which things are there, what they offer."""
    try:
        from rossec.border import border_router as status  # noqa: PLC0415 - an extra
    except ImportError:
        raise needs_extra() from None
    found = status.read_status(_home(environment, router).path, now())
    if as_json:
        say_json(found)
        return
    host, port = found["address"]
    counts = found["counts"]
    say(
        f"at {host} port {port}: {counts['handshakes'] + counts['derivations']} times a thing"
        f" came, {counts['refused']} of {counts['datagrams']} datagrams refused"
    )
    for name, thing in sorted(found["things"].items()):
        there = "there" if thing["there"] else "not there"
        if "resources" not in thing:
            say(f"{name}  {'is there, starting' if thing['there'] else there}")
            continue
        say(
            f"{name}  {there}, offers {thing['offered']} of {thing['resources']},"
            f" {thing['received']} messages, {thing['refused'] + thing['over_rate']} dropped"
        )


def needs_extra() -> ConfigurationError:
    return ConfigurationError("CoAP for things is not installed", "pip install 'rossec[constrained]'")


@click.command()
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@as_border
@json_result(pass_environment)
def forget(environment: Environment, names: tuple[str, ...], router: str) -> None:
    """Forget the thing NAME: its statement and its secret are removed here.

    A border router that runs ends it within a second. The statement stays valid until the authority
    revokes it: rossec ca revoke --thing NAME
    """
    home, names = _home(environment, router), unique(names)
    batch = Batch(len(names), "name")
    for name in names:
        with batch.item(name):
            if not ThingFiles(home).forget(name):
                raise ConfigurationError(f"there is nothing about {name} here", "see: rossec border list")
            say(f"{name} is not served here any more")
            note(f"if it is lost, at the authority: rossec ca revoke --thing {name}")
    batch.finish()


def run(environment: Environment, name: str, host: str, port: int, *, as_json: bool) -> None:
    """Run the border router `name`, which listens for things at `host` and `port`, until a signal ends it."""
    import asyncio  # noqa: PLC0415 - the other verbs have no loop

    from rossec.host.runner import stop_on_signals, until_stopped  # noqa: PLC0415 - likewise
    from rossec.master.operation import raise_descriptor_limit  # noqa: PLC0415 - likewise

    try:
        from rossec.border import border_router  # noqa: PLC0415 - an extra
        from rossec.border.handshakes import StaticKey  # noqa: PLC0415 - likewise
    except ImportError as error:
        raise needs_extra() from error
    home = NodeHome.of(environment.home, name)
    home.identity(now())

    async def serve() -> None:
        stop = stop_on_signals()
        key = StaticKey(ThingFiles(home).router_key())
        router = border_router.BorderRouter(home.name, key, await with_master(environment, home), host, port)

        async def write_status() -> None:
            while True:
                try:
                    status = border_router.describe_status(router, clock.now())
                    border_router.write_status(home.path, status)
                except NotWritten as error:  # a full disk ends no thing
                    note(str(error))
                await asyncio.sleep(border_router.STATUS_PERIOD)

        try:
            await router.start()
            address, count = router.server.address, len(router.roster)
            if as_json:
                say_json({"ready": list(address), "things": count})
            else:
                say(f"border router {home.name} at {address[0]} port {address[1]} (UDP), {count} things")
                if not count:
                    note("add things: rossec border add NAME --key FILE")
            await until_stopped(stop, environment.variables, router.wait_ended(), write_status())
        finally:
            await router.close()
            (home.path / border_router.STATUS_FILE).unlink(missing_ok=True)

    busy = ConfigurationError(f"{name} runs already", "see: rossec border status")
    with process_lock(home.path / "border.lock", busy):
        raise_descriptor_limit()
        asyncio.run(serve())
