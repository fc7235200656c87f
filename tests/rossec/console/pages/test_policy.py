"""The policy, renewals by the master, and other hosts that sign."""

import base64

from ca.approvals.passkeys import base64url
from ca.certificates import build_intermediate_request
from ca.keys.signing import thumbprint
from grants.model import Right
from rossec.authority.console.messages import PolicyRight
from rossec.console.pages.decisions import sentence
from rossec.console.server.control import WebSettings
from tests.support.consolehome import HOSTILE
from tests.support.consolepages import ORIGIN, Browser
from tests.support.pki import new_signer


def test_what_the_policy_changes_is_approved_as_a_whole() -> None:
    browser = Browser().log_in()
    text = browser.get("/policy").text
    assert "It gives" in text
    assert "/map" in text
    assert "may see" in text
    assert 'action="/prepare/policy" data-approve' in text
    assert f'name="digest" value="{base64url(bytes([8]) * 32)}"' in text


def test_mistakes_are_shown_and_nothing_is_approved() -> None:
    browser = Browser().log_in()
    browser.home.policy = browser.home.policy._replace(mistakes=("line 3: no such filter",))
    text = browser.get("/policy").text
    assert "line 3: no such filter" in text
    assert "data-approve" not in text


def test_a_policy_that_changes_nothing_and_none_at_all() -> None:
    browser = Browser().log_in()
    browser.home.policy = browser.home.policy._replace(gives=(), takes=())
    assert "All is as the policy says" in browser.get("/policy").text
    browser.home.policy = browser.home.policy._replace(digest=b"")
    assert "There is no policy" in browser.get("/policy").text


def test_a_long_difference_is_cut_and_says_so() -> None:
    browser = Browser().log_in()
    (right,) = browser.home.policy.gives
    browser.home.policy = browser.home.policy._replace(gives=(right,) * 250, takes=(right,))
    text = browser.get("/policy").text
    assert "and 50 more" in text
    assert "no longer may see" in text


def test_texts_of_the_policy_are_data() -> None:
    browser = Browser().log_in()
    right = PolicyRight(HOSTILE, int(Right.CALL), HOSTILE, HOSTILE, HOSTILE)
    browser.home.policy = browser.home.policy._replace(gives=(right,), path=HOSTILE)
    text = browser.get("/policy").text
    assert "<script>alert" not in text
    assert "\u202e" not in text


def test_a_right_in_words() -> None:
    right = PolicyRight("/map", int(Right.SUBSCRIBE), "/robot/**", "position to 2 m", "7d")
    said = " ".join(part.text for part in sentence(right, "may"))
    assert said == "/map may see everything below /robot (position to 2 m, 7d)"


def test_renewals_by_the_master_are_approved() -> None:
    text = Browser().log_in().get("/delegate").text
    assert 'action="/prepare/delegate" data-approve' in text


def test_the_fingerprint_of_a_host_is_compared_before_it_is_approved() -> None:
    browser, signer = Browser().log_in(), new_signer()
    assert "data-approve" not in browser.get("/intermediate").text
    pasted = base64.b64encode(build_intermediate_request(signer, "home")).decode()
    text = browser.post("/intermediate", data={"csr": pasted}).text
    digits = thumbprint(signer.public_key).hex()
    assert f"{digits[:4]} {digits[4:8]}" in text
    assert 'action="/prepare/intermediate" data-approve' in text
    assert f'name="csr" value="{pasted}"' in text


def test_what_is_no_request_of_a_host_is_told_where_it_was_pasted() -> None:
    browser = Browser().log_in()
    for text in ("</textarea><script>", base64.b64encode(b"x").decode()):
        answer = browser.post("/intermediate", data={"csr": text})
        assert answer.status_code == 422
        assert "data-approve" not in answer.text
        assert "<script>" not in answer.text.replace('<script type="module"', "")


def test_a_screen_that_only_shows_offers_nothing() -> None:
    browser = Browser(settings=WebSettings("home", (ORIGIN,), read_only=True)).log_in()
    for path in ("/policy", "/delegate", "/intermediate"):
        assert "<form" not in browser.get(path).text
