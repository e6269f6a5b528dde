"""Writing to viser from a thread while tabs wait: the race that killed the viewer."""

from __future__ import annotations

import asyncio
import threading

from app.loop_event import LoopEvent


async def wait_and_clear(event: LoopEvent, times: int) -> int:
    woken = 0
    while woken < times:
        await asyncio.wait_for(event.wait(), 5.0)
        event.clear()
        woken += 1
    return woken


def test_threads_may_set_it_while_waiters_come_and_go() -> None:
    failures: list[Exception] = []

    async def scenario() -> int:
        loop = asyncio.get_running_loop()
        event = LoopEvent(loop)
        stop = threading.Event()

        def write() -> None:
            while not stop.is_set():
                try:
                    event.set()
                    loop.call_soon_threadsafe(event.set)
                except Exception as error:  # noqa: BLE001 - whatever it is, the test shows it
                    failures.append(error)
                    return
                stop.wait(1e-4)

        writers = [threading.Thread(target=write) for _ in range(3)]
        for writer in writers:
            writer.start()
        try:
            woken = await asyncio.gather(*(wait_and_clear(event, 200) for _ in range(8)))
        finally:
            stop.set()
            for writer in writers:
                writer.join()
        return sum(woken)

    assert asyncio.run(scenario()) == 8 * 200
    assert failures == []


def test_a_flag_raised_elsewhere_is_seen_at_once_and_wakes_with_the_loop() -> None:
    async def scenario() -> None:
        event = LoopEvent(asyncio.get_running_loop())
        await asyncio.to_thread(event.set)
        assert event.is_set()
        event.set()
        assert await asyncio.wait_for(event.wait(), 1.0)
        event.clear()
        assert not event.is_set()

    asyncio.run(scenario())
