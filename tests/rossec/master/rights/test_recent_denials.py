from hypothesis import given
from hypothesis import strategies as st

from grants.model import Right
from rossec.master.rights.caller import KEPT, MAX_DENIALS, MAX_NAME, MAX_OF_NODE, RecentDenial, RecentDenials

NOW = 1_800_000_000
SUBSCRIBE, CALL = Right.SUBSCRIBE, Right.CALL


def test_each_denial_counts_once_with_its_newest_time() -> None:
    denials = RecentDenials()
    denials.add(NOW, "/eve", SUBSCRIBE, "/scan")
    denials.add(NOW + 1, "/bob", SUBSCRIBE, "/scan")
    denials.add(NOW + 2, "/eve", CALL, "/scan")
    denials.add(NOW + 3, "/eve", SUBSCRIBE, "/scan")
    assert denials.newest_first(NOW + 3) == [
        RecentDenial(NOW + 3, "/eve", SUBSCRIBE, "/scan"),
        RecentDenial(NOW + 2, "/eve", CALL, "/scan"),
        RecentDenial(NOW + 1, "/bob", SUBSCRIBE, "/scan"),
    ]


def test_a_denial_is_forgotten_after_a_day() -> None:
    denials = RecentDenials()
    denials.add(NOW, "/eve", SUBSCRIBE, "/old")
    denials.add(NOW + 9, "/eve", SUBSCRIBE, "/new")
    assert len(denials.newest_first(NOW + KEPT)) == 2
    assert [denial.name for denial in denials.newest_first(NOW + KEPT + 1)] == ["/new"]
    assert denials.newest_first(NOW + KEPT + 10) == []
    denials.add(NOW + KEPT + 11, "/eve", SUBSCRIBE, "/again")
    assert len(denials.newest_first(NOW + KEPT + 11)) == 1


def test_one_node_does_not_push_out_what_another_was_denied() -> None:
    denials = RecentDenials()
    denials.add(NOW, "/bob", SUBSCRIBE, "/scan")
    for number in range(5 * MAX_DENIALS):
        denials.add(NOW + 1, "/eve", SUBSCRIBE, f"/{number}")
    found = denials.newest_first(NOW + 1)
    assert len(found) == MAX_OF_NODE + 1
    assert found[-1].node == "/bob"
    assert found[0].name == f"/{5 * MAX_DENIALS - MAX_OF_NODE}", "the newest of its own"


def test_many_nodes_share_what_is_kept() -> None:
    denials = RecentDenials()
    denials.add(NOW, "/bob", SUBSCRIBE, "/scan")
    for number in range(MAX_OF_NODE):
        for eve in range(20):
            denials.add(NOW + 1, f"/eve{eve}", SUBSCRIBE, f"/{number}")
    found = denials.newest_first(NOW + 1)
    assert len(found) == MAX_DENIALS
    assert found[-1].node == "/bob"


def test_a_long_name_is_cut() -> None:
    denials = RecentDenials()
    denials.add(NOW, "/eve", SUBSCRIBE, "/" + "x" * 100_000)
    assert len(denials.newest_first(NOW)[0].name) == MAX_NAME


@given(st.lists(st.tuples(st.integers(0, 3), st.sampled_from("abc"), st.integers(0, 400)), max_size=900))
def test_never_more_than_the_limit(steps: list[tuple[int, str, int]]) -> None:
    denials = RecentDenials()
    now = NOW
    for passed, node, name in steps:
        now += passed
        denials.add(now, node, SUBSCRIBE, f"/{name}")
    found = denials.newest_first(now)
    assert len(found) == len({(denial.node, denial.name) for denial in found}) <= MAX_DENIALS
    assert [denial.at for denial in found] == sorted((denial.at for denial in found), reverse=True)


def test_runs_of_an_anonymous_node_count_once_with_the_newest_name() -> None:
    denials = RecentDenials()
    for run in ("/rviz_1795466501944712825", "/rviz_1795466501944712826"):
        denials.add(NOW, "/rviz", Right.PROVIDE, f"{run}/load_config")
    [denial] = denials.newest_first(NOW)
    assert denial.name == "/rviz_1795466501944712826/load_config"


def test_what_a_program_works_without_is_not_kept() -> None:
    denials = RecentDenials()
    denials.add(NOW, "/eve", Right.PUBLISH, "/rosout")
    denials.add(NOW, "/eve", Right.PROVIDE, "/eve/get_loggers")
    denials.add(NOW, "/eve", SUBSCRIBE, "/clock")
    assert [denial.name for denial in denials.newest_first(NOW)] == ["/clock"]
