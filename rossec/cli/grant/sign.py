"""`rossec grant sign | presets | narrow`: what nodes may do, and their options as permissions.

A grant is narrowed with the node's own key, in its home. Nothing is recorded at an authority: the
chain is a file for another node, and ends with each of its links.
"""

import contextlib
import itertools
import secrets
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import click

from ca.certificates import Identity, from_pem
from ca.errors import PatternRefused
from ca.names import check_name, is_alias, local_name
from grants import document
from grants.conditions import compile_condition
from grants.errors import ConditionRefused, FilterRefused, GrantMalformed, GrantNotHeld, GrantTooWide
from grants.filters.compile import PRESETS, compile_filter, preset
from grants.filters.layout import parse
from grants.model import MAX_NARROWINGS, Draft, Permission, Restriction, Right, check_time, filter_rules
from grants.policy.names import NODE, check_rule_pattern, resolve
from grants.token import pack_chain, peek, sign_narrowing
from rossec import clock, files
from rossec.authority.grant_operations import require_delivered
from rossec.authority.service import AuthorityService
from rossec.authority.signing import CLOCK_SKEW
from rossec.cli.shared import options
from rossec.cli.shared.context import Duration, Environment, now, pass_environment
from rossec.cli.shared.master import read_token
from rossec.cli.shared.options import FILE, PATH, duration, flag, json_result, option
from rossec.cli.shared.service import deliver_grant, pass_service, remind_to_publish
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.participant.access import MAX_PRESENTED
from rossec.participant.service_types import part_type
from rossec.terminal import printable, record, say

_EXAMPLES: Final = (
    "for example --clear header.frame_id, --round pose.position=2.0, --when 'msg.header.frame_id == \"map\"'"
)
_RIGHTS: Final = {
    Right.PUBLISH: "may publish these topics",
    Right.SUBSCRIBE: "may subscribe to these topics",
    Right.CALL: "may call these services",
    Right.PROVIDE: "may provide these services",
    Right.PARAM_GET: "may read these parameters and all below",
    Right.PARAM_SET: "may set these parameters and all below",
    Right.ADMIN: "may end these nodes and clean up after them",
}
MAX_DAYS: Final = 3650  # an authority's own certificate does not last longer


def _once(_context: click.Context, _parameter: click.Parameter, given: tuple[Any, ...]) -> Any:
    # The value of an option that is given once: of two click would lose the first.
    if len(given) > 1:
        raise click.BadParameter("given more than once, and one would be lost")
    return given[0] if given else None


_RESTRICTING: Final = (
    flag("--graph", "may see the whole ROS graph"),
    option("--type=PKG/TYPE type_name", "message type of the restrictions", multiple=True, callback=_once),
    option("--clear=FIELD", "clear this field", multiple=True),
    option("--round=FIELD=STEP rounds", "round this field", multiple=True),
    option("--clamp=FIELD=LOW:HIGH clamps", "keep this field in a range", multiple=True),
    option("--rate=HZ", "at most so many messages a second", type=float, multiple=True, callback=_once),
    option(
        "--preset preset_name",
        "restrictions for a usual wish; see `rossec grant presets`",
        type=click.Choice(list(PRESETS)),
        multiple=True,
        callback=_once,
    ),
    option("--when=CONDITION", "only messages and times for which this holds", multiple=True),
)


