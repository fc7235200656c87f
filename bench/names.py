"""A name by rules: from a process that runs, from one that has to start, and four at a time.

The rules and metadata are shipped ones. `warm` is what a caller of a running service waits
for, without the service: a process is forked, compiles the rules, answers and ends. Milliseconds.
"""

import asyncio
import statistics
import time
from typing import Any, Final

from rossec.naming import NameKind, RuleRunner, rule_runner

GOAL: Final = 10.0  # milliseconds, the median of a warm name
_WAYS: Final = 5
_TOPIC: Final = (NameKind.TOPIC, "accelerometer")


def measure(seconds: float) -> dict[str, Any]:
    """Milliseconds of each way."""
    return asyncio.run(_measure(seconds / _WAYS))


async def _measure(seconds: float) -> dict[str, Any]:
    rules, phone = rule_runner.shipped_rules(), rule_runner.shipped_example("phone.xml")
    result: dict[str, Any] = {"start_and_one_name": await _cold(rules, phone, seconds)}
    async with RuleRunner(rules, children=4) as runner:
        warm = await _repeat(lambda: runner.name(phone, *_TOPIC), seconds)
        every = [(NameKind.NODE, ""), _TOPIC, (NameKind.TOPIC, "temperature")]
        result |= {
            "warm": warm,
            "three_names_of_one_node": await _repeat(lambda: runner.names(phone, every), seconds),
            "four_callers": await _four(runner, phone, seconds),
        }
    result["goal_met"] = warm["median"] < GOAL
    return result


async def _cold(rules: bytes, phone: bytes, seconds: float) -> dict[str, float]:
    async def once() -> None:
        async with RuleRunner(rules) as runner:
            await runner.name(phone)

    return await _repeat(once, seconds)


async def _four(runner: RuleRunner, phone: bytes, seconds: float) -> dict[str, float]:
    """Each of four asks as soon as it was answered."""
    started = time.perf_counter()
    found = await asyncio.gather(*(_repeat(lambda: runner.name(phone, *_TOPIC), seconds) for _ in range(4)))
    passed = time.perf_counter() - started
    return {
        "median": statistics.median(each["median"] for each in found),
        "names_a_second": round(sum(each["count"] for each in found) / passed),
    }


async def _repeat(action: Any, seconds: float) -> dict[str, float]:
    """Median, 95th percentile and number of calls in `seconds`; the first is not counted."""
    await action()
    took: list[float] = []
    end = time.perf_counter() + seconds
    while len(took) < 5 or time.perf_counter() < end:
        started = time.perf_counter()
        await action()
        took.append((time.perf_counter() - started) * 1000)
    took.sort()
    return {
        "median": round(statistics.median(took), 2),
        "p95": round(took[int(len(took) * 0.95)], 2),
        "count": len(took),
    }
