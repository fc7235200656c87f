"""At enrollment: a new identity gets at once what the policy gives its name outright."""

from typing import Final

from ca.errors import HintedError
from grants import document
from rossec.authority.service import AuthorityService, SignedGrant
from rossec.cli.shared.service import deliver_grants
from rossec.terminal import note, record, say

_NAMED: Final = 5  # rights of the line


def give_outright(service: AuthorityService, name: str) -> None:
    """Grant `name` what the policy in force gives it, if there is one, and say so in one line.

    What the policy leaves to a person waits for a request. The identity is signed by then, so a
    policy that cannot be used is a note.
    """
    try:
        signed = service.grant_outright(name)
    except HintedError as error:
        record(no_grants=str(error))
        note(f"{name} has no grants yet: {error}")
        note("correct it (rossec policy check), then: rossec policy apply")
        return
    if signed:
        record(granted=[document.grant_id(data).hex() for _, data in signed])
        say(f"the policy gives {name}: {_rights(signed)}")
        for each in deliver_grants(service, [data for _, data in signed])[:1]:
            note(each.hint)


def _rights(signed: list[SignedGrant]) -> str:
    found = [
        f"{item.rights.label} {item.pattern}" + (" (restricted)" if item.restriction else "")
        for _, data in signed
        for item in document.peek(data).permissions
    ]
    unique = list(dict.fromkeys(found))
    more = f", and {len(unique) - _NAMED} more" if len(unique) > _NAMED else ""
    return ", ".join(unique[:_NAMED]) + more
