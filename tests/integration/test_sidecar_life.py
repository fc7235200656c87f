"""Sidecars over time, on two hosts: renewals, restarts, programs that share an identity, limits.

The master renews grants by delegation, and identities with its own intermediate.
"""

import re
import time
from collections.abc import Iterator

import pytest

from grants.model import Restriction, Right, filter_rules
from rossec.authority import renewals
from rossec.authority.renewals import sign_intermediate
from tests.integration.sidecarworld import Running, World, wait
from tests.support.hosts import two_hosts
from tests.support.roscpp import compiled
from tests.support.site import HOUR, Site

LIFE = 20  # seconds
SECRET = "of the intermediate"

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]


@pytest.fixture(scope="module")
def probe(request: pytest.FixtureRequest) -> str:
    return str(compiled(request.config.cache.mkdir("roscpp")))


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    directory = tmp_path_factory.mktemp("sidecar_life")
    with two_hosts() as hosts:
        world = World(hosts, Site(directory / "site"), directory)
        secret = directory / "secret"
        secret.write_text(SECRET)
        secret.chmod(0o600)
        renewing(world.site)
        world.enroll("/rostopic", wildcard=True, subscribe="/**", graph="/**")
        with world.master("--renew-identities", "--passphrase-file", str(secret)):
            yield world


def renewing(site: Site) -> None:
    """Configure the master of `site` to renew, once it is started."""
    site.delegate()
    request = renewals.begin(site.root, site.anchor.domain, SECRET).read_bytes()
    _, bundle = sign_intermediate(site.authority, request, site.now(), may_enroll=False)
    renewals.install(site.root, bundle, SECRET, site.now())


@pytest.fixture(scope="module")
def aging(world: World, probe: str) -> Iterator[tuple[float, Running, Running]]:
    """The start time of two programs whose rights expire soon, and the programs."""
    site = world.site
    for name, right in (("/old_talker", Right.PUBLISH), ("/old_listener", Right.SUBSCRIBE)):
        world.enroll(name, lifetime=LIFE, provide=f"{name}/say")
        site.grant(name, right, "/aging", lifetime=LIFE, cap=HOUR)
    near, far = world.hosts.near, world.hosts.far
    with (
        world.secured(near, probe, "talker", "/aging", "__name:=old_talker") as talker,
        world.secured(far, probe, "listener", "/aging", "0", "__name:=old_listener") as listener,
    ):
        listener.wait_for("HEARD hello")
        yield time.monotonic(), talker, listener


def test_both_sides_limit_an_unmodified_publisher(world: World, aging: object, probe: str) -> None:
    """The receiver checks the right to publish, the sender filters what a receiver gets.

    The second talker publishes what its grant does not cover.
    """
    begins = Restriction("std_msgs/String", ('msg.data.startsWith("hello")',))
    short = Restriction("std_msgs/String", (), filter_rules({"data": {"truncate": {"length": 7}}}))
    for name in ("/honest", "/liar"):
        world.enroll(name, provide=f"{name}/say", param_set=f"{name}/**")
        world.site.grant(name, Right.PUBLISH, "/limited", restriction=begins)
    world.enroll("/guest", provide="/guest/say")
    world.site.subscribe("/guest", "/limited", short)
    near, far = world.hosts.near, world.hosts.far
    talker, tool = (probe, "talker", "/limited"), ("--as", "/rostopic")
    with (
        world.secured(near, *talker, "__name:=liar", "_word:=secret"),
        world.secured(near, *talker, "__name:=honest"),
        world.secured(far, probe, "listener", "/limited", "0", "__name:=guest") as guest,
    ):
        wait(lambda: "to: /liar (http" in world.tool("rosnode", "info", "/guest", options=tool))
        heard = len(guest.lines)
        wait(lambda: len(guest.lines) > heard + 20)
        assert all(re.fullmatch(r"HEARD hello \d\n", line) for line in guest.lines), guest.said


def test_programs_share_an_identity(world: World, aging: object, probe: str) -> None:
    """One sidecar, one certified name with a suffix for each; they connect directly."""
    world.enroll("/fleet", wildcard=True, publish="/fleet", subscribe="/fleet", provide="/*/say")
    both = (
        f"{probe} talker /fleet __name:=fleet_1 & {probe} listener /fleet 5 __name:=fleet_2; echo DONE; wait"
    )
    with world.secured(world.hosts.near, "sh", "-c", both, options=("--as", "/fleet")) as fleet:
        fleet.wait_for("DONE")
        assert fleet.said.count("HEARD hello") == 5
        assert 'data: "hello' in world.tool("rostopic", "echo", "-n", "1", "/fleet")
        assert " * /fleet_1 (" in world.tool("rostopic", "info", "/fleet")


def test_a_program_is_restarted_under_its_name(world: World, aging: object, probe: str) -> None:
    """After a kill its messages arrive again; while it runs, a second one replaces it."""
    world.enroll("/phoenix", publish="/ashes", provide="/phoenix/say", param_set="/phoenix/**")
    world.enroll("/witness", subscribe="/ashes", provide="/witness/say")
    near, far = world.hosts.near, world.hosts.far
    phoenix = (probe, "talker", "/ashes", "__name:=phoenix")
    with world.secured(far, probe, "listener", "/ashes", "0", "__name:=witness") as witness:
        with world.secured(near, *phoenix, "_word:=one"):
            witness.wait_for("HEARD one")
        with world.secured(near, *phoenix, "_word:=two") as second:
            witness.wait_for("HEARD two")
            with world.secured(far, *phoenix, "_word:=three"):
                assert second.process.wait(20) == 0
                heard = len(witness.lines)
                wait(lambda: "HEARD three" in "".join(witness.lines[heard:]))


def test_rights_are_renewed_while_the_programs_run(
    world: World, aging: tuple[float, Running, Running]
) -> None:
    """Longer than the first grants and identities were valid; nothing is restarted."""
    began, talker, listener = aging
    wait(lambda: time.monotonic() > began + LIFE + 2, within=2 * LIFE)
    heard = len(listener.lines)
    wait(lambda: len(listener.lines) > heard + 20)
    assert (talker.process.poll(), listener.process.poll()) == (None, None)
    assert " * /old_talker (" in world.tool("rostopic", "info", "/aging")
    for name in ("/old_talker", "/old_listener"):
        assert world.site.identity(name).not_after > time.time()
