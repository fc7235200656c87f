"""The house rules: sizes, docstrings, and words that were given up (docs/decisions/0018)."""

import ast
import io
import itertools
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
PACKAGES: Final = ("ca", "grants", "rossec")
PRODUCT: Final = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
PROGRAMS: Final = sorted(
    path
    for folder in (*PACKAGES, "tests", "bench", "tools")
    for path in (ROOT / folder).rglob("*.py")
)
LINES: Final = 350
FUNCTION_LINES: Final = 60

RETIRED: Final = {
    "AcceptedConnections": "ConnectionTable",
    "Among": "Membership",
    "Answering": "CallAnswers",
    "as_meant": "resolve_params",
    "as_received": "receiver_definition",
    "as_sent": "sender_definition",
    "ask_again_in": "retry_delay",
    "ask_peer": "handle_program_call",
    "ask_program": "handle_peer_call",
    "Asked": "StoredRequest",
    "asked_for": "requested_name",
    "AskLocal": "CallProgram",
    "AskMaster": "CallMaster",
    "AskRemote": "CallPeer",
    "begin_again": "restart_element",
    "bring_all": "egress_uris",
    "Bucket": "RateBucket",
    "CallerLink": "CallerConnection",
    "CellName": "FieldKey",
    "certify_again": "reissue",
    "check_alone": "check_no_foreign_objects",
    "check_own": "check_trusted",
    "check_question": "check_slave_call",
    "check_step": "check_redirect",
    "ClientExchange": "ClientFilter",
    "Collector": "ArrayCollector",
    "Complain": "OnDenial",
    "ComplainLog": "DenialLog",
    "Consequences": "Effects",
    "consequences": "effects",
    "Correspondent": "SlaveApiClient",
    "correspondent": "client",
    "CredentialUnknown": "OwnCredentialUnknown",
    "cut_peers": "cut_ended",
    "Desk": "ApprovalQueue",
    "desk": "queue",
    "Dialler": "SlaveDialer",
    "dialler": "dialer",
    "dials_for": "is_own",
    "Doorways": "PortPool",
    "doorways": "ports",
    "doubted": "probed",
    "EAGER": "FAST_PERIOD",
    "Exchange": "ServiceFilter",
    "Expected": "ExpectedService",
    "Export": "OpenIngress",
    "Exporter": "EdhocExporter",
    "Exports": "Ingress",
    "Flavour": "WireProtocol",
    "Follower": "SubscriptionLoop",
    "Gatekeeper": "AccessControl",
    "gatekeeper": "access_control",
    "go_plain": "switch_to_plain",
    "Guardian": "BackgroundLoop",
    "guardian": "background",
    "Guests": "ConnectionTable",
    "guests": "connections",
    "hand_over": "deliver_grant",
    "Hearers": "RevokedConnections",
    "Held": "PresentedGrants",
    "held_by": "record_held_list",
    "Holders": "SocketOwners",
    "Holding": "HeldGrant",
    "House": "AgentServices",
    "IdentityBook": "IdentityTable",
    "Import": "OpenEgress",
    "Inbox": "GrantRequestStore",
    "is_for": "applies_to",
    "is_tag": "verify_tag",
    "Joined": "AdmittedConnection",
    "JsonLines": "JsonFormatter",
    "judge_answer": "classify_answer",
    "judge_caller": "classify_caller",
    "Judged": "AuthorizedConnection",
    "Kept": "SecuredNode",
    "Knock": "Probe",
    "known_until": "status_valid_until",
    "Links": "ConnectionTable",
    "LiveConnection": "AuthorizedConnection",
    "LiveConnections": "ConnectionTable",
    "live_certificate": "valid_certificate",
    "live_keys": "unrevoked_keys",
    "look_after_self": "check_own_identity",
    "looks_at_once": "names_per_yield",
    "looks_inside": "needs_definition",
    "Lost": "ResubscribeQueue",
    "master_to_tell": "master_uri",
    "may_be_plain": "allows_plain",
    "MeetPeer": "ConnectPeer",
    "MeetProgram": "ConnectProgram",
    "meets_tree": "intersects_tree",
    "Member": "LocalIdentity",
    "Memories": "MemoryStore",
    "MISFIT": "LAYOUT_ERRORS",
    "misfit": "layout_mismatch",
    "must_end": "cut_ended",
    "NamedPublishers": "PublisherGrace",
    "Narrator": "StepPrinter",
    "NearAuthority": "LocalList",
    "Nearby": "LocalAuthority",
    "Network": "PeerConnector",
    "News": "GraphChanges",
    "news_for": "revocations_for",
    "nothing_proved": "prove",
    "on_free_port": "bind_free_port",
    "open_own": "open_trusted",
    "OpenAuthority": "SigningAuthority",
    "opened_inside": "add_egress",
    "opened_outside": "add_ingress",
    "Outbox": "SendQueue",
    "outbox": "send_queue",
    "own_dials_for": "is_own",
    "own_is_due": "own_node_is_due",
    "own_lifetime": "has_lifetime",
    "owner_in": "holder_in",
    "OwnPlaces": "OwnAddresses",
    "ParameterKept": "PersistParameter",
    "Parts": "TokenParts",
    "Party": "EdhocConfig",
    "peer_behind": "peer_at",
    "PlaceRefused": "PathRefused",
    "Places": "ProgramMemories",
    "places_to_search": "search_candidates",
    "Plain": "PlainCaller",
    "PlainLink": "PlainConnection",
    "program_behind": "program_at",
    "prospects": "projected_grants",
    "prove_blocking": "prove",
    "Proven": "PeerStream",
    "ProviderLink": "ProviderConnection",
    "PublisherLink": "PublisherConnection",
    "publishers_are": "set_publishers",
    "Question": "PendingApproval",
    "Quiet": "LogRateLimit",
    "reach_peer": "connect_to_peer",
    "read_moment": "parse_timestamp",
    "Recall": "MemoryScope",
    "refuse_any": "raise_if_any",
    "Remembering": "HysteresisBinding",
    "renew_blocking": "renew",
    "RequestBook": "RequestTable",
    "Rest": "Suspend",
    "RivalOffer": "ConflictingOffer",
    "Rule": "PolicyRule",
    "send_at_once": "try_send",
    "send_now": "try_send",
    "ServerExchange": "ServerFilter",
    "settle_master": "discover_master",
    "SharedAccess": "LockedAccess",
    "Shelf": "GrantDirectory",
    "shelf": "grant_directory",
    "Shown": "PresentedGrants",
    "Silent": "NoAnswer",
    "Source": "SourceWriter",
    "Spare": "BufferPool",
    "spared": "exceptions",
    "Stand": "ModuleProxy",
    "State": "RequestState",
    "Step": "NegotiationStep",
    "SubscriberLink": "SubscriberConnection",
    "suspects": "may_match",
    "take_news": "update_revocations",
    "tell_of_replaced": "publish_if_revoked",
    "Tenant": "AgentState",
    "tenant": "agent",
    "Throttle": "DenialRateLimit",
    "TopicRefused": "ConnectionHeaderRefused",
    "topics_of": "topic_endpoint",
    "treats_messages": "restricts_messages",
    "Trust": "TrustState",
    "unbase45": "decode_base45",
    "Unfinished": "Progress",
    "Unforeseen": "UnexpectedEvent",
    "unheard": "ignore_denial",
    "UnknownCredential": "PeerCredentialUnknown",
    "Update": "ParameterUpdate",
    "Upkeep": "Maintenance",
    "upkeep": "maintenance",
    "Visit": "CommandExecutor",
    "warn_of_tail": "warn_of_wildcard",
    "was_at": "knows_address",
    "Watch": "ConnectionWatchdog",
    "when_lost": "when_closed",
    "Where": "Destination",
    "Whoever": "UnverifiedPeer",
    "why_cut": "termination_reason",
    "why_over": "end_reason",
    "Wish": "RequestedRight",
    "Word": "YamlScalar",
}
"""Identifiers that were given up, and what stands in their place."""

