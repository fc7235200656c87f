"""Masters that follow each other: a mesh of one domain, and masters of foreign domains."""

from rossec.federation.mesh import Mesh, mesh_of
from rossec.federation.settings import SiteFile, SiteSettings, checked_sites, read_config

__all__ = ["Mesh", "SiteFile", "SiteSettings", "checked_sites", "mesh_of", "read_config"]
