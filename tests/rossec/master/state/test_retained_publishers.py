"""Addresses kept by site and topic."""

from rossec.master.state.imported_facts import Address, RetainedPublishers

ROBOT = Address("/remote/kitchen/robot", "http://10.0.0.2:1/", ("10.0.0.2", 1))
OTHER = Address("/remote/attic/robot", "http://10.0.0.3:1/", ("10.0.0.3", 1))


def test_publishers_are_kept_for_each_site_and_topic() -> None:
    kept = RetainedPublishers()
    kept.keep("kitchen", "/pose", [ROBOT])
    kept.keep("attic", "/pose", [OTHER])
    kept.keep("attic", "/scan", [])
    assert kept.addresses("/pose") == [ROBOT, OTHER]
    assert kept.addresses("/scan") == []
    assert kept.topics("attic") == ("/pose",)
    kept.forget("kitchen")
    assert kept.topics("kitchen") == ()
    assert kept.addresses("/pose") == [OTHER]
    kept.forget("kitchen")
