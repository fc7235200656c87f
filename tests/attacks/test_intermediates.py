"""A stolen leaf after its intermediate was revoked (go-spiffe#383): refused, and cut where it is."""

import secrets
from pathlib import Path
from typing import Final

import pytest

from ca import keys
from ca.authority import Authority
from ca.certificates import from_pem
from ca.intermediates import build_intermediate_request
from ca.signer import KeySigner
from grants.model import Right
from rossec.errors import PeerRefused, RossecError
from rossec.home import NodeHome
from rossec.net.stream import connect
from rossec.succession import sign_intermediate
from tests.support.attacker import HOST, dial, expect_refused, listen
from tests.support.site import Site
from tests.support.witness import TOPIC, Witness, until

THIEF: Final = "/thief"
