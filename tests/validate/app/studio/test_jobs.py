"""Computations of the workbench: what listeners hear while one runs."""

import asyncio
import threading

from cboxlab.validation.app.studio import jobs


def test_elapsed_time_is_shown_between_reports(monkeypatch):
    """A computation that reports nothing until its listener has heard of it three times; then silence."""
    monkeypatch.setattr(jobs, "_TICK_S", 0.01)
    heard = threading.Event()

    async def nothing():
        pass

    async def listen():
        all_jobs = jobs.Jobs()
        events = all_jobs.listen()
        await all_jobs.start("rendering", lambda progress: heard.wait(60), nothing)
        reports = [await events.get() for _ in range(4)]
        heard.set()
        while (last := await events.get())["event"] == "progress":
            pass
        await asyncio.sleep(0.05)
        all_jobs.close()
        return reports, last, events.empty()

    reports, last, silent = asyncio.run(asyncio.wait_for(listen(), 60))
    assert {(event["event"], event["job"], event["done"]) for event in reports} == {("progress", "rendering", 0.0)}
    assert all("elapsed" in event["times"] for event in reports)
    assert (last["event"], last["error"]) == ("end", "")
    assert silent
