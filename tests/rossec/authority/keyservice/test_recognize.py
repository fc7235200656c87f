"""The service signs statements of an authority and nothing else."""

import secrets

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.authority import Authority, create_root
from ca.certificates import PROFILE as RENEWAL
from ca.certificates import build_intermediate_request
from ca.domains import DomainList, TrustBundle, sign_bundle, sign_domains
from ca.encoding import encode
from ca.keys.signing import Profile
from ca.revocation.lists import (
    MAX_ENTRIES,
    TIMESTAMP_PROFILE,
    RevocationList,
    RevocationTree,
    sign_list,
    sign_tree,
)
from ca.store.values import Head, sign_head
from ca.svid import build_request
from ca.things import sign_statement
from grants import document
from grants.model import Draft, Permission, Right
from grants.renewal import TICKET, Delegation, sign_delegation
from grants.request import REQUEST
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.messages import kind_of
from rossec.errors import SigningRefused
from tests.support.pki import new_signer
from tests.vectors.make_things import STATEMENTS

NOW = 1_800_000_000
SIGNER = new_signer()
ROOT = Authority(SIGNER, create_root(SIGNER, "home", now=NOW, serial=7))
OWNER = messages.ServedAuthority(ROOT.anchor.subject, "home")


class Recorder:
    """A signer that keeps what it was given."""

    def __init__(self) -> None:
        self.message = b""

    @property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        return SIGNER.public_key

    def sign(self, message: bytes) -> bytes:
        self.message = message
        return SIGNER.sign(message)


def certificate(recorder: Recorder) -> None:
    csr = build_request(new_signer(), "home", "/robot")
    Authority(recorder, ROOT.anchor.certificate).issue(csr, now=NOW, serial=9)


def intermediate(recorder: Recorder) -> None:
    csr = build_intermediate_request(new_signer(), "home")
    Authority(recorder, ROOT.anchor.certificate).issue_intermediate(
        csr, now=NOW, serial=9, may_enroll=False, lifetime=999
    )


def grant(recorder: Recorder) -> None:
    draft = Draft(
        domain="home",
        subject="/robot",
        holder=b"h" * 32,
        not_before=NOW,
        expires=NOW + 60,
        cap=NOW + 60,
        serial=b"s" * 16,
        permissions=(Permission("/p", Right.PUBLISH),),
    )
    document.sign(recorder, draft)


def delegation(recorder: Recorder) -> None:
    sign_delegation(recorder, Delegation("home", b"h" * 32, NOW, NOW + 9999, 3600, b"s" * 16))


def largest_list(recorder: Recorder) -> None:
    entries = frozenset(secrets.token_bytes(32) for _ in range(MAX_ENTRIES))
    sign_list(recorder, RevocationList(1, 1, NOW, NOW + 60, entries))


def tree(recorder: Recorder) -> None:
    sign_tree(recorder, RevocationTree(1, 1, NOW, NOW + 60, 5000, b"r" * 32))


def head(recorder: Recorder) -> None:
    sign_head(recorder, Head(5, b"r" * 32, NOW))


def list_of_domains(recorder: Recorder) -> None:
    sign_domains(recorder, DomainList(1, 1, NOW, NOW + 60), "home")


def bundle(recorder: Recorder) -> None:
    root = ROOT.anchor.certificate
    sign_bundle(recorder, TrustBundle(root, ("/**",), ("http://h:11311",), NOW, NOW + 60))


def thing(recorder: Recorder) -> None:
    sign_statement(recorder, STATEMENTS["a key"])


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (certificate, "a certificate of /robot"),
        (intermediate, "a certificate of the intermediate of home"),
        (grant, "a grant"),
        (delegation, "a delegation"),
        (largest_list, "a revocation list"),
        (tree, "a revocation tree"),
        (head, "a head of the log"),
        (list_of_domains, "a list of domains"),
        (bundle, "a bundle of its domain"),
        (thing, "a statement about a thing"),
    ],
)
def test_what_an_authority_signs_is_recognized(make: object, kind: str) -> None:
    recorder = Recorder()
    assert callable(make)
    make(recorder)
    assert kind_of(recorder.message, OWNER) == kind
    for changed in (recorder.message + b"\0", recorder.message[:-1], b""):
        with pytest.raises(SigningRefused):
            kind_of(changed, OWNER)


@pytest.mark.parametrize(
    "profile", [REQUEST, TICKET, RENEWAL, TIMESTAMP_PROFILE, Profile("rossec-other+cwt")]
)
def test_what_others_sign_is_refused(profile: Profile) -> None:
    recorder = Recorder()
    profile.sign(recorder, {1: "home"})
    with pytest.raises(SigningRefused) as caught:
        kind_of(recorder.message, OWNER)
    assert caught.value.hint


@pytest.mark.parametrize(
    "message", [b"", b"0", b"\x84", b"a challenge of another protocol", encode(["Signature1", b"", b"", b""])]
)
def test_other_bytes_are_refused(message: bytes) -> None:
    with pytest.raises(SigningRefused, match="nothing that an authority signs"):
        kind_of(message, OWNER)


def test_more_than_any_statement_is_refused_unread() -> None:
    with pytest.raises(SigningRefused, match="more than any statement"):
        kind_of(bytes(messages.MAX_MESSAGE + 1), OWNER)


def test_a_certificate_of_another_domain_is_refused() -> None:
    recorder = Recorder()
    certificate(recorder)
    with pytest.raises(SigningRefused):
        kind_of(recorder.message, messages.ServedAuthority(ROOT.anchor.subject, "garden"))
