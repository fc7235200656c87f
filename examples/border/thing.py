"""A thing for `rossec border`: a lamp with a thermometer, in CoAP with EDHOC and OSCORE.

thing.py lamp                        make its key (lamp.key) and credential (lamp.ccs)
thing.py lamp '[::1]' border.ccs     run it; border.ccs is the credential of the border router
thing.py lamp '[::1]' lamp.secret    run it without curves, by `rossec border add --psk`
"""

import asyncio
import itertools
import math
import os
import struct
import sys
import time
from pathlib import Path

import cbor2
from aiocoap import CHANGED, POST, UNAUTHORIZED, Context, Message, resource
from aiocoap.credentials import CredentialsMap
from aiocoap.edhoc import CoseKeyForEdhoc, EdhocCredentials
from aiocoap.error import Error
from aiocoap.oscore import COSE_KID
from aiocoap.oscore_sitewrapper import OscoreSiteWrapper
from psk import first


class Temperature(resource.ObservableResource):
    numbers = itertools.count()

    def get_link_description(self):  # without `ct`, bodies are as ROS serializes them
        return {"rt": "ros.pub", "if": "sensor_msgs/Temperature", "title": "~temperature"}

    async def render_get(self, _):
        now, degrees = int(time.time()), 20 + math.sin(time.time() / 60)
        body = struct.pack("<4I2d", next(self.numbers), now, 0, 0, degrees, 0)
        return Message(payload=body, content_format=65001)


class Light(resource.Resource):
    def get_link_description(self):  # 60: a CBOR map of the fields
        return {"rt": "ros.sub", "if": "std_msgs/Bool", "title": "~light", "ct": "60"}

    async def render_put(self, request):
        print("the light is", "on" if cbor2.loads(request.payload)["data"] else "off", flush=True)
        return Message(code=CHANGED)


class Reversed:
    """The context of the thing's own requests, for those of the border router."""

    def __init__(self, context):
        self.context = context

    def get_oscore_context_for(self, unprotected):
        return self.context if unprotected.get(COSE_KID) == self.context.recipient_id else None


def make(name):
    ccs = CoseKeyForEdhoc.generate(Path(f"{name}.key")).as_ccs(os.urandom(2), name)[14]
    Path(f"{name}.ccs").write_bytes(cbor2.dumps(ccs, canonical=True))


def credentials(name, file):
    if Path(file).read_bytes().startswith(b"OSCORE:"):
        return first(file)
    own, peer = (cbor2.loads(Path(each).read_bytes()) for each in (f"{name}.ccs", file))
    return EdhocCredentials(2, 3, "by-key-id", {14: peer}, {14: own}, f"{name}.key")


async def run(name, host, file, every=20):
    site, temperature, known = resource.Site(), Temperature(), CredentialsMap()
    links = resource.WKCResource(site.get_resources_as_linkheader, impl_info=None)
    site.add_resource([".well-known", "core"], links)
    site.add_resource(["t"], temperature)
    site.add_resource(["l"], Light())
    thing = await Context.create_server_context(OscoreSiteWrapper(site, known), bind=("::", 0))
    thing.client_credentials[f"coap://{host}/*"] = credentials(name, file)
    remote = None
    while True:  # it says that it is there, and is asked what it has (RFC 9176)
        request = Message(code=POST, uri=f"coap://{host}/rd")
        request.remote = remote or request.remote
        try:
            answer = await thing.request(request).response
            if answer.code == UNAUTHORIZED:  # of a secret: the border router tells its R2
                made = answer.remote.security_context.next()
                remote = answer.remote._replace(security_context=made)
                continue
            remote = answer.remote if answer.code == CHANGED else None
            print("registered" if remote else f"refused: {answer.code}", flush=True)
        except Error as error:  # the border router may have begun anew: another handshake
            remote = print("no answer:", type(error).__name__, flush=True)
        if remote:
            known[":border"] = Reversed(remote.security_context)
        for _ in range(every):
            await asyncio.sleep(1)
            temperature.updated_state()


if len(sys.argv) == 2:
    make(sys.argv[1])
else:
    asyncio.run(run(*sys.argv[1:4], *map(int, sys.argv[4:])))
