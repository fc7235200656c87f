"""`wait_for_service` in rospy: its probe needs the right of a client, and waits for the answer.

Clients and providers go through the header hooks in `connections`; the probe has its own socket and
writes its header itself. `rosservice` probes in the same way, and reads the answer.
"""

import socket

from ca.domains.aliases import shown
from ca.errors import HintedError
from rossec.channel.records import Bytes
from rossec.inprocess import headers
from rossec.inprocess.identity import now
from rossec.inprocess.process import SecuredProcess
from rossec.inprocess.sockets import RosSocket
from rossec.participant.header_fields import text
from rossec.participant.remote_names import fields_here, fields_on_wire
from rossec.participant.service_handshake import admit_provider, caller_proof
from rossec.ros import header


class ServiceProbe(RosSocket):
    """A socket whose one message is the header of a probe."""

    def __init__(self, process: SecuredProcess, sock: socket.socket) -> None:
        super().__init__(process, sock)
        self._process = process
        self._answer = b""

    def recv(self, size: int) -> bytes:
        """The answer, which was checked in `sendall`."""
        if self.is_plain:
            return super().recv(size)
        part, self._answer = self._answer[:size], self._answer[size:]
        return part

    def sendall(self, data: Bytes) -> None:
        """Add the proof to the header, send it, and check the answer.

        Raises:
            HintedError, OSError: the service is not available to this node.
        """
        local_identity = self._process.local_identity
        fields = header.decode(bytes(data)[4:])
        service = text(fields, "service")
        if self.is_plain and self._process.allows_plain(service, self.getpeername()[0]):
            super().sendall(data)
            return
        try:
            local_identity.access.check_peer(self.peer, now())
            proof = caller_proof(service, local_identity.access, now())
            named = fields_on_wire(fields)
            self.send_unit(
                header.encode({**named, "callerid": local_identity.name_for(self.peer), **proof})
            )
            answer = headers.receive(self)
            admit_provider(answer, self.peer, service, local_identity.access, now())
            self._answer = header.encode(headers.for_rospy(fields_here(answer, self.peer)))
        except HintedError as error:
            self._process.reporter.warn(f"cannot call {shown(service)}", error)
            raise
