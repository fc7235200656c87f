"""`rossec privacy`: which node has access to which data, and why."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from ca.names import check_name
from grants import document
from grants.model import Grant, Permission, Right
from grants.policy import privacy as report
from grants.policy.decision import Decider
from grants.policy.model import Policy, Subject
from grants.policy.privacy import ReceiverAccess
from rossec import files
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import layout_of, read_policy
from rossec.cli.shared.context import Environment, now
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.terminal import say, say_json


def show(
    environment: Environment,
    policy_path: Path | None,
    *,
    node: str | None,
    field: str | None,
    held: bool,
    html: Path | None,
    as_json: bool,
) -> None:
    """Show the report of the policy, or of what is `held`, as text, JSON or a page."""
    read = read_policy(environment.home, policy_path)
    accesses = report.from_policy(read.decider)
    if held:
        told = format_time if html is None else _day
        accesses = _held(AuthorityHome.at(environment.home), read.decider, told)
    if html is not None:
        wanted = partial(_is_wanted, node, field)
        files.replace(html, _page(accesses, wanted, read.policy).encode(), 0o644)
        say(f"written to {html}")
        return
    rows = [
        row
        for row in report.rows(accesses, layout_of, read.policy.vocabulary)
        if _is_wanted(node, field, row.receiver, row.field)
    ]
    if as_json:
        say_json(report.as_json(rows))
    else:
        for line in report.lines(rows):
            say(line)


def _day(time: int) -> str:
    """As the console's pages say it: in this host's time zone."""
    from rossec.console.words import day  # noqa: PLC0415 - for a page alone

    return day(time)


def _held(
    home: AuthorityHome, decider: Decider, told: Callable[[int], str]
) -> list[ReceiverAccess]:
    """What is granted now, with the reason the policy gives for it today."""
    store = home.store()
    try:
        revoked = store.revoked_entries()
        grants = [document.peek(row.data) for row in store.grants() if row.id not in revoked]
    finally:
        store.close()
    return [
        _access(grant, permission, decider, told)
        for grant in grants
        if grant.not_before <= now() < grant.expires
        for permission in grant.permissions
        if Right.SUBSCRIBE in permission.rights
    ]


def _access(
    grant: Grant, permission: Permission, decider: Decider, told: Callable[[int], str]
) -> ReceiverAccess:
    subject = Subject(check_name(grant.subject), grant.holder, grant.has_tail_patterns)
    verdict = decider.decide(subject, Right.SUBSCRIBE, permission.pattern)
    restriction = permission.restriction
    kind = decider.policy.type_of(permission.pattern)
    return ReceiverAccess(
        permission.pattern,
        kind if restriction is None or restriction.type is None else restriction.type,
        grant.subject,
        "; ".join(rule.why for rule in verdict.rules if rule.why and verdict),
        told(grant.expires),
        f"grant {grant.short_id}",
        () if restriction is None else (restriction,),
        getattr(restriction, "rate", None),
    )


def _is_wanted(node: str | None, field: str | None, receiver: str, path: str) -> bool:
    return node in (None, receiver) and (field is None or field in path)


def _page(
    accesses: list[ReceiverAccess], wanted: Callable[[str, str], bool], policy: Policy
) -> str:
    """The report as the console shows it, as one file.

    Raises:
        ConfigurationError: the extra `console` is missing.
    """
    try:
        from rossec.console.names import Names  # noqa: PLC0415 - an extra
        from rossec.console.pages.privacy import write  # noqa: PLC0415 - an extra
        from rossec.console.report import topics  # noqa: PLC0415 - an extra
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"a page needs the package {error.name}",
            "pip install 'rossec[console]', or leave out --html",
        ) from error
    found = topics(accesses, layout_of, wanted, policy.vocabulary)
    return write(found, policy.robot, now(), Names(dict(policy.titles)))
