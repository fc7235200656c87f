import asyncio

from rossec.net import read_buffers


def test_a_loop_has_one_memory_of_its_own() -> None:
    loops = asyncio.new_event_loop(), asyncio.new_event_loop()
    near, again, far = (read_buffers.of_loop(loop) for loop in (loops[0], loops[0], loops[1]))
    near[0], far[0] = 1, 2
    assert (again[0], far[0]) == (1, 2)
    for loop in loops:
        loop.close()
