import socket

from rossec.inprocess.hooks import ModuleProxy


def test_a_module_proxy_replaces_some_names() -> None:
    proxy = ModuleProxy(socket, socket=dict)
    assert proxy.socket is dict
    assert proxy.AF_INET == socket.AF_INET
