"""The list of domains, given to the master by the commands that change it."""

from rossec.authority.service import AuthorityService
from rossec.terminal import record, say


def publish_domains(service: AuthorityService) -> None:
    """Deliver the list of domains that was signed just now, and say so."""
    record(published=False)
    service.publish_domains()
    record(published=True)
    say("the master has the new list of domains")