def right_options(texts: dict[str, str], metavar: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """An option for each right, by its label."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for label, text in reversed(texts.items()):
            command = option(f"--{label}", text, multiple=True, metavar=metavar)(command)
        return command

    return decorate


def permission_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add every option for rights and their restrictions; `read_permissions` takes what they say."""
    for add in reversed(_RESTRICTING):
        command = add(command)
    return right_options({right.label: text for right, text in _RIGHTS.items()}, "PATTERN")(command)


@click.command()
@click.argument("node")
@permission_options
@duration("--for lifetime", "how long it holds", days=MAX_DAYS, default="7d")
@option(
    "--renew-until=DURATION renewal",
    "how long the master may renew it; see: rossec master delegate",
    type=Duration(MAX_DAYS),
    default=0,
)
@option(
    "--may-narrow=N",
    "how often it may be handed on, restricted further; see: rossec grant narrow",
    type=click.IntRange(0, MAX_NARROWINGS),
    default=0,
)
@option(
    "--certificate", "the certificate of a node of another domain: its node.pem, without its key", type=FILE
)
@option("--out", "also write the grant to this new file", type=PATH)
@options.master_uri
@json_result(pass_service)
def sign(
    service: AuthorityService,
    /,
    node: str,
    lifetime: int,
    renewal: int,
    out: Path | None,
    may_narrow: int,
    certificate: Path | None,
    **said: Any,
) -> None:
    """Let NODE publish, subscribe, call and so on, under conditions and through filters.

    The node gets the grant from the master, or from its directory if that is in this ROSSEC_HOME.
    PATTERN is a name; * stands for one segment, ** for any depth, '{node}' for NODE's own name.

    NODE may be one of another domain, as hospital:/rounds/robot3: its key is that of CERTIFICATE,
    verified below that domain's listed root, and the grant is a file that somebody carries there.
    """
    name = check_name(local_name(node))
    foreign = is_alias(name)
    if not foreign:
        if certificate is not None:
            raise ConfigurationError(
                f"{node} is a node of this domain, whose key is in the record",
                "--certificate is for nodes of other domains: LABEL:/NAME",
            )
    elif renewal:
        raise ConfigurationError(
            "a grant for another domain is not renewed: its nodes ask another master",
            "give the whole time: --for",
        )
    elif out is None:
        raise ConfigurationError(
            f"no master of this domain delivers to {node}", "give --out FILE, and carry it there"
        )
    if out is not None:
        check_new(out)

    def has_suffix() -> bool:
        with contextlib.closing(service.home.store()) as store:
            return not is_alias(name) and store.valid_certificate(name, now()).wildcard

    wanted = for_node(said, name, has_suffix)
    permissions = read_permissions(wanted)
    pem = b"" if certificate is None else files.read(certificate, options.MAX_PEM)
    draft, data = service.grants.sign(name, permissions, lifetime, renewal, may_narrow, pem)
    record(id=document.grant_id(data).hex(), node=name, expires=draft.expires)
    say(f"grant {document.grant_id(data).hex()} for {node} until {clock.format_time(draft.expires)}")
    refused = deliver_grant(service, data, out)
    remind_to_publish(service)
    require_delivered(refused)


def check_new(out: Path) -> None:
    """Before anything is signed: a grant that cannot be written would exist nevertheless."""
    if out.exists() or out.is_symlink():
        raise ConfigurationError(f"{out} exists and is not overwritten", "give a new file")
    if not out.parent.is_dir():
        raise ConfigurationError(f"there is no directory {out.parent}", "make it first")


def for_node(said: Mapping[str, Any], node: str, has_suffix: Callable[[], bool]) -> dict[str, Any]:
    """What `permission_options` say, with own names as those of `node`.

    Only if there are own names it is asked whether the node `has_suffix`: one for anonymous nodes.
    """
    named = patterns_by_right(said)
    if not any(is_own_text(each) for each in itertools.chain(*named.values())):
        return dict(said)
    suffix = has_suffix()
    own = {
        str(right.name).lower(): tuple(own_pattern(each, node, tail=suffix) for each in patterns)
        for right, patterns in named.items()
    }
    return {**said, **own}


def patterns_by_right(options: Mapping[str, Any]) -> dict[Right, tuple[str, ...]]:
    return {right: options[str(right.name).lower()] for right in _RIGHTS}


def is_own_text(text: str) -> bool:
    return NODE in text or text.startswith("~")


def own_pattern(text: str, node: str, *, tail: bool) -> str:
    """The pattern that `{node}/pose` is for `node`; every other one is returned as it is."""
    if not is_own_text(text):
        return text
    found = resolve(check_rule_pattern(text), node, tail=tail)
    if found is None:
        raise PatternRefused(f"{text[:80]!a} is no name of {node}", "its own authority grants it")
    return found


def permissions(
    wanted: Mapping[Right, tuple[str, ...]], *, graph: bool, restricted: list[Restriction]
) -> tuple[Permission, ...]:
    made: list[Permission] = []
    for right, patterns in wanted.items():
        # by conditions and filters given here
        inside = restricted if right in (Right.SUBSCRIBE | Right.CALL) and restricted else [None]
        # all restrictions that cover a name hold together
        made += [Permission(pattern, right, item) for pattern in patterns for item in inside]
    if graph:
        made.append(Permission("/**", Right.GRAPH))
    if not made:
        raise ConfigurationError(
            "a grant that allows nothing", "add --publish, --subscribe, --call or another right"
        )
    if restricted and not any(item.restriction for item in made):
        raise ConfigurationError(
            "conditions and filters restrict what a subscriber sees and what a caller may ask",
            "add --subscribe or --call",
        )
    return tuple(made)


def read_permissions(said: Mapping[str, Any]) -> tuple[Permission, ...]:
    """The permissions that the options say."""
    filters = rules(said["clear"], said["rounds"], said["clamps"])
    inside = restrictions(said["type_name"], filters, said["when"], said["rate"], said["preset_name"])
    return permissions(patterns_by_right(said), graph=said["graph"], restricted=inside)


def rules(
    clear: tuple[str, ...], rounds: tuple[str, ...], clamps: tuple[str, ...]
) -> dict[str, dict[str, object]]:
    given: list[tuple[str, dict[str, object]]] = [(path, {"clear": True}) for path in clear]
    for text in rounds:
        path, _, step = text.partition("=")
        try:
            given.append((path, {"round": {"step": float(step)}}))
        except ValueError:
            raise ConfigurationError(
                f"--round {text} has no step", "for example --round pose.position=2.0"
            ) from None
    for text in clamps:
        path, _, limits = text.partition("=")
        low, _, high = limits.partition(":")
        try:
            given.append((path, {"clamp": {"low": _number(low), "high": _number(high)}}))
        except ValueError:
            raise ConfigurationError(
                f"--clamp {text} has no range", "for example --clamp ranges=0.5:10"
            ) from None
    # Two filters for one field: one would be lost without a word (attack `two-spellings`).
    for path, times in Counter(path for path, _ in given).items():
        if times > 1:
            raise ConfigurationError(
                f"{path}: {times} filters for one field", "one of --clear, --round and --clamp"
            )
    return dict(given)


def _number(text: str) -> float:
    # An integer where it is written so: integer fields accept no float.
    try:
        return int(text)
    except ValueError:
        return float(text)


def restrictions(
    type_name: str | None,
    filters: dict[str, dict[str, object]],
    when: tuple[str, ...],
    rate: float | None,
    preset_name: str | None,
) -> list[Restriction]:
    """Build the restrictions and compile them for the message type: mistakes show here."""
    if not filters and not when and rate is None and preset_name is None:
        return []
    if type_name is None:
        raise ConfigurationError("restrictions need the message type they are for", "add --type PKG/TYPE")
    shape = parse(type_name, part_type(type_name).definition)
    try:
        made = [preset(preset_name).restriction(shape)] if preset_name is not None else []
        if filters or when or rate is not None:
            made.append(Restriction(type_name, when, filter_rules(filters), rate))
        # Compiled now: a mistake would else be found by a publisher, which then sends nothing.
        for restriction in made:
            compile_filter(shape, restriction.filters)
            for text in restriction.conditions:
                compile_condition(shape, text)
    except (ConditionRefused, FilterRefused) as error:
        error.hint = error.hint or _EXAMPLES
        raise
    return made


@click.command()
@json_result()
def presets() -> None:
    """Show what each preset hides, and what it still discloses."""
    record(
        presets=[
            {"name": entry.name, "hides": entry.hides, "discloses": entry.reveals}
            for entry in PRESETS.values()
        ]
    )
    for entry in PRESETS.values():
        say(entry.name)
        say(f"  hides {entry.hides}")
        say(f"  still discloses {entry.reveals}")


@click.command()
@click.argument("file", type=FILE)
@option("--as=NODE own", "the node that holds the grant", required=True)
@option(
    "--to=CERTIFICATE certificate",
    "the certificate of the node that gets the right: its node.pem",
    required=True,
    type=FILE,
)
@permission_options
@duration("--for lifetime", "how long it holds; never longer than the grant in FILE", days=365, default="8h")
@option(
    "--may-narrow=N", "how often the other node may hand it on in its turn", type=click.IntRange(0), default=0
)
@option("--out", "write the token to this new file", type=PATH, required=True)
@json_result(pass_environment)
def narrow(
    environment: Environment,
    /,
    file: Path,
    own: str,
    certificate: Path,
    lifetime: int,
    may_narrow: int,
    out: Path,
    **said: Any,
) -> None:
    """Hand the grant in FILE on to another node of this domain, restricted further.

    What FILE does not allow stays refused, whatever is given here: each link is judged alone, and
    all restrictions hold. The other node takes the token with: rossec grant install.
    """
    check_new(out)
    home, at = NodeHome.find(environment.home, check_name(own)), now()
    token, receiver = read_token(file), _receiver(home, certificate, at)
    held = peek(token)
    # Only the holder's key can sign the next link: it is said here, not by the receiver's master.
    if held.holder != home.identity(at).thumbprint:
        raise GrantNotHeld(
            printable(f"grant {held.short_id} is not held by {home.name}"),
            printable(f"it is for {held.subject}"),
        )
    check_time(held, at)
    if held.may_narrow <= may_narrow:
        raise GrantTooWide(
            f"grant {held.short_id} allows {held.may_narrow} narrowings after it",
            "fewer with --may-narrow"
            if held.may_narrow
            else "at the authority: rossec grant sign NODE --may-narrow N",
        )
    # A chain ends with each of its links: what it says of its end shall be true.
    end = min(at + lifetime, held.expires)
    draft = Draft(
        domain=held.domain,
        subject=receiver.name,
        holder=receiver.thumbprint,
        not_before=max(at - CLOCK_SKEW, held.not_before),
        expires=end,
        cap=end,
        serial=secrets.token_bytes(16),
        permissions=read_permissions(said),
        may_narrow=may_narrow,
    )
    # A right on one name that FILE does not give is a mistake; of patterns nobody can say.
    for permission in draft.permissions:
        for right in permission.rights if "*" not in permission.pattern else ():
            if not held.covers(right, permission.pattern):
                raise ConfigurationError(
                    f"the grant gives no {right.label} on {permission.pattern}", "see: rossec grant show FILE"
                )
    packed = pack_chain(token, [sign_narrowing(home.signer(), draft, held)])
    # A node could install it, and never present it.
    if len(packed) > MAX_PRESENTED - 16:  # of the array it is presented in
        raise GrantMalformed(
            f"the chain has {len(packed)} bytes, more than a node may present", "fewer rights in one grant"
        )
    files.create(out, packed, 0o644)
    record(id=peek(packed).id.hex(), node=receiver.name, expires=end, file=str(out))
    say(f"grant {peek(packed).id.hex()} for {receiver.name} until {clock.format_time(end)}")
    say(f"written to {out}; on the machine of {receiver.name}: rossec grant install {out.name}")


def _receiver(home: NodeHome, path: Path, at: int) -> Identity:
    pem = files.read(path, options.MAX_PEM, ConfigurationError(f"there is no file {path}", ""))
    anchor = home.anchor()
    chain = [each for each in from_pem(pem) if each != anchor.certificate]
    return anchor.verify(chain, at)
