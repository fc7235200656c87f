"""Which list of domains the commands of a relay go by."""

from ca.domains import ForeignDomain
from rossec.cli.shared.context import Environment
from rossec.cli.sites import known_domains, relay_files
from tests.support.commands import Shell
from tests.support.masters import domain_list
from tests.support.site import DAY, Site


def test_the_newest_list_on_this_host_counts(empty: Shell) -> None:
    site, other = Site(empty.root), Site(empty.root / "other", "office.example")
    environment = Environment(empty.environ)
    home = site.enroll("/relay")
    assert relay_files(environment).home.path == home.path
    assert known_domains(environment, home).all_listed == ()
    entry = ForeignDomain(
        "office.example", "office", other.anchor.certificate, ("/**",), 60, site.now() + DAY
    )
    for name, number, listed in (("/relay", 1, []), ("/master", 2, [entry])):
        path = site.enroll(name).path / "domains.cose"
        path.touch(0o600)
        path.write_bytes(domain_list(site, foreign=listed, seq=number))
    assert known_domains(environment, home).listed("office") is not None
    path = home.path / "domains.cose"
    path.write_bytes(domain_list(site, seq=3))
    assert known_domains(environment, home).listed("office") is None
