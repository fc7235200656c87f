"""What is decided once for many: the policy, renewals by the master, other hosts that sign."""

from typing import Final

from starlette.requests import Request
from starlette.responses import Response

from ca.errors import HintedError
from ca.intermediates import check_intermediate_request
from ca.keys.publickey import thumbprint
from rossec.authority.console.views import PolicyRight
from rossec.console import words
from rossec.console.approving import certificate_request
from rossec.console.context import ConsoleContext
from rossec.console.forms import read_form, text_field
from rossec.console.rendering import render
from rossec.console.routing import MAX_BODY, Page
from rossec.console.sentences import Part, wanted

_SHOWN: Final = 200  # rights


async def show(request: Request, context: ConsoleContext) -> Response:
    """What the policy file would give and take, to be approved as a whole."""
    found = await context.service.policy()
    return render(
        context, request, "policy.html", live=True, policy=found,
        gives=[sentence(each, "may") for each in found.gives[:_SHOWN]],
        takes=[sentence(each, "no longer may") for each in found.takes[:_SHOWN]],
        more=max(0, len(found.gives) - _SHOWN) + max(0, len(found.takes) - _SHOWN),
    )  # fmt: skip


async def show_delegate(request: Request, context: ConsoleContext) -> Response:
    """Ask whether the master may renew grants."""
    return render(context, request, "delegate.html")


async def show_intermediate(request: Request, context: ConsoleContext) -> Response:
    """Ask for the request of a host that is to sign."""
    return render(context, request, "intermediate.html", csr="", key=None, problem=None)


async def check_request(request: Request, context: ConsoleContext) -> Response:
    """Show the fingerprint of a pasted request, to be compared, before it can be approved."""
    text = text_field(await read_form(request), "csr", MAX_BODY)
    try:
        key = check_intermediate_request(certificate_request(text), context.settings.domain)
    except HintedError as error:
        return render(context, request, "intermediate.html", 422, csr=text, key=None, problem=error)
    return render(
        context, request, "intermediate.html", csr=text, key=thumbprint(key), problem=None
    )


def sentence(right: PolicyRight, verb: str) -> tuple[Part, ...]:
    """`/map may see /robot/pose (position to 2 m), 7d`."""
    detail = ", ".join(filter(None, (right.restriction, right.until)))
    return (
        Part(words.name(right.node), is_name=True),
        Part(f"{verb} {wanted(right.right)}"),
        Part(words.topic(right.pattern), is_name=True),
        *([Part(f"({detail})")] if detail else []),
    )


PAGES: Final = (
    Page("/policy", ("GET",), show),
    Page("/delegate", ("GET",), show_delegate),
    Page("/intermediate", ("GET",), show_intermediate),
    Page("/intermediate", ("POST",), check_request),
)
