"""The vectors of narrowings: chains, and one flaw each with the name of its refusal."""

from dataclasses import replace
from typing import Any, Final

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature

from ca.encoding import Value, encode
from ca.keys.signing import thumbprint
from grants import document
from grants.document import issuer_uri
from grants.model import ALL_RIGHTS, Draft, Grant, Permission
from grants.token import NARROWING, pack_chain, peek, sign_narrowing, unpack

_ORDER: Final = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551  # of P-256


class FixedSigner:
    """Signs the same bytes the same way."""

    def __init__(self, secret: int) -> None:
        self._key = ec.derive_private_key(secret, ec.SECP256R1())

    @property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        return self._key.public_key()

    def sign(self, message: bytes) -> bytes:
        algorithm = ec.ECDSA(hashes.SHA256(), deterministic_signing=True)
        r, s = decode_dss_signature(self._key.sign(message, algorithm))
        return r.to_bytes(32) + s.to_bytes(32)


def chains(ca: FixedSigner, draft: Draft) -> dict[str, tuple[bytes, str | None]]:
    """Tokens with narrowings: by the holders A to D, each rule of the specification broken once."""
    end = draft.cap - 200
    a, b, c, d = (FixedSigner(2000 + number) for number in range(4))
    wide = Permission("/robot/**", ALL_RIGHTS)
    base = replace(
        draft,
        subject="/remote/hospital/a",
        holder=thumbprint(a.public_key),
        may_narrow=3,
        permissions=(wide,),
        expires=end,
        cap=end,
    )
    grant = document.sign(ca, base)
    other = document.sign(ca, replace(base, serial=bytes(16)))

    def after(parent: Grant, to: FixedSigner, **changes: Any) -> Draft:
        wanted: dict[str, Any] = {"cap": end - 60, "expires": end - 60} | changes
        return replace(
            base,
            subject="/b",
            holder=thumbprint(to.public_key),
            **({"may_narrow": parent.may_narrow - 1} | wanted),
        )

    def narrowed(token: bytes, by: FixedSigner, to: FixedSigner, **changes: Any) -> bytes:
        parent = peek(token)
        return pack_chain(token, [sign_narrowing(by, after(parent, to, **changes), parent)])

    one = narrowed(grant, a, b)
    three = narrowed(narrowed(one, b, c), c, d)
    (first,) = unpack(one).narrowings
    links = unpack(three).narrowings
    claims: Any = NARROWING.peek(first)

    def with_claims(by: FixedSigner = a, **changes: Value) -> bytes:
        more = {int(key[1:].replace("_", "-")): value for key, value in changes.items()}
        return encode([grant, [NARROWING.sign(by, claims | more)]])

    r, s = first[-64:-32], int.from_bytes(first[-32:])
    twin = first[:-64] + r + (_ORDER - s).to_bytes(32)
    unnarrowable = document.sign(ca, replace(base, may_narrow=0))
    return {
        "one narrowing": (one, None),
        "three narrowings": (three, None),
        "a twin of a signature": (encode([grant, [twin]]), None),
        "narrowings in another order": (encode([grant, [links[1], links[0]]]), "GrantForged"),
        "a narrowing left out": (encode([grant, [links[0], links[2]]]), "GrantForged"),
        "below another grant": (encode([other, [first]]), "GrantForOther"),
        "below one that allows none": (encode([unnarrowable, [first]]), "GrantTooWide"),
        "a counter that does not fall": (with_claims(c_70034=3), "GrantTooWide"),
        "by another key": (with_claims(by=c), "GrantForged"),
        "iss of another": (with_claims(c1=issuer_uri(bytes(32))), "GrantForged"),
        "for another domain": (with_claims(c3="work"), "GrantForOther"),
        "that has ended": (with_claims(c4=draft.not_before + 1), "GrantExpired"),
        "of another id": (with_claims(c_70032=bytes(16)), "GrantForOther"),
        "with a claim more": (with_claims(c10=1), "GrantMalformed"),
        "with names of anonymous nodes": (with_claims(c9=encode([["/b~/a", 1]])), "GrantMalformed"),
        "with a restricted administrator": (
            with_claims(c9=encode([["/a", 128, {3: {"rate": 1}}]])),
            "GrantMalformed",
        ),
        "no narrowing": (encode([grant, []]), "GrantMalformed"),
        "four narrowings": (encode([grant, [*links, first]]), "GrantMalformed"),
        "a chain in a chain": (encode([one, [links[1]]]), "GrantMalformed"),
        "64 KiB and one byte": (b"\x82" + bytes(65_536), "GrantMalformed"),
    }
