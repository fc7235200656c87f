"""`rossec ca enroll`: read a node's code, see who asks, and give it an identity."""

import asyncio
import secrets
import sys
from hashlib import sha256
from pathlib import Path

import click

from ca import qr
from ca.authority import DAY, MAX_LIFETIME
from ca.certificates import from_pem
from ca.enrollment import NONCE_SIZE
from ca.enrollment.authority import AuthorityEnrollment
from ca.enrollment.messages import Delivery, write
from ca.enrollment.transcript import grouped as spaced
from ca.names import spiffe_id
from ca.requests import MAX_REQUEST, Request
from grants.policy.model import Subject
from grants.policy.prospects import prospects
from rossec import files
from rossec.authority import AuthorityHome, OpenAuthority, grouped
from rossec.cli import passphrase
from rossec.cli.context import Duration, Environment, confirm, moment, now, pass_environment
from rossec.cli.publish import deliver as deliver_list
from rossec.cli.publish import remind
from rossec.cli.voice import printable, say
from rossec.enrolling import address
from rossec.enrolling.calling import deliver, fetch
from rossec.errors import ConfigurationError
from rossec.policyfile import PolicyFile, place
from rossec.scan import code_in_file
