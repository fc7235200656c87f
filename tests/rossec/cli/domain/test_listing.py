import json

import pytest

from rossec import clock
from tests.rossec.cli.domain.sites import Neighbours
from tests.support.commands import Shell, refused


def test_nothing_is_listed_where_nothing_is_trusted(shell: Shell) -> None:
    assert shell("domain", "list").out == "no foreign domain is trusted\n"
    assert shell("domain", "list", "--all").out == "no foreign domains\n"
    assert shell("domain", "list", "--json").out == "[]\n"
    refused(shell("domain", "show", "hospital"), "no domain is called 'hospital'", "domain list")


def test_a_trusted_domain_is_listed_and_shown(sites: Neighbours) -> None:
    sites.accept("--admit", "/rounds/*", "--for", "30d", "--export", "/a subscribe,param-get")
    (line,) = sites.shell("domain", "list").out.splitlines()
    assert line.startswith("hospital  hospital.example  until ")
    assert line.endswith("  trusted")
    shown = sites.shell("domain", "show", "hospital").out
    for part in (
        "domain hospital.example, here hospital: trusted\n",
        f"  fingerprint {sites.fingerprint}\n",
        "  admits /rounds/*, and its masters and relays\n",
        "  shown to it: /a (subscribe, param-get)\n",
        "  0 grants for its nodes",
        "whether it trusts this domain too, the master knows: rossec federation status",
    ):
        assert part in shown
    (row,) = json.loads(sites.shell("domain", "list", "--json").out)
    assert row["exported"] == [{"pattern": "/a", "rights": ["subscribe", "param-get"]}]
    assert (row["label"], row["fresh"], row["imported"]) == ("hospital", 3600, None)
    assert row["fingerprint"].startswith(sites.fingerprint.replace(" ", ""))
    assert sites.shown()["state"] == "trusted"
    assert sites.shown()["ended"] is None


def test_what_was_removed_is_shown_on_request(sites: Neighbours) -> None:
    sites.accept()
    sites.change("remove", "hospital", "--reason", "over")
    assert sites.shell("domain", "list").out == "no foreign domain is trusted\n"
    (line,) = sites.shell("domain", "list", "--all").out.splitlines()
    assert line.endswith("  removed")
    shown = sites.shell("domain", "show", "hospital").out
    assert "here hospital: removed\n" in shown
    assert shown.endswith(": over\n")
    assert sites.shown()["ended"] <= clock.now()


def test_a_domain_whose_time_is_over(sites: Neighbours, monkeypatch: pytest.MonkeyPatch) -> None:
    sites.accept("--for", "60s")
    until = sites.shown()["until"]
    monkeypatch.setattr(clock, "now", lambda: until)
    assert sites.shown()["state"] == "its time is over"
    assert sites.shell("domain", "list").out.strip().endswith("its time is over")
