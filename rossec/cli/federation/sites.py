"""`rossec federation add | remove | param | list`: the file of sites in the master's home."""

from dataclasses import replace
from functools import partial

import click

from ca.domains.aliases import display_name
from ca.errors import CAError
from ca.names import MASTER
from rossec.cli.shared.batch import Batch, unique
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.results import json_result
from rossec.environment import own_master
from rossec.errors import ConfigurationError
from rossec.federation.settings import SiteSettings, checked_sites
from rossec.federation.site_file import SiteFile
from rossec.home import NodeHome
from rossec.saved_domains import DomainFiles
from rossec.terminal import note, record, say, say_json


@click.command()
@click.argument("uri", required=False, default="")
@click.option("--as", "label", metavar="LABEL", required=True, help="what it is called here")
@click.option(
    "--name", "master", metavar="NAME", default=MASTER, show_default=True,
    help="the name that master is certified for",
)  # fmt: skip
@click.option(
    "--domain", metavar="LABEL", default=None,
    help="the label of its foreign domain, if that is not the site's own label",
)  # fmt: skip
@click.option(
    "--via", metavar="PEER", default="",
    help="instead of a URI: the site that the relay of this site knows by this label",
)  # fmt: skip
@json_result()
@pass_environment
def add(
    environment: Environment, uri: str, label: str, master: str, domain: str | None, via: str
) -> None:
    """Follow the master at URI, or behind the relay's peer PEER, and call it LABEL.

    A label that is that of a trusted domain means a master of that domain. A running master begins
    within a second.
    """
    if bool(uri) == bool(via):
        raise ConfigurationError(
            "a master is followed at a URI or by a relay",
            f"rossec federation add URI --as {label}, or: add --via PEER --as {label}",
        )
    home = _home(environment)
    found = _foreign(home, label) if domain is None else domain
    site = SiteSettings(label, uri, master, found, via=via)
    if not found and master == home.name:
        raise ConfigurationError(
            f"{master} is the master of this host itself",
            "another one of this domain has another name: --name /master/kitchen;"
            " that of another domain is followed once that is trusted: rossec domain accept CARD",
        )

    def put(sites: dict[str, SiteSettings]) -> None:
        if label in sites:
            raise ConfigurationError(
                f"there is a site {label} already: {sites[label].place}",
                f"rossec federation remove {label}",
            )
        sites[label] = site
        checked_sites(sites.values())

    SiteFile(home.path).change(put)
    record(label=label, uri=uri, via=via, domain=found, master=master)
    say(f"{label} is followed: {display_name(found, master)} {site.place}")


@click.command()
@click.argument("labels", metavar="LABEL...", nargs=-1, required=True)
@json_result()
@pass_environment
def remove(environment: Environment, labels: tuple[str, ...]) -> None:
    """Follow LABEL no longer: its names go at once.

    Subscribers here leave its publishers.
    """
    labels = unique(labels)
    batch = Batch(len(labels), "name")
    for label in labels:
        with batch.item(label):
            SiteFile(_home(environment).path).change(partial(_take, label))
            say(f"{label} is followed no longer")
    batch.finish()


def _take(label: str, sites: dict[str, SiteSettings]) -> None:
    _find(sites, label)
    del sites[label]


@click.command()
@click.argument("label")
@click.argument("pattern")
@click.option("--remove", "removing", is_flag=True, help="mirror it no longer")
@json_result()
@pass_environment
def param(environment: Environment, label: str, pattern: str, *, removing: bool) -> None:
    """Mirror the parameters of LABEL that match PATTERN, read-only.

    They are at /remote/LABEL/... here. PATTERN has the names they have there, for example
    '/robot/**'. This master needs a grant of the right param-get on them, in its home.
    """

    def change(sites: dict[str, SiteSettings]) -> None:
        site = _find(sites, label)
        patterns = [each for each in site.parameters if each != pattern]
        if removing and len(patterns) == len(site.parameters):
            raise ConfigurationError(
                f"{pattern} of {label} is not mirrored", "rossec federation list"
            )
        sites[label] = replace(site, parameters=(*patterns, *([] if removing else [pattern])))

    SiteFile(_home(environment).path).change(change)
    record(label=label, pattern=pattern, mirrored=not removing)
    say(f"{pattern} of {label} is mirrored{' no longer' if removing else ''}")


@click.command("list")
@click.option("--json", "as_json", is_flag=True, help="a line of JSON for each")
@pass_environment
def list_(environment: Environment, *, as_json: bool) -> None:
    """List the masters to follow, as `rossec federation add` has them.

    Those of the configuration file and those that were heard are in `rossec federation status`.
    """
    sites = list(SiteFile(_home(environment).path).sites())
    for each in sites:
        if as_json:
            say_json({
                "label": each.label, "uri": each.uri, "master": each.master,
                "domain": each.domain, "parameters": list(each.parameters), "via": each.via,
            })  # fmt: skip
            continue
        where = each.uri or each.place
        mirrored = f"  {' '.join(each.parameters)}" if each.parameters else ""
        say(f"{each.label:<16} {display_name(each.domain, each.master)}  {where}{mirrored}")
    if not sites and not as_json:
        note("no master is followed: rossec federation add URI --as LABEL")


def _home(environment: Environment) -> NodeHome:
    return NodeHome.of(environment.home, own_master(environment.variables))


def _find(sites: dict[str, SiteSettings], label: str) -> SiteSettings:
    if label not in sites:
        raise ConfigurationError(
            f"there is no site {label[:40]!a}", f"there are: {', '.join(sorted(sites)) or 'none'}"
        )
    return sites[label]


def _foreign(home: NodeHome, label: str) -> str:
    """`label`, if the list of domains that the master holds has it; else empty."""
    if not home.path.is_dir():
        return ""
    try:
        anchors = DomainFiles(home, home.anchor()).anchors()
    except CAError as error:
        raise ConfigurationError(
            f"the list of domains of {home.name} is invalid: {error}", "rossec ca publish"
        ) from error
    return "" if anchors.listed(label) is None else label
