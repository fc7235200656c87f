"""The demo's intruder: connects to the robot with an identity of another authority.

It does not check the robot (an attacker would not); the refusal is the robot's.
Run as `python -I -m rossec.demo.intruder NAME PORT`; reports the result.
"""

import asyncio
import os
import sys
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from rossec.environment import rossec_home
from rossec.errors import RossecError
from rossec.home import NodeHome
from rossec.net.aio import SecureContext, connect
from rossec.terminal import say_json


@dataclass(frozen=True, eq=False)  # a key cannot be hashed, and a peer names itself in `turns`
class UnverifiedPeer:
    public_key: ec.EllipticCurvePublicKey
    not_after: int


def accept_any(chain: tuple[bytes, ...], _now: int) -> UnverifiedPeer:
    certificate = x509.load_der_x509_certificate(chain[0])
    key = certificate.public_key()
    if not isinstance(key, ec.EllipticCurvePublicKey):
        raise RossecError("the robot has another kind of key")
    return UnverifiedPeer(key, int(certificate.not_valid_after_utc.timestamp()))


async def main(name: str, port: int) -> None:
    home = NodeHome.of(rossec_home(os.environ), name)
    try:
        stream = await connect("127.0.0.1", port, SecureContext(home.credentials(), accept_any))
        await stream.send(b"let me in")
        await stream.receive()
    except RossecError as error:
        say_json({"refused": str(error)})
    else:
        say_json({"admitted": name})


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
