"""The mesh of a master that runs from a node's directory."""

from collections.abc import Mapping
from dataclasses import replace

from rossec.federation.announced import AnnouncedMasters
from rossec.federation.chains import Chains
from rossec.federation.config import FederationConfig
from rossec.federation.mesh import Mesh, ReadSites
from rossec.federation.own import OwnMaster
from rossec.federation.site_file import SiteFile
from rossec.home import NodeHome
from rossec.master.server.server import MasterServer


def mesh_of(server: MasterServer, home: NodeHome, config: FederationConfig) -> Mesh:
    """The mesh of `server`, not yet running; with `config` and the file in `home`."""
    chains = Chains()
    context = replace(server.context, verify=chains.recording(server.context.verify))
    own = OwnMaster(
        server.state, server.effects, context, server.mirror, server.drop_mirror, chains,
        home.grants,
    )  # fmt: skip
    sources: Mapping[str, ReadSites] = {
        "configuration": lambda: config.sites, "file": SiteFile(home.path).sites,
    }  # fmt: skip
    announced = AnnouncedMasters(home) if config.follow_announced else None
    return Mesh(own, sources, announced)