PHRASES: Final = {
    r"\bgatekeepers?\b": "access control",
    r"\bguardians?\b": "background loop",
    r"\bdoorways?\b": "port",
    r"\btenants?\b": "agent",
    r"\bupkeep\b": "maintenance",
    r"\bhearers?\b": "subscriber, receiver, revoked connection",
    r"\bknocks?\b": "connect, probe",
    r"\bcomplain log\b": "denial log",
    r"\bgood standing\b": "a session",
    r"\bthat is none\b": "invalid",
    r"\bis no use\b": "is invalid",
    r"\bsay yes\b|\bsaid yes\b|\bsays yes\b": "approve",
    r"\bbelieved?\b": "accept, trust",
    r"\bdesks?\b": "approval queue",
    r"\bcorrespondents?\b": "slave API client",
    r"\bhears\b": "receives",
}
"""What no text of the product says any more, and what it says instead."""


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_a_file_is_no_longer_than_can_be_read() -> None:
    assert [named(path) for path in PROGRAMS if len(path.read_text().splitlines()) > LINES] == []


def long_functions(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            if node.end_lineno - node.lineno >= FUNCTION_LINES:
                yield f"{named(path)}: {node.name}"


def test_a_function_is_no_longer_than_can_be_read() -> None:
    assert [found for path in PROGRAMS for found in long_functions(path)] == []


def test_a_module_begins_with_its_rule() -> None:
    rules = {named(path): ast.get_docstring(ast.parse(path.read_text())) for path in PRODUCT}
    assert [name for name, text in rules.items() if not text] == []
    assert [name for name, text in rules.items() if len((text or "").splitlines()) > 15] == []


def retired_names(path: Path) -> Iterator[str]:
    text = path.read_text()
    if RETIRED.keys().isdisjoint(re.findall(r"\w+", text)):
        return
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NAME and token.string in RETIRED:
            yield f"{named(path)}:{token.start[0]}: {token.string}, now {RETIRED[token.string]}"


def test_no_name_is_one_that_was_given_up() -> None:
    assert [found for path in PROGRAMS for found in retired_names(path)] == []


TEXTS: Final = sorted([*PRODUCT, *ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
PUBLIC: Final = re.compile(r"getLogger\(")  # names of loggers are an interface: they stay
RETIRED_PHRASE: Final = re.compile("|".join(PHRASES), re.IGNORECASE)


def test_no_text_has_a_word_that_was_given_up() -> None:
    found = [
        f"{named(path)}:{number}: {line.strip()}"
        for path in TEXTS
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if RETIRED_PHRASE.search(line) and not PUBLIC.search(line)
    ]
    assert found == []


FORMS: Final = ("node", "inprocess", "sidecar")
EQUAL_LINES: Final = 12
"""The longest run of equal lines in two forms of a node; more is one idea, for `participant`."""


def significant_lines(path: Path) -> list[str]:
    """Stripped lines, without blank ones and imports."""
    text = path.read_text()
    imported = {
        number
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.stmt) and type(node).__name__.startswith("Import")
        for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), 1))
    return [line for number, line in lines if line and number not in imported]


def runs(form: str, length: int) -> dict[tuple[str, ...], str]:
    """Every run of so many lines in a form, with a file it is in."""
    return {
        tuple(lines[start : start + length]): named(path)
        for path in sorted((ROOT / "rossec" / form).rglob("*.py"))
        for lines in [significant_lines(path)]
        for start in range(len(lines) - length + 1)
    }


def equal_runs(length: int) -> list[tuple[str, str, str]]:
    found = {form: runs(form, length) for form in FORMS}
    return [
        (found[one][run], found[other][run], run[0])
        for one, other in itertools.combinations(FORMS, 2)
        for run in found[one].keys() & found[other].keys()
    ]


def test_no_form_of_a_node_repeats_another() -> None:
    assert equal_runs(EQUAL_LINES + 1) == []


def test_a_repeated_line_is_found() -> None:
    assert equal_runs(1)
